"""The settings: defaults equal to `Limits`, every key settable, every wrong one a sentence."""

from __future__ import annotations

import dataclasses
import math
import re
import tomllib
from importlib import resources
from typing import TYPE_CHECKING

import pytest
from annotated_types import Ge, Le

from config.settings import AT_MOST, Settings, SettingsError, allowed, leaves, load_settings
from safety.limits import Limits
from safety.requirements import REQUIREMENTS

if TYPE_CHECKING:
    from pathlib import Path

DEFAULT_TEXT = resources.files("config").joinpath("default.toml").read_text(encoding="utf-8")
DEFAULTS = dict(leaves(tomllib.loads(DEFAULT_TEXT)))
NUMBERS = [key for key, value in DEFAULTS.items() if isinstance(value, float)]
SWITCHES = [key for key, value in DEFAULTS.items() if isinstance(value, bool)]
WORDS = [key for key in DEFAULTS if key not in (*NUMBERS, *SWITCHES)]
LIMITS = [field.name for field in dataclasses.fields(Limits)]


def bounds(key: str) -> tuple[float, float]:
    section, _, name = key.partition(".")
    metadata = Settings.model_fields[section].annotation.model_fields[name].metadata
    (low,) = (bound.ge for bound in metadata if isinstance(bound, Ge))
    (high,) = (bound.le for bound in metadata if isinstance(bound, Le))
    return low, high


def refusal(*overrides: str, files: tuple[Path, ...] = ()) -> str:
    with pytest.raises(SettingsError) as caught:
        load_settings(files, overrides)
    sentence = str(caught.value)
    assert "\n" not in sentence
    return sentence


def test_defaults_are_the_limits_defaults() -> None:
    assert load_settings().limits() == Limits()


def test_default_toml_holds_exactly_the_settings() -> None:
    assert {key for key, _ in leaves(load_settings().model_dump())} == set(DEFAULTS)


@pytest.mark.parametrize("name", LIMITS)
def test_every_limit_is_settable(name: str) -> None:
    (key,) = (key for key in NUMBERS if key.rpartition(".")[2] == name)
    low, high = bounds(key)
    # A small step keeps clear of the bounds that two keys have in common.
    step = (high - low) * 1e-3
    value = DEFAULTS[key] - step if DEFAULTS[key] - step >= low else DEFAULTS[key] + step
    limits = load_settings([], [f"{key}={value!r}"]).limits()
    assert getattr(limits, name) == value
    assert dataclasses.replace(limits, **{name: getattr(Limits(), name)}) == Limits()


@pytest.mark.parametrize("key", NUMBERS)
def test_bounds_are_finite_and_said_in_the_file(key: str) -> None:
    low, high = bounds(key)
    assert math.isfinite(low)
    assert math.isfinite(high)
    assert low < high
    name = key.rpartition(".")[2]
    line = next(line for line in DEFAULT_TEXT.splitlines() if line.startswith(f"{name} ="))
    assert line.endswith(f"; {low:g} to {high:g}")


@pytest.mark.parametrize("key", NUMBERS)
def test_out_of_bounds_is_refused_and_the_bound_itself_is_not_by_its_own_rule(key: str) -> None:
    low, high = bounds(key)
    for value in (math.nextafter(low, -math.inf), math.nextafter(high, math.inf)):
        sentence = refusal(f"{key}={value!r}")
        assert sentence == f"setting {key} is {value!r} (--set {key}={value!r}), but must be {allowed(key)}"
    for value in (low, high):
        try:
            loaded = load_settings([], [f"{key}={value!r}"])
        except SettingsError as error:
            assert "may not exceed" in str(error)  # noqa: PT017  (the other outcome is asserted below)
        else:
            assert dict(leaves(loaded.model_dump()))[key] == value


@pytest.mark.parametrize("key", NUMBERS)
@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e999", "true", '"1"', "[1]", "{}", "fast", "9" * 400])
def test_what_is_no_finite_number_is_refused(key: str, value: str) -> None:
    assert f"setting {key} is " in refusal(f"{key}={value}")


@pytest.mark.parametrize("key", WORDS)
def test_words(key: str) -> None:
    for word in re.findall(r'"(\w+)"', allowed(key)):
        for written in (word, f'"{word}"'):
            assert dict(leaves(load_settings([], [f"{key} = {written}"]).model_dump()))[key] == word
    assert refusal(f"{key}=sideways").endswith(f"but must be {allowed(key)}")
    assert refusal(f"{key}=1").endswith(f"but must be {allowed(key)}")


@pytest.mark.parametrize("key", SWITCHES)
def test_switches(key: str) -> None:
    for word, value in (("true", True), ("false", False)):
        assert dict(leaves(load_settings([], [f"{key}={word}"]).model_dump()))[key] is value
    for word in ("1", "0.0", "yes", '"true"', "[]"):
        assert refusal(f"{key}={word}").endswith("but must be true or false")


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("envelope.sped_m_s=1", "did you mean envelope.speed_m_s?"),
        ("clearance_m=2", "did you mean clearance.clearance_m?"),
        ("terrain.clearance_m=2", "did you mean clearance.clearance_m?"),
        ("neighbors=none", "did you mean neighbours?"),
        ("qqqq=1", "default.toml lists them all"),
        ("envelope=1", "is a section"),
        ("envelope", "is not KEY=VALUE"),
        ("=1", "is not KEY=VALUE"),
        ("replace=", "is not KEY=VALUE"),
        ("", "is not KEY=VALUE"),
    ],
)
def test_a_wrong_override_is_named(override: str, said: str) -> None:
    sentence = refusal(override)
    assert f"--set {override}" in sentence
    assert said in sentence


def test_an_override_cannot_smuggle_a_second_key() -> None:
    assert "setting replace is" in refusal('replace="off"\nterrain="flat"')


@pytest.mark.parametrize(("smaller", "larger"), AT_MOST)
def test_pairs(smaller: str, larger: str) -> None:
    high = bounds(smaller)[1]
    below = math.nextafter(high, -math.inf)
    wide = [f"envelope.{axis}_step_m=4.9" for axis in ("lateral", "vertical")]
    load_settings([], [*wide, f"{smaller}={high}", f"{larger}={high}"])
    sentence = refusal(*wide, f"{smaller}={high}", f"{larger}={below!r}")
    assert f"setting {smaller} is {high} (" in sentence
    assert f"may not exceed {larger}, which is {below!r} (" in sentence


def test_later_wins(tmp_path: Path) -> None:
    first, second = tmp_path / "a.toml", tmp_path / "b.toml"
    first.write_text("[envelope]\nspeed_m_s = 1\nlateral_step_m = 2\n")
    second.write_text('terrain = "flat"\nenvelope.speed_m_s = 0.4\n')
    settings = load_settings([first, second], ["envelope.lateral_step_m=0.5"])
    assert (settings.envelope.speed_m_s, settings.envelope.lateral_step_m, settings.terrain) == (0.4, 0.5, "flat")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"[envelope]\nspeed_m_s = 9\n", "setting envelope.speed_m_s is 9"),
        (b"[envelope]\nsped_m_s = 1\n", "did you mean envelope.speed_m_s?"),
        (b"envelope = 1\n", "is a section"),
        (b"[[envelope]]\nspeed_m_s = 1\n", "is a section"),
        (b"[envelop]\n", "there is no setting envelop"),
        (b"[terrain]\n", "setting terrain is {}"),
        (b"[envelope.speed_m_s]\nfast = 1\n", "there is no setting envelope.speed_m_s.fast"),
        (b"[terrain]\nclearance_m = 2\n", "did you mean clearance.clearance_m?"),
        (b"speed = [", "is not TOML"),
        (b"\xff\xfe", "is not TOML"),
        (b"a = " + b"[" * 100_000, "is not TOML"),
    ],
)
def test_a_wrong_file_is_named(tmp_path: Path, text: bytes, said: str) -> None:
    path = tmp_path / "my settings.toml"
    path.write_bytes(text)
    sentence = refusal(files=(path,))
    assert str(path) in sentence
    assert said in sentence


def test_an_empty_section_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "empty.toml"
    path.write_text("[envelope]\n")
    assert load_settings([path]) == load_settings()


def test_missing_file_and_folder_are_named(tmp_path: Path) -> None:
    assert "cannot be read: No such file" in refusal(files=(tmp_path / "none.toml",))
    assert "cannot be read: Is a directory" in refusal(files=(tmp_path,))


def test_settings_are_frozen() -> None:
    settings = load_settings()
    with pytest.raises(ValueError, match="frozen"):
        settings.envelope.speed_m_s = 2.0


def test_only_requirements_that_exist_are_named_in_the_file() -> None:
    assert set(re.findall(r"\b[RPGX]\d+\b", DEFAULT_TEXT)) <= set(REQUIREMENTS)
