"""The events of a scenario, each made to happen to a simulated drone when it is due. Source: m3r_app.environment.scenario, `[[vehicles.X.events]]`."""

from __future__ import annotations

from m3r_app.environment import scenario
from m3r_app.sim.autopilot import Autopilot
from m3r_app.sim.link import VehicleLink
from m3r_app.sim.modes import Fault, FlightMode
from safety.vocabulary import Ned

MOVED_M = 0.3
"""A setpoint this far from the first one is a move."""
_MODES = {"HOLD": FlightMode.LOITER} | {
    mode.name: mode
    for mode in (
        FlightMode.LAND, FlightMode.RTL, FlightMode.POSCTL, FlightMode.ALTCTL, FlightMode.MISSION, FlightMode.OFFBOARD,
    )
}  # fmt: skip


class Happenings:
    """The events of one drone."""

    def __init__(self, events: tuple[scenario.Event, ...], link: VehicleLink) -> None:
        """Times are counted from now, which is "start"."""
        self._link = link
        self._left = list(events)
        pilot = link.autopilot
        self._since_s: dict[str, float] = {"start": pilot.now_s}
        self._flew = pilot.in_air
        self._first: Ned | None = None
        self._mend: list[tuple[float, int]] = []
        self.happened: list[str] = []
        """The kinds of the events that have happened, in order."""

    def tick(self) -> None:
        """Make the events happen that are due. Call it after each tick of the autopilot."""
        pilot = self._link.autopilot
        self._notice(pilot)
        for event in list(self._left):
            since_s = self._since_s.get(event.after)
            if since_s is not None and pilot.now_s >= since_s + event.at_s - 1e-6:
                self._left.remove(event)
                self._apply(event, pilot)
                self.happened.append(event.kind)
        for due in [due for due in self._mend if due[0] <= pilot.now_s]:
            self._mend.remove(due)
            pilot.mend(due[1])

    def _notice(self, pilot: Autopilot) -> None:
        now_s = pilot.now_s
        if pilot.in_air and not self._flew:
            self._since_s.setdefault("takeoff", now_s)
        self._flew = pilot.in_air
        if pilot.intended is FlightMode.OFFBOARD and pilot.armed:
            self._since_s.setdefault("offboard", now_s)
            goal = pilot.goal
            if goal is not None and goal.finite:
                self._first = self._first or goal
                if goal.minus(self._first).norm > MOVED_M:
                    self._since_s.setdefault("move", now_s)

    def _apply(self, event: scenario.Event, pilot: Autopilot) -> None:
        link, now_s = self._link, pilot.now_s
        match event:
            case scenario.EstimateJump():
                pilot.jump(Ned(*event.ned_m))
            case scenario.GpsLost():
                pilot.break_(Fault.GPS_OFF)
                if event.for_s is not None:
                    self._mend.append((now_s + event.for_s, Fault.GPS_OFF.value[0]))
            case scenario.ModeByOther():
                pilot.stick_pilot = pilot.stick_pilot or event.mode in ("POSCTL", "ALTCTL")
                pilot.change_mode(_MODES[event.mode])
            case scenario.DisarmByOther():
                pilot.disarm_in_the_air("Kill engaged" if event.kind == "kill" else "Disarmed by external command")
            case scenario.Restart():
                pilot.restart(event.for_s)
            case scenario.LinkCut():
                link.channel.cut(now_s + event.for_s)
            case scenario.LinkChange():
                link.channel.loss, link.channel.delay_s = event.loss, event.delay_ms / 1000.0
            case scenario.ComponentHeard():
                link.hear_component(event.component, event.type, event.autopilot)
            case scenario.SecondAutopilot():
                link.hear_autopilot(event.system_id)
            case scenario.StatusText():
                link.say(event.severity, event.text.encode())
            case scenario.BatteryTold():
                link.telemetry.battery_unknown = event.level == "unknown"
                if event.level != "unknown":
                    pilot.battery = event.level
            case scenario.FaultHappens():
                pilot.break_(Fault[event.fault.upper()])
