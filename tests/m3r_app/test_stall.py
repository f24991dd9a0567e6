"""A hung event loop in mid-maneuver: the guard's thread commands Hold, the plan is dropped and asked for anew (X7)."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from m3r_app.options import RunOptions
from m3r_app.output import AnnounceEvent, MotionEvent, MotionStatus, OutputEvent, Told
from m3r_app.run import run
from tests.whole import PLAIN, simulated

STALL_S = 2.5


@pytest.mark.requirement("X7")
@pytest.mark.soak
async def test_a_blocked_event_loop_is_held_by_the_guard(tmp_path: Path) -> None:
    """Whoever takes the app's output blocks the whole loop: the drone is in Hold within a second all the same."""
    script = tmp_path / "script.txt"
    script.write_text("0.2 panel go left\n6 panel go right\n")
    events: list[OutputEvent] = []
    held: list[str] = []

    with simulated(PLAIN, tmp_path) as sim:

        def blocking(told: Told) -> None:
            event = told.event
            events.append(event)
            if isinstance(event, MotionEvent) and event.status is MotionStatus.STARTED and not held:
                deadline_s = time.monotonic() + STALL_S
                while time.monotonic() < deadline_s:
                    if sim.last("red")["mode"] == "LOITER" and not held:
                        held.append(f"{time.monotonic() - deadline_s + STALL_S:.2f}")

        options = RunOptions(
            headless=True, pair="red", script=script, scenario=PLAIN, vehicles=dict(sim.urls), timeout_s=60.0
        )
        status = await run(options, blocking)

    assert status == 0
    assert held, "the autopilot was not in Hold while the loop was blocked"
    assert float(held[0]) <= 1.2
    said = " ".join(e.text for e in events if isinstance(e, AnnounceEvent))
    assert "the guard commanded Hold" in said
    motions = [(e.request, e.status) for e in events if isinstance(e, MotionEvent)]
    assert ("script-1", MotionStatus.ABORTED) in motions
    assert ("script-2", MotionStatus.COMPLETED) in motions, "a new request flies again"
