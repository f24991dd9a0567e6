"""What all tests share: the long counts are asked for with M3R_SOAK=1."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

SHARED_MODELS = Path(__file__).resolve().parents[2] / "shared" / "models"
if SHARED_MODELS.is_dir():
    os.environ.setdefault("M3R_MODELS", str(SHARED_MODELS))  # as the Makefile does

SOAK = os.environ.get("M3R_SOAK") == "1"

# The same examples in every run of `make test`: what is new is looked for by `make soak`.
settings.register_profile("sample", deadline=None, max_examples=50, derandomize=True)
settings.register_profile("soak", deadline=None, max_examples=5000)
settings.load_profile("soak" if SOAK else "sample")


TESTS = Path(__file__).resolve().parent
PURE = (
    "safety",
    "mutation",
    "test_golden_flights.py",
    "test_house.py",
    "test_readme.py",
    "test_trace_page.py",
    "config",
    "m3r_app/test_arbiter.py",
    "m3r_app/test_out_there.py",
    "m3r_app/test_modes.py",
    "m3r_app/test_fusion.py",
    "m3r_app/test_arbiter_corners.py",
    "m3r_app/test_ground_work.py",
    "m3r_app/test_hillside.py",
    "formal",
    "m3r_app/evidence",
    "m3r_app/test_chain.py",
    "m3r_app/test_replay.py",
    "m3r_app/test_properties.py",
    "test_flights.py",
    "test_golden.py",
    "soak",  # what is unsafe once is unsafe
)
AGAIN = 2


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What is long is passed by `make soak`; skipped by name, so that everybody sees it.

    Tests that fly, listen and watch in real time may be held up by whatever else the machine does, for longer than an operator
    would accept of it: one that fails is tried again, and the summary names it. Pure tests never are.
    """
    # What one process passes in a row, and what flies for long, begins first, so that nobody waits for it at the end.
    items.sort(key=lambda item: item.get_closest_marker("xdist_group") is None and not item.path.stem.endswith("_run"))
    for item in items:
        if not any(item.path.is_relative_to(TESTS / room) for room in PURE):
            item.add_marker(pytest.mark.flaky(reruns=AGAIN))
    if not SOAK:
        for item in items:
            if item.get_closest_marker("soak") is not None:
                item.add_marker(pytest.mark.skip(reason="long: passed with M3R_SOAK=1 (make soak)"))


@pytest.fixture(autouse=True)
def _transitions_are_in_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """In flight a transition that the mode machine does not have is told and not taken; in a test it is a fault."""

    def raised(state: object, cause: object) -> None:
        raise AssertionError(f"the mode machine has no {cause} in {state}")

    monkeypatch.setattr("m3r_app.arbiter.context.impossible", raised)


@pytest.fixture(autouse=True)
def _own_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """No test depends on how the person who runs it has set M3R up."""
    monkeypatch.delenv("M3R_DEBUG", raising=False)
