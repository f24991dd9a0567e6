"""GPS off, stuck, wrong, and an estimate that jumps, while the paired drone hovers; then it is asked to move.

Real processes, real UDP, the simulated fleet's happenings, judged on the true state: until its own autopilot lands it the
drone is never further from where it hovered than one step. `M3R_SOAK=1` only.
"""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from safety.limits import Limits
from tests.soak.figures import record
from tests.soak.fleets import all_at_once, app, flying, furthest_m, scenario

EACH = 8
STEP_M = Limits().lateral_step_m + 0.3
SCRIPT = "4.5 panel go left\n10 panel go right\n"
"""Right after the fault, and when a jump is over."""
FAULTS = {
    "off for 8 s": ('kind = "gps_lost"\nfor_s = 8.0', "place"),
    "stuck": ('kind = "fault"\nfault = "gps_stuck"', "agreement"),
    "wrong by 5 m": ('kind = "fault"\nfault = "gps_wrong"', "jump"),
    "jump of 3.6 m": ('kind = "estimate_jump"\nned_m = [3.0, 2.0, 0.5]', "jump"),
}
"""Each with the guard that is to prevent what it could do."""

pytestmark = [pytest.mark.soak, pytest.mark.timeout(3000), pytest.mark.xdist_group("soak-flights")]


def hover(n: int, event: str, folder: Path, guard: str = "none") -> tuple[float, int]:
    """Metres from where it hovered, and how many moves were begun."""
    folder.mkdir(exist_ok=True)
    at_s = 4.0 + random.Random(n).uniform(-0.5, 0.2)
    place = scenario(folder, f'\n[[vehicles.red.events]]\nat_s = {at_s:.2f}\nafter = "offboard"\n{event}\n')
    place.write_text(place.read_text(encoding="utf-8").replace("seed = 1\n", f"seed = {n + 1}\n"), encoding="utf-8")
    with flying(place, folder) as (sim, truth):
        ran = app(sim, SCRIPT, guard, "--timeout", "20").finish()
        states = truth.read()
    first = next(i for i, state in enumerate(states) if state["events"])
    ours = [state for state in states[first:] if state["mode"] in ("OFFBOARD", "LOITER")]
    return furthest_m(ours, states[first]["ned_m"]), len(ran.of("motion", status="started"))


@pytest.mark.requirement("X6")
@pytest.mark.parametrize("fault", list(FAULTS))
def test_a_position_that_is_wrong_draws_the_drone_nowhere(fault: str, tmp_path: Path) -> None:
    event, guard = FAULTS[fault]
    found = all_at_once(lambda n: hover(n, event, tmp_path / str(n)), EACH)
    unsafe = sum(away_m > STEP_M for away_m, _ in found)
    away_m, begun = hover(0, event, tmp_path / "without", guard)
    record(
        "GPS off, stuck, wrong, jumping while hovering", fault, count=EACH, unsafe=unsafe,
        without_guard=f"without the look at its {guard}: {away_m:.2f} m, {begun} moves begun",
        away_m_max=round(max(m for m, _ in found), 2), moves_begun=sum(n for _, n in found),
    )  # fmt: skip
    assert unsafe == 0
    if guard == "jump":
        assert away_m > STEP_M
