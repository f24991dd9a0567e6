"""Everything here flies a real PX4 SITL and is skipped by name without one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.px4.flight import Flight
from tests.px4.sitl import Px4, binary, etc_of


def _started(variable: str, folder: Path) -> Px4:
    px4 = binary(variable)
    if px4 is None:
        pytest.skip(f"a real PX4: passed with {variable}=path/to/px4 (make px4)")
    assert px4.is_file(), f"{variable}={px4}: there is no such file"
    assert etc_of(px4).is_dir(), f"{etc_of(px4)} is not there: say where PX4's etc folder is with M3R_PX4_ETC"
    folder.mkdir()
    return Px4(px4, folder)


@pytest.fixture
def px4(tmp_path: Path) -> Iterator[Px4]:
    """A fresh one with its stock noise, on the ground."""
    with _started("M3R_PX4", tmp_path / "px4") as one:
        yield one


@pytest.fixture
def quiet_px4(tmp_path: Path) -> Iterator[Px4]:
    """A fresh one without noise."""
    with _started("M3R_PX4_QUIET", tmp_path / "px4") as one:
        yield one


@pytest.fixture
def fly(tmp_path: Path) -> Iterator[Callable[..., Flight]]:
    """Starts the product on a PX4; whatever still runs afterwards is ended."""
    with ExitStack() as stack:
        count = 0

        def start(px4: Px4, script: str, *more: str, port: int | None = None) -> Flight:
            nonlocal count
            count += 1
            flight = Flight(px4, tmp_path / f"app{count}", script, *more, port=port)
            stack.callback(flight.close)
            return flight

        yield start
