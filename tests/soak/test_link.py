"""The link to the drone loses 0 to 30 %, is 50 to 1200 ms late each way, or is cut in mid maneuver: bounded all the same.

Real processes, real UDP, a proxy of our own between them; judged on the true state. Not to be paired with on such a link is
safe; moving further than one step, or not holding at the end, is not. `M3R_SOAK=1` only.
"""

from __future__ import annotations

import random
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from safety.limits import Limits
from tests.soak.bad_link import BadLink
from tests.soak.figures import record
from tests.soak.fleets import all_at_once, app, flying, furthest_m, resting, scenario

STEP_M = Limits().lateral_step_m + 0.3
RETURN = "COM_OF_LOSS_T = 0.5, COM_OBL_RC_ACT = 3"
SCRIPT = "0.2 panel go left\n6 panel go right\n"
FAMILY = "link loss, delay and cuts"

pytestmark = [pytest.mark.soak, pytest.mark.timeout(3000), pytest.mark.xdist_group("soak-flights")]


@dataclass(frozen=True)
class Flown:
    """away_m: the furthest from where it was paired; begun: moves; held: whether it holds at rest at the end."""

    away_m: float
    begun: int
    completed: int
    held: bool


def fly(
    n: int, folder: Path, *, loss: float = 0.0, delay_s: float = 0.0, cut_s: float = 0.0, weakened: bool = False
) -> Flown:
    folder.mkdir(exist_ok=True)
    place = scenario(folder, params=RETURN) if weakened else scenario(folder)
    with flying(place, folder) as (sim, truth):
        start = truth.last()["ned_m"]
        port = int(sim.urls["red"].rpartition(":")[2])
        with BadLink(port, loss=loss, delay_s=delay_s, seed=n) as link:
            running = app(sim, SCRIPT, "failsafe" if weakened else "none", "--timeout", "30", url=link.url)
            if cut_s > 0.0:
                running.until("motion", status="started")
                time.sleep(random.Random(n).uniform(0.1, 2.0))
                link.cut(cut_s)
            ran = running.finish()
        deadline_s = time.monotonic() + 5.0
        while not (held := resting(truth.last())) and time.monotonic() < deadline_s:
            time.sleep(0.05)
        motions = [e["status"] for e in ran.of("motion")]
        return Flown(furthest_m(truth.read(), start), motions.count("started"), motions.count("completed"), held)


CASES: dict[str, dict[str, float]] = {
    "loss 10 %": {"loss": 0.1},
    "loss 20 %": {"loss": 0.2},
    "loss 30 %": {"loss": 0.3},
    "delay 50 ms": {"delay_s": 0.05},
    "delay 200 ms": {"delay_s": 0.2},
    "delay 600 ms": {"delay_s": 0.6},
    "delay 1200 ms": {"delay_s": 1.2},
    "loss 30 %, delay 200 ms": {"loss": 0.3, "delay_s": 0.2},
    "cut for 0.4 s": {"cut_s": 0.4},
    "cut for 2 s": {"cut_s": 2.0},
    "cut for 10 s": {"cut_s": 10.0},
}
EACH = 4


@pytest.mark.requirement("X7", "X8")
@pytest.mark.parametrize("case", list(CASES))
def test_a_bad_link_leads_no_further_than_one_step(case: str, tmp_path: Path) -> None:
    how = CASES[case]
    found = all_at_once(lambda n: fly(n, tmp_path / str(n), **how), EACH)
    unsafe = sum(one.away_m > STEP_M or not one.held for one in found)
    without = ""
    if "cut_s" in how and how["cut_s"] >= 5.0:
        # With an autopilot that returns without setpoints, and the look at its parameters taken away.
        weak = fly(0, tmp_path / "without", weakened=True, **how)
        without = f"the autopilot's parameters not looked at before pairing: {weak.away_m:.1f} m"
        assert weak.away_m > STEP_M
    record(
        FAMILY, case, count=EACH, unsafe=unsafe, without_guard=without,
        away_m_max=round(max(one.away_m for one in found), 2), moves_begun=sum(one.begun for one in found),
        completed=sum(one.completed for one in found),
    )  # fmt: skip
    assert unsafe == 0
