"""The motion controller: one owner of setpoints, position only, nothing sent once let go. X3, X4, X7."""

from __future__ import annotations

import asyncio
import math
from itertools import pairwise

import pytest

from m3r_app.vehicle.motion_controller import PERIOD_S, MotionController
from safety.frames import wrap_deg
from safety.limits import Limits
from safety.planner import plan_translation
from safety.vocabulary import Ned, Primitive

PLAN = plan_translation(Primitive.MOVE_FORWARD, Ned(10.0, 0.0, -10.0), 180.0, Ned(0.0, 0.0, 0.0), 1.0, Limits())
SHIFT = Ned(100.0, 20.0, -3.0)


class Pilot:
    """Takes setpoints; Offboard is entered when `door` opens."""

    def __init__(self) -> None:
        self.position, self.yaw_deg = PLAN.start.plus(SHIFT), 170.0
        self.known = True
        self.sent: list[tuple[Ned, float]] = []
        self.orders: list[str] = []
        self.door = asyncio.Event()
        self.door.set()

    def here(self) -> tuple[Ned, float] | None:
        return (self.position, self.yaw_deg) if self.known else None

    def set_position_ned(self, point: Ned, yaw_deg: float) -> None:
        self.sent.append((point, yaw_deg))

    async def enter_offboard(self) -> None:
        await self.door.wait()
        self.orders.append("offboard")

    async def end_setpoints(self) -> None:
        self.orders.append("silence")

    async def leave_in_hold(self) -> None:
        self.orders.append("silence and hold")

    async def resume_mission(self) -> None:
        self.orders.append("resume")

    async def begin_landing(self) -> None:
        self.orders.append("land")


class Made:
    def __init__(self) -> None:
        self.now_s = 50.0
        self.pilot = Pilot()
        self.beats = 0
        self.stalls: list[str] = []
        self.controller = MotionController(self.pilot, lambda: self.now_s, 30.0, 30.0, self.beat, self.stalls.append)

    def beat(self) -> None:
        self.beats += 1

    def run_for(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            self.now_s += PERIOD_S
            self.controller.send()


async def test_a_plan_is_streamed_in_the_vehicles_frame_within_its_bounds() -> None:
    made = Made()
    await made.controller.fly(PLAN, SHIFT)
    made.run_for(PLAN.duration_s + 1.0)
    sent = made.pilot.sent
    assert sent[0][0] == pytest.approx(PLAN.start.plus(SHIFT))
    assert sent[-1][0] == pytest.approx(PLAN.goal.plus(SHIFT))
    steps = [b[0].minus(a[0]).norm for a, b in pairwise(sent)]
    assert max(steps) <= 0.5 * PERIOD_S + 1e-9
    assert made.pilot.orders == ["offboard"]


@pytest.mark.requirement("X4")
async def test_hold_stops_where_the_drone_is() -> None:
    made = Made()
    await made.controller.fly(PLAN, SHIFT)
    made.run_for(1.0)
    made.pilot.position = made.pilot.position.plus(Ned(0.2, 0.0, 0.0))
    made.controller.hold()
    made.run_for(1.0)
    assert {s[0] for s in made.pilot.sent[-50:]} == {made.pilot.position}
    assert {s[1] for s in made.pilot.sent[-50:]} == {170.0}


@pytest.mark.requirement("X4")
async def test_hold_without_a_position_stays_at_the_last_setpoint() -> None:
    made = Made()
    await made.controller.fly(PLAN, SHIFT)
    made.run_for(1.0)
    made.pilot.known = False
    last = made.pilot.sent[-1]
    made.controller.hold()
    made.run_for(0.5)
    assert set(made.pilot.sent[-25:]) == {last}


async def test_facing_turns_at_the_bounded_rate() -> None:
    made = Made()
    await made.controller.face(-100.0)
    made.run_for(5.0)
    yaws = [s[1] for s in made.pilot.sent]
    rates = [abs(wrap_deg(b - a)) / PERIOD_S for a, b in pairwise(yaws)]
    assert max(rates) <= 30.0 + 1e-6
    assert yaws[-1] == pytest.approx(-100.0)


@pytest.mark.requirement("X4")
async def test_an_order_overtaken_by_hold_is_not_flown() -> None:
    made = Made()
    made.pilot.door.clear()
    flying = asyncio.create_task(made.controller.fly(PLAN, SHIFT))
    await asyncio.sleep(0)
    made.controller.hold()
    made.pilot.door.set()
    await flying
    made.run_for(PLAN.duration_s)
    assert {s[0] for s in made.pilot.sent} == {made.pilot.position}


@pytest.mark.requirement("X3")
@pytest.mark.parametrize(("command", "orders"), [
    ("hold", ["offboard", "silence and hold"]), ("resume", ["offboard", "silence", "resume"]),
    ("nothing", ["offboard", "silence"]), ("land", ["offboard", "silence", "land"]),
])  # fmt: skip
async def test_let_go_while_offboard_is_being_entered_sends_nothing_more(command: str, orders: list[str]) -> None:
    """X3: an entry under way does not bring the stream back."""
    made = Made()
    made.pilot.door.clear()
    flying = asyncio.create_task(made.controller.fly(PLAN, SHIFT))
    await asyncio.sleep(0)
    leaving = asyncio.create_task(made.controller.let_go(command))
    await asyncio.sleep(0)
    made.pilot.door.set()
    await asyncio.gather(flying, leaving)
    made.run_for(1.0)
    assert made.pilot.sent == []
    assert not made.controller.engaged
    assert made.pilot.orders == orders


@pytest.mark.requirement("X7")
async def test_a_stalled_loop_drops_the_plan() -> None:
    """X7: late by more than STALL_S, the rest is not flown; a punctual loop beats the guard at 50 Hz."""
    made = Made()
    await made.controller.fly(PLAN, SHIFT)
    naps = 0

    async def sleep(seconds: float) -> None:
        nonlocal naps
        naps += 1
        if naps == 100:
            raise asyncio.CancelledError
        made.now_s += seconds + (0.5 if naps == 50 else 0.0)

    with pytest.raises(asyncio.CancelledError):
        await made.controller.run(sleep)
    assert made.beats == 99
    assert len(made.stalls) == 1
    assert {s[0] for s in made.pilot.sent[-40:]} == {made.pilot.position}
    assert not any(math.isnan(s[1]) for s in made.pilot.sent)
