"""The console in shared air: who is only heard of is drawn with its age, and what is missing stands in the title. R5, R11."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from m3r_app.arbiter.state import ArbiterState
from m3r_app.snapshot import heard_of
from safety.vocabulary import Neighbours
from tests.ui.console_stage import SMALL, flying_snapshot, hillside
from ui.console import panels

NAN = (math.nan, math.nan, math.nan)


@pytest.mark.requirement("R5")
def test_who_is_only_heard_of_is_in_the_snapshot_once() -> None:
    neighbours = Neighbours(
        ("blue", "yellow", "lost"),
        np.array([(1.0, 2.0, -3.0), (4.0, 5.0, -6.0), NAN]),
        np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), NAN]),
        np.array([0.3, 0.4, math.nan]),
        np.array([99.0, 98.5, -math.inf]),
        99.9,
    )
    state: ArbiterState = replace(flying_snapshot(hillside()).state, neighbours=neighbours)
    yellow, lost = heard_of(state, frozenset({"red", "blue"}), 100.0)
    assert (yellow.name, yellow.position, yellow.age_s, yellow.ours) == ("yellow", (4.0, 5.0, -6.0), 1.5, False)
    assert lost.position is None and lost.velocity is None and lost.age_s == math.inf


def test_what_is_missing_of_the_shared_air_stands_in_the_title() -> None:
    snapshot = flying_snapshot(hillside())
    assert "broker" not in panels.title(snapshot, dry_run=False, looking=False).plain
    title = panels.title(replace(snapshot, air_trouble="no broker"), dry_run=True, looking=False)
    assert "no broker" in title.plain
    assert len(title.plain) <= SMALL[0]
