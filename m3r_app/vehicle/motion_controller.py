"""The motion controller: the one owner of setpoints. Streams an approved plan, or a hover, at 50 Hz.

Position-only setpoints: a stale position is a hover, a stale velocity is not (design "Motion"). MAVLink:
SET_POSITION_TARGET_LOCAL_NED through MAVSDK offboard.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from m3r_app.vehicle.interface import Autopilot
from safety.frames import wrap_deg
from safety.vocabulary import Ned, Plan, Profile

PERIOD_S = 1.0 / 50.0
STALL_S = 0.3
"""A loop this late has stalled: the rest of the plan is dropped (X7)."""


@dataclass(frozen=True, slots=True)
class _Hover:
    """Stay at a point; the nose turns from yaw_deg by turn_deg at the bounded rate."""

    point: Ned
    yaw_deg: float
    turn_deg: float
    turn: Profile

    def at(self, t_s: float) -> tuple[Ned, float]:
        return self.point, self.yaw_deg + math.copysign(self.turn.at(t_s), self.turn_deg)


@dataclass(frozen=True, slots=True)
class _Flight:
    """A plan, moved from the session's frame to the vehicle's own."""

    plan: Plan
    shift: Ned
    lead_s: float
    """How far ahead of the plan the setpoint runs: what the vehicle is behind it."""

    def at(self, t_s: float) -> tuple[Ned, float]:
        t_s = min(t_s, self.plan.duration_s)
        return self.plan.led(t_s, self.lead_s).plus(self.shift), self.plan.yaw_deg(t_s)


class MotionController:
    """Executes only what the arbiter tells it to. `run` streams until cancelled."""

    def __init__(
        self,
        autopilot: Autopilot,
        clock: Callable[[], float],
        yaw_rate_deg_s: float,
        yaw_acceleration_deg_s2: float,
        beat: Callable[[], None],
        stalled: Callable[[str], None],
        sent: Callable[[float, Ned, float], None] = lambda _t, _p, _y: None,
        lead_s: float = 0.0,
    ) -> None:
        """lead_s: how far behind its setpoint the vehicle is; setpoints of a plan run ahead by as much."""
        self._autopilot = autopilot
        self._clock = clock
        self._yaw_rate_deg_s = yaw_rate_deg_s
        self._yaw_acceleration_deg_s2 = yaw_acceleration_deg_s2
        self._beat = beat
        self._stalled = stalled
        self._sent = sent
        self._lead_s = lead_s
        self._task: _Hover | _Flight | None = None
        self._last: tuple[Ned, float] | None = None
        self._since_s = 0.0
        self._order = 0
        self._epoch = 0
        """Rises whenever Offboard is left, so that an entry under way then is none of ours any more."""
        self._mode_lock = asyncio.Lock()
        self.engaged = False
        """Whether we stream in Offboard."""

    async def fly(self, plan: Plan, shift: Ned) -> None:
        """Stream `plan` from now on; shift: session frame to the vehicle's own, added."""
        await self._take(lambda: _Flight(plan, shift, self._lead_s))

    async def face(self, bearing_deg: float) -> None:
        """Hover here and turn the nose to bearing_deg."""
        await self._take(lambda: self._hover(bearing_deg))

    def hold(self) -> None:
        """Stop here now, yaw too. Source: X4, R10."""
        self._order += 1
        self._start(self._hover(None))

    async def let_go(self, command: str) -> None:
        """No more setpoints from here. command: `hold`, `resume` (its mission), or `nothing` after a takeover (X3)."""
        self.disengaged()
        async with self._mode_lock:
            if command == "hold":
                await self._autopilot.leave_in_hold()
                return
            await self._autopilot.end_setpoints()
            if command == "resume":
                await self._autopilot.resume_mission()
            elif command == "land":
                await self._autopilot.begin_landing()

    def disengaged(self) -> None:
        """The autopilot is no longer in Offboard: what was flown is over, the next order enters it anew."""
        self._order += 1
        self._epoch += 1
        self._task = self._last = None
        self.engaged = False

    async def _take(self, make: Callable[[], _Hover | _Flight | None]) -> None:
        self._order += 1
        order, epoch = self._order, self._epoch
        async with self._mode_lock:
            if order != self._order:
                return  # overtaken by a hold or a newer order meanwhile
            if not self.engaged:
                await self._autopilot.enter_offboard()
                if epoch != self._epoch:
                    return  # let go meanwhile: whoever let go commands what comes next
                self.engaged = True
        if order == self._order:
            self._start(make())
        elif self._task is None:
            self._start(self._hover(None))

    def _start(self, task: _Hover | _Flight | None) -> None:
        if task is None and self._last is not None:
            # Position unknown: stay at the last setpoint, which the autopilot is hovering at or about to.
            point, yaw_deg = self._last
            task = _Hover(point, yaw_deg, 0.0, Profile(0.0, self._yaw_rate_deg_s, self._yaw_acceleration_deg_s2))
        self._task = task
        self._since_s = self._clock()
        self.send()

    def _hover(self, bearing_deg: float | None) -> _Hover | None:
        here = self._autopilot.here()
        if here is None:
            return None
        point, yaw_deg = here
        turn_deg = 0.0 if bearing_deg is None else wrap_deg(bearing_deg - yaw_deg)
        turn = Profile(abs(turn_deg), self._yaw_rate_deg_s, self._yaw_acceleration_deg_s2)
        return _Hover(point, yaw_deg, turn_deg, turn)

    def send(self) -> None:
        """One setpoint, for now."""
        if self._task is None or not self.engaged:
            return
        t_s = self._clock()
        point, yaw_deg = self._task.at(t_s - self._since_s)
        self._last = point, yaw_deg
        self._autopilot.set_position_ned(point, wrap_deg(yaw_deg))
        self._sent(t_s, point, wrap_deg(yaw_deg))

    async def run(self, sleep: Callable[[float], Awaitable[None]] = asyncio.sleep) -> None:
        """Send at 50 Hz and beat the guard, until cancelled."""
        due_s = self._clock()
        while True:
            due_s += PERIOD_S
            await sleep(max(0.0, due_s - self._clock()))
            late_s = self._clock() - due_s
            if late_s > STALL_S:
                due_s = self._clock()
                if isinstance(self._task, _Flight):
                    self.hold()
                    self._stalled(f"the control loop stalled for {late_s:.1f} s")
            elif late_s > PERIOD_S:
                due_s = self._clock()
            self._beat()
            self.send()
