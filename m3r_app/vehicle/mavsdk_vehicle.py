"""One vehicle over MAVSDK 4: telemetry into latest-value slots, position setpoints, modes, parameters.

MAVSDK runs in this process. Its calls are used with their own callbacks and not through `mavsdk.asyncio`, which queues
every stream without bound and puts every command behind one thread pool. Callbacks arrive on MAVSDK's threads: they
stamp the arrival, fill a slot and wake the event loop at most once. An acknowledged command proves little (PX4
acknowledges a take-off while disarmed), so what matters is read back from telemetry. We are a ground station on the
link: PX4 may refuse to arm for what calls itself a companion computer (X3, X6).
"""

from __future__ import annotations

import asyncio
import json
import math
import threading
from collections import deque
from collections.abc import Awaitable, Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

from mavsdk import ComponentType, Configuration, Mavsdk, MavsdkError
from mavsdk.plugins.action import Action
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.mission_raw import MissionRaw
from mavsdk.plugins.offboard import Offboard, PositionNedYaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry as TelemetryPlugin
from mavsdk.plugins.transponder import Transponder

from m3r_app.ports import LinkError, check_link
from m3r_app.vehicle import mavsdk_litter, px4_modes
from m3r_app.vehicle.adsb import Aircraft
from m3r_app.vehicle.interface import VehicleError
from m3r_app.vehicle.mavsdk_commands import command, post, set_mode, settle, verdict
from m3r_app.vehicle.mavsdk_log import redirect_log
from m3r_app.vehicle.mavsdk_parameters import ParameterClient
from m3r_app.vehicle.mavsdk_telemetry import Reception
from m3r_app.vehicle.telemetry import Telemetry
from m3r_app.vehicle.waiting import Waiting
from safety.vocabulary import FlightMode, Ned

SETPOINT_AGE_S = 0.5
"""Offboard is entered only from a position at most this old."""
MODE_WAIT_S = 2.5
"""The flight mode is reported at 1 Hz, and a report may be lost."""
LET_GO_S = 20.0
"""So long a drone that is let go is told to hold, again and again, until it is seen to."""
LET_GO_AGAIN_S = 0.3
BEFORE_TAKEOFF = (FlightMode.HOLD, FlightMode.READY)
"""The modes that a vehicle may be in until it has taken up its take-off."""
TAKEOFF_ALTITUDE = "MIS_TAKEOFF_ALT"
OFFBOARD_RETRY_S = 2.0
"""PX4 denies Offboard until it has seen setpoints: how long to ask again."""
OUR_MODES = (FlightMode.OFFBOARD, FlightMode.HOLD, None)
"""The modes a vehicle is in while we command it; None: not heard yet."""

T = TypeVar("T")


TUNE = "MFT160L8CG"
"""In the notation of PLAY_TUNE's QBasic format."""


@dataclass(frozen=True, slots=True)
class StatusText:
    """What the autopilot says in words (STATUSTEXT)."""

    at_s: float
    severity: str
    text: str


class MavsdkVehicle(Waiting):
    """A connected vehicle. Made by `MavsdkVehicle.connect`; every method but the two blocking Holds belongs to the event loop."""

    def __init__(self, colour: str, url: str, clock: Callable[[], float], mavsdk: Mavsdk, system: Any) -> None:
        self.colour = colour
        self.url = url
        self._clock = clock
        self._loop = asyncio.get_running_loop()
        self._mavsdk = mavsdk
        self._action = Action(system)
        self._system = system
        self._offboard: Offboard | None = None
        """What sends setpoints, and sends the last one again and again for as long as it exists."""
        self._mission = MissionRaw(system)
        direct = MavlinkDirect(system)
        # Blocking calls get a thread of their own, so that nobody else's work can delay them.
        self._executor = ThreadPoolExecutor(1, thread_name_prefix=f"vehicle-{colour}")
        self._listeners: list[Callable[[Telemetry], None]] = []
        self._wake_pending = False
        self._closed = False
        self.status_texts: deque[StatusText] = deque(maxlen=100)
        self._direct = direct
        self._reception = Reception(
            clock, TelemetryPlugin(system), direct, Transponder(system), self._wake, self._status_text
        )
        self._parameters = ParameterClient(
            Param(system), direct, system.get_system_id(), self._executor, lambda: self._reception.is_px4
        )

    @classmethod
    async def connect(cls, colour: str, url: str, clock: Callable[[], float], timeout_s: float = 10.0) -> MavsdkVehicle:
        """Open the link and wait for its first autopilot. Raises VehicleError: bad link, port in use, no answer."""
        redirect_log()
        try:
            check_link(url)
        except LinkError as error:
            raise VehicleError(f"{colour}: {error}") from None
        loop = asyncio.get_running_loop()
        configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
        mavsdk_litter.begin()
        mavsdk = Mavsdk(configuration)
        found: asyncio.Future[Any] = loop.create_future()
        try:
            try:
                await loop.run_in_executor(None, mavsdk.add_any_connection_with_handle, url)
            except MavsdkError as error:
                raise VehicleError(f"{colour}: {url} cannot be opened ({error}).") from None
            waiting = mavsdk.first_autopilot_async(timeout_s, lambda system: post(loop, settle, found, system))
            try:
                system = await found
            finally:
                mavsdk.cancel_first_autopilot(waiting)
            if system is None:
                raise VehicleError(
                    f"{colour}: no autopilot answered on {url} within {timeout_s:g} s: check that the vehicle is on "
                    "and sends MAVLink to this address."
                )
            vehicle = cls(colour, url, clock, mavsdk, system)
        except BaseException:
            await asyncio.shield(loop.run_in_executor(None, mavsdk.destroy))
            raise
        vehicle._reception.request_rates(50.0 if not url.startswith("serial") else 10.0)
        return vehicle

    async def close(self) -> None:
        """End the link: setpoints stop. Idempotent."""
        if self._closed:
            return
        self._closed = True
        self._listeners.clear()
        # In a thread: MAVSDK waits for its callbacks, and those may wait for the interpreter.
        await self._loop.run_in_executor(None, self._mavsdk.destroy)
        self._executor.shutdown(wait=False)

    # Telemetry

    def on_telemetry(self, listener: Callable[[Telemetry], None]) -> None:
        """Call listener in the event loop at each new position, with the latest of everything."""
        self._listeners.append(listener)

    def off_telemetry(self, listener: Callable[[Telemetry], None]) -> None:
        """Do not call listener any more."""
        if listener in self._listeners:
            self._listeners.remove(listener)

    def now_s(self) -> float:
        return self._clock()

    def telemetry(self) -> Telemetry:
        """The latest of everything, now. Silence is seen in its ages."""
        return self._reception.slots.snapshot(self._clock())

    def aircraft(self) -> tuple[Aircraft, ...]:
        """The aircraft with a transponder that this one hears of."""
        return self._reception.aircraft.now(self._clock())

    async def play_tune(self) -> bool:
        """Two rising notes (PLAY_TUNE): this is the drone that was paired. Whether it could be sent; nobody answers it.

        MAVSDK's own tune plugin cannot hand a list of notes to its library, so the message is sent as it is.
        """
        fields = json.dumps({"target_system": 0, "target_component": 0, "tune": TUNE, "tune2": ""})
        message = MavlinkMessage("PLAY_TUNE", 0, 0, 0, 0, fields)
        try:
            result = await self._loop.run_in_executor(self._executor, self._direct.send_message, message)
        except (MavsdkError, RuntimeError):
            return False
        return bool(result is None or getattr(result, "name", "SUCCESS") == "SUCCESS")

    def here(self) -> tuple[Ned, float] | None:
        """Own local position and yaw (deg) now; None if they are unknown or stale."""
        telemetry = self.telemetry()
        if telemetry.local is None or not telemetry.age_s(self._clock()) <= SETPOINT_AGE_S:
            return None
        return telemetry.local, telemetry.yaw_deg

    # Motion

    def set_position_ned(self, point: Ned, yaw_deg: float) -> None:
        """Hand over a position-only setpoint (m, the vehicle's own local NED; compass yaw). Cheap: no thread, no wait.

        MAVSDK sends it at once and again at 20 Hz until the next one. Raises VehicleError on a value that is not finite
        (MAVSDK would send it) or a link that is closed.
        """
        if not point.finite or not math.isfinite(yaw_deg):
            raise VehicleError(f"{self.colour}: a setpoint of {tuple(point)}, {yaw_deg} degrees is no position.")
        try:
            if self._offboard is None:
                self._offboard = self._new_offboard()
            self._offboard.set_position_ned(PositionNedYaw(*point, yaw_deg))
        except (MavsdkError, RuntimeError) as error:
            raise VehicleError(f"{self.colour}: a setpoint could not be sent ({error}).") from None

    def _new_offboard(self) -> Offboard:
        if self._closed:
            raise RuntimeError("the link is closed")
        return Offboard(self._system)

    async def enter_offboard(self) -> None:
        """Enter Offboard at the present position and yaw, never at a remembered one. Raises VehicleError.

        Returns when the vehicle itself reports Offboard (up to a second after it has acknowledged: HEARTBEAT, 1 Hz).
        """
        deadline_s = self._loop.time() + OFFBOARD_RETRY_S
        while True:
            here = self.here()
            if here is None:
                age_s = self.telemetry().age_s(self._clock())
                raise VehicleError(
                    f"{self.colour}: Offboard needs a fresh position, and the last is {age_s:.1f} s old."
                )
            self.set_position_ned(*here)
            try:
                await self._change_mode("Offboard", px4_modes.OFFBOARD, 0)
                break
            except VehicleError:
                if self._loop.time() > deadline_s:
                    raise
            await asyncio.sleep(0.1)
        await self.wait_for(lambda t: t.flight_mode == FlightMode.OFFBOARD, MODE_WAIT_S, "Offboard")

    async def hold(self) -> None:
        """Command Hold; returns when it is acknowledged and the vehicle itself reports it. Raises VehicleError."""
        await self._change_mode("Hold", px4_modes.AUTO, px4_modes.HOLD_SUB)
        await self.wait_for(lambda t: t.flight_mode == FlightMode.HOLD, MODE_WAIT_S, "Hold")

    async def end_setpoints(self) -> None:
        """No setpoint leaves from here on. MAVSDK sends the last one again for as long as its plugin exists, so it ends."""
        offboard, self._offboard = self._offboard, None
        if offboard is not None:
            # In a thread: it waits for a callback that may be waiting for the interpreter.
            await self._loop.run_in_executor(self._executor, offboard.destroy)

    async def leave_in_hold(self) -> None:
        """End the setpoints and command Hold until it is seen, or until somebody else flies it. Raises VehicleError."""
        await self.end_setpoints()
        deadline_s = self._loop.time() + LET_GO_S
        while True:
            if self.telemetry().flight_mode not in (FlightMode.OFFBOARD, FlightMode.HOLD, FlightMode.UNKNOWN):
                return  # somebody took over: that is never fought (X3)
            try:
                await self.hold()
            except VehicleError:
                if self._loop.time() > deadline_s or self._closed:
                    raise
                await asyncio.sleep(LET_GO_AGAIN_S)
            else:
                return

    def hold_blocking(self, timeout_s: float) -> None:
        """Command Hold from any thread, without the event loop: for the guard. Raises VehicleError."""
        answered = threading.Event()
        results: list[Any] = []

        def done(result: Any, *more: Any) -> None:
            results.append(verdict(result, *more))
            answered.set()

        try:
            if self._reception.is_px4:
                self._direct.send_command_async(self._set_mode(px4_modes.AUTO, px4_modes.HOLD_SUB), done)
            else:
                self._action.hold_async(done)
        except RuntimeError as error:
            raise VehicleError(f"{self.colour}: Hold could not be sent ({error}).") from None
        if not answered.wait(timeout_s):
            raise VehicleError(f"{self.colour}: Hold was sent and not acknowledged within {timeout_s:g} s.")
        if results[0] != "SUCCESS":
            raise VehicleError(f"{self.colour}: Hold was answered with {results[0]}.")

    def hold_unless_taken_over(self, timeout_s: float) -> None:
        """What the guard calls: as hold_blocking, but nothing where the flight mode says that somebody took over (X3).

        The mode is the latest heard by MAVSDK's threads: it is known even while the event loop is stuck.
        """
        if self._reception.slots.flight_mode.value in OUR_MODES:
            self.hold_blocking(timeout_s)

    async def takeoff(self, metres: float, timeout_s: float = 60.0) -> None:
        """Arm, take off to `metres` above here and wait there in Hold. Gated on health by us. Raises VehicleError."""
        if not (math.isfinite(metres) and metres > 0.0):
            raise VehicleError(f"{self.colour}: a take-off to {metres:g} m is none: give a height above 0.")
        telemetry = await self.wait_ready()
        if not telemetry.healthy:
            raise VehicleError(f"{self.colour}: not fit to take off: {', '.join(telemetry.unhealthy)}.")
        if telemetry.in_air is not False or telemetry.local is None:
            raise VehicleError(f"{self.colour}: take-off is only for a vehicle that is known to stand on the ground.")
        ground_down_m = telemetry.local.down

        def risen_m(t: Telemetry) -> float:
            return ground_down_m - t.local.down if t.local is not None else -math.inf

        kept = (await self.parameters([TAKEOFF_ALTITUDE]))[TAKEOFF_ALTITUDE] if self._reception.is_px4 else None
        await self._command("the take-off altitude", lambda done: self._action.set_takeoff_altitude_async(metres, done))
        try:
            await self._command("arming", self._action.arm_async)
            await self.wait_for(lambda t: t.armed is True, 5.0, "arming")
            await self._command("take-off", self._action.takeoff_async)
            reached, began = f"a take-off to {metres:g} m", False

            def there(t: Telemetry) -> bool:
                return t.in_air is True and t.flight_mode == FlightMode.HOLD and risen_m(t) > 0.8 * metres

            def over(t: Telemetry) -> bool:
                nonlocal began
                began = began or t.flight_mode == FlightMode.TAKEOFF
                return there(t) or t.flight_mode not in (
                    FlightMode.UNKNOWN,
                    FlightMode.TAKEOFF,
                    *(() if began else BEFORE_TAKEOFF),
                )

            done = await self.wait_for(over, timeout_s, reached)
            if not there(done):
                raise VehicleError(
                    f"{self.colour}: {reached} was ended by somebody else or its own failsafe, at "
                    f"{risen_m(done):.1f} m, with {done.flight_mode}."
                )
        finally:
            # It is the vehicle's own setting, for take-offs of others.
            if kept is not None and math.isfinite(kept) and kept != metres:
                await asyncio.shield(self.set_parameter(TAKEOFF_ALTITUDE, kept))

    async def land(self, timeout_s: float = 120.0) -> None:
        """Come down here and wait until it stands on the ground. Raises VehicleError."""
        if self.telemetry().in_air is not True:
            raise VehicleError(f"{self.colour}: landing is only for a vehicle that is known to fly.")
        await self.begin_landing()
        await self.wait_for(lambda t: t.in_air is False, timeout_s, "the landing")

    async def begin_landing(self) -> None:
        """Tell it to come down here; returns when that is acknowledged. Raises VehicleError."""
        await self._command("landing", self._action.land_async)

    async def resume_mission(self) -> None:
        """Go on with the mission that is in the vehicle. Raises VehicleError."""
        await self._command("the mission", self._mission.start_mission_async)

    # Parameters

    async def parameters(self, names: Iterable[str]) -> dict[str, float | int | None]:
        """Read parameters; None for one that the vehicle does not have. Raises VehicleError."""
        return await self._parameter_work(self._parameters.read(list(names)))

    async def set_parameter(self, name: str, value: float) -> None:
        """Set one parameter, as the type that the vehicle says it has. Raises VehicleError."""
        await self._parameter_work(self._parameters.write(name, value))

    async def _parameter_work(self, work: Awaitable[T]) -> T:
        try:
            return await work
        except (MavsdkError, RuntimeError, ValueError) as error:
            raise VehicleError(f"{self.colour}: {error}.") from None

    # Inside

    def check_alone(self) -> None:
        """Two vehicles on one link could be taken for each other. Raises VehicleError."""
        systems = sorted(system.get_system_id() for system in self._mavsdk.get_systems() if system.has_autopilot())
        if len(systems) > 1:
            raise VehicleError(
                f"{self.colour}: more than one vehicle answers on {self.url} "
                f"(system ids {' and '.join(map(str, systems))}): give each a port of its own."
            )

    async def _change_mode(self, what: str, main: int, sub: int) -> None:
        """A mode of PX4's, by its own component; of another autopilot, whatever MAVSDK takes for the same. Raises VehicleError."""
        if self._reception.is_px4:
            await self._command(what, lambda done: self._direct.send_command_async(self._set_mode(main, sub), done))
        elif main == px4_modes.OFFBOARD:
            offboard = self._offboard
            if offboard is not None:
                await self._command(what, offboard.start_async)
        else:
            await self._command(what, self._action.hold_async)

    def _set_mode(self, main: int, sub: int) -> MavlinkMessage:
        return set_mode(self._system.get_system_id(), main, sub)

    async def _command(self, what: str, send: Callable[[Callable[..., None]], None]) -> None:
        if self._closed:
            raise VehicleError(f"{self.colour}: {what} was asked for after the link was closed.")
        asked_at_s = self._clock()
        await command(self.colour, what, send, lambda: self.reason(asked_at_s))

    def reason(self, since_s: float) -> str:
        """What the autopilot said in words since then, to be appended."""
        texts = [status.text.rstrip(". ") for status in self.status_texts if status.at_s >= since_s]
        return f": the vehicle says {'; '.join(texts)}" if texts else ""

    def _wake(self) -> None:
        """On MAVSDK's thread: a new position. Wakes the loop once, however many arrive before it comes to it."""
        if not self._wake_pending:
            self._wake_pending = True
            post(self._loop, self._tell)

    def _tell(self) -> None:
        self._wake_pending = False
        telemetry = self.telemetry()
        for listener in tuple(self._listeners):
            listener(telemetry)

    def _status_text(self, severity: str, text: str) -> None:
        self.status_texts.append(StatusText(self._clock(), severity, text))
