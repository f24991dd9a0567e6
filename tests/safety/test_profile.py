"""Profile: rest to rest in closed form, and its inverse. R8."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from safety.vocabulary import Profile

profiles = st.builds(Profile, st.floats(1e-3, 400.0), st.floats(0.05, 50.0), st.floats(0.1, 50.0))


@given(profiles, st.floats(0.0, 1.0))
def test_time_at_is_the_inverse_of_at(profile: Profile, share: float) -> None:
    covered = share * profile.distance
    assert profile.at(profile.time_at(covered)) == pytest.approx(covered, abs=1e-6 * profile.distance + 1e-9)


@given(profiles, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_it_never_goes_back(profile: Profile, a: float, b: float) -> None:
    early, late = sorted((a * profile.duration_s, b * profile.duration_s))
    assert profile.at(early) <= profile.at(late) + 1e-9 * profile.distance


@pytest.mark.requirement("R8")
@given(profiles)
def test_ends_and_peak(profile: Profile) -> None:
    assert profile.at(0.0) == profile.at(-1.0) == 0.0
    assert profile.at(profile.duration_s) == profile.at(profile.duration_s + 9.0) == profile.distance
    assert profile.at(0.5 * profile.duration_s) == pytest.approx(0.5 * profile.distance)
    assert profile.peak <= profile.speed
    assert profile.time_at(profile.distance) == profile.duration_s
    assert profile.time_at(0.0) == 0.0


@pytest.mark.requirement("R8")
@pytest.mark.parametrize(("distance", "peak", "duration_s"), [
    (0.5, 0.5, 2.0),  # just reaches its speed: a triangle that is also a trapezoid
    (1.0, 0.5, 3.0),
    (0.02, 0.1, 0.4),
    (0.0, 0.0, 0.0),
])  # fmt: skip
def test_by_hand(distance: float, peak: float, duration_s: float) -> None:
    profile = Profile(distance, 0.5, 0.5)
    assert profile.peak == pytest.approx(peak)
    assert profile.duration_s == pytest.approx(duration_s)
