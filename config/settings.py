"""The typed settings: `default.toml`, then files, then `--set`, each checked key by key. Builds `safety.limits.Limits`.

Values live in `default.toml` alone; here are their types and bounds. Everything is finite and bounded on the safe side,
so that no configuration turns a rule off.
"""

from __future__ import annotations

import dataclasses
import difflib
import tomllib
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from annotated_types import Ge, Le
from pydantic import BaseModel, ConfigDict, ValidationError

from safety.limits import Limits

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path


class SettingsError(ValueError):
    """A settings file or `--set` that cannot be used; one sentence for the person who wrote it."""


class Section(BaseModel):
    """Frozen, no unknown keys, no conversions, no NaN."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Envelope(Section):
    """Bounds of one maneuver. Source: R2, R8, G6, X9."""

    lateral_step_m: Annotated[float, Ge(0.1), Le(5)]
    vertical_step_m: Annotated[float, Ge(0.1), Le(5)]
    shortest_m: Annotated[float, Ge(0.05), Le(1)]
    speed_m_s: Annotated[float, Ge(0.05), Le(2)]
    descend_speed_m_s: Annotated[float, Ge(0.05), Le(2)]
    acceleration_m_s2: Annotated[float, Ge(0.1), Le(2)]
    yaw_rate_deg_s: Annotated[float, Ge(1), Le(60)]
    yaw_acceleration_deg_s2: Annotated[float, Ge(1), Le(120)]
    engaging_s: Annotated[float, Ge(0.2), Le(5)]
    arrived_m: Annotated[float, Ge(0.02), Le(0.5)]
    linger_s: Annotated[float, Ge(0), Le(10)]
    facing_tolerance_deg: Annotated[float, Ge(1), Le(20)]
    settling_timeout_s: Annotated[float, Ge(1), Le(60)]
    duration_factor: Annotated[float, Ge(1), Le(5)]
    duration_extra_s: Annotated[float, Ge(0), Le(30)]
    speed_tolerance_m_s: Annotated[float, Ge(0.05), Le(0.5)]


class Clearance(Section):
    """Distances from the ground and what stands on it. Source: R3, R4, G2, G5."""

    min_agl_m: Annotated[float, Ge(0.5), Le(120)]
    clearance_m: Annotated[float, Ge(0.3), Le(50)]
    obstacle_clearance_m: Annotated[float, Ge(0.3), Le(50)]
    flat_sigma_m: Annotated[float, Ge(0.1), Le(10)]


class Separation(Section):
    """Distance from other aircraft and how well they are known. Source: R5, R6, R11, G3."""

    separation_m: Annotated[float, Ge(1), Le(200)]
    neighbour_age_s: Annotated[float, Ge(0.1), Le(5)]
    neighbour_acceleration_m_s2: Annotated[float, Ge(0.5), Le(20)]
    neighbour_turn: Annotated[float, Ge(0), Le(1)]
    silent_speed_m_s: Annotated[float, Ge(0), Le(20)]
    look_ahead_s: Annotated[float, Ge(0.5), Le(10)]
    horizon_s: Annotated[float, Ge(1), Le(60)]


class Workspace(Section):
    """Balls about the anchor and about the place of pairing. Source: R7, X1."""

    workspace_m: Annotated[float, Ge(0.5), Le(50)]
    session_m: Annotated[float, Ge(1), Le(500)]
    drift_m_s: Annotated[float, Ge(0), Le(0.5)]


class OperatorSettings(Section):
    """Distance from the operator and how well that place is known. Source: X2, X8."""

    standoff_m: Annotated[float, Ge(1), Le(50)]
    sigma_m: Annotated[float, Ge(0.01), Le(10)]


class Pairing(Section):
    """What a drone must be to be paired with. Source: P1, X8."""

    range_m: Annotated[float, Ge(5), Le(500)]
    operator_sigma_max_m: Annotated[float, Ge(0.1), Le(20)]
    operator_height_m: Annotated[float, Ge(0.5), Le(5)]
    landed_height_m: Annotated[float, Ge(0.1), Le(3)]
    home_height_m: Annotated[float, Ge(0.5), Le(10)]
    rangefinder_tilt: Annotated[float, Ge(0.01), Le(0.5)]
    settle_s: Annotated[float, Ge(2), Le(60)]
    silent_s: Annotated[float, Ge(1), Le(60)]
    facing_timeout_s: Annotated[float, Ge(5), Le(120)]
    answer_s: Annotated[float, Ge(1), Le(120)]


class Confidence(Section):
    """Least confidence of inputs, localisation and terrain. Source: R11, G1, P2, X6."""

    confidence_voice: Annotated[float, Ge(0.3), Le(1)]
    confidence_gesture: Annotated[float, Ge(0.3), Le(1)]
    confidence_panel: Annotated[float, Ge(0.3), Le(1)]
    localization_min: Annotated[float, Ge(0.1), Le(1)]
    localization_half_m: Annotated[float, Ge(0.1), Le(5)]
    terrain_confidence_min: Annotated[float, Ge(0.1), Le(1)]
    terrain_half_m: Annotated[float, Ge(0.1), Le(5)]
    disagreement_m: Annotated[float, Ge(0.1), Le(5)]
    noisy_disagreement_m: Annotated[float, Ge(0.1), Le(10)]
    disagreement_max_m: Annotated[float, Ge(0.1), Le(10)]
    jump_m: Annotated[float, Ge(0.2), Le(5)]
    speed_plausible_m_s: Annotated[float, Ge(5), Le(30)]
    battery_min: Annotated[float, Ge(0), Le(0.9)]
    telemetry_age_s: Annotated[float, Ge(0.1), Le(2)]
    position_lost_s: Annotated[float, Ge(1), Le(30)]
    request_age_s: Annotated[float, Ge(1), Le(10)]
    request_ahead_s: Annotated[float, Ge(0), Le(1)]


class VoiceSettings(Section):
    """How the operator is listened to. Source: R1, X4."""

    push_to_talk: bool


class Gesture(Section):
    """How hands are watched. Source: R1, X4."""

    hold_s: Annotated[float, Ge(0.3), Le(2)]
    mirrored: bool
    region: Literal["all", "left", "right"]


Asks = Literal[
    "none",
    "go_left",
    "go_right",
    "go_forward",
    "go_back",
    "go_up",
    "go_down",
    "turn_left",
    "turn_right",
    "stop",
    "continue",
]
"""What a control of a gamepad may ask for. Pairing and letting go need to be meant: they are no single press."""


class GamepadSettings(Section):
    """What each control of a gamepad asks for; sticks and triggers are STOP, which no setting changes. Source: R1, X4."""

    dead_zone: Annotated[float, Ge(0.05), Le(0.6)]
    hat_left: Asks
    hat_right: Asks
    hat_up: Asks
    hat_down: Asks
    button_0: Asks
    button_1: Asks
    button_2: Asks
    button_3: Asks
    button_4: Asks
    button_5: Asks
    button_6: Asks
    button_7: Asks
    button_8: Asks
    button_9: Asks
    button_10: Asks
    button_11: Asks
    button_12: Asks
    button_13: Asks
    button_14: Asks
    button_15: Asks
    button_16: Asks


class Uncertainty(Section):
    """What is added to every required distance. Source: X11."""

    sigma_k: Annotated[float, Ge(1), Le(5)]
    lag_s: Annotated[float, Ge(0.1), Le(3)]
    stop_deceleration_m_s2: Annotated[float, Ge(0.2), Le(5)]
    tracking_m: Annotated[float, Ge(0.1), Le(2)]
    noisy_tracking_m: Annotated[float, Ge(0.1), Le(5)]
    tracking_max_m: Annotated[float, Ge(0.1), Le(5)]
    rest_m_s: Annotated[float, Ge(0.05), Le(0.5)]
    hover_s: Annotated[float, Ge(0.5), Le(10)]
    learn_s: Annotated[float, Ge(2), Le(60)]
    noise_k: Annotated[float, Ge(1), Le(5)]


class DecisionSettings(Section):
    """Shortening, waiting, fusing. Source: P3, X5, X10, X12, R10."""

    reservation_timeout_s: Annotated[float, Ge(0.2), Le(5)]
    bisection_m: Annotated[float, Ge(0.001), Le(0.05)]
    delay_s: Annotated[float, Ge(0), Le(10)]
    fusion_window_s: Annotated[float, Ge(0.1), Le(5)]
    continue_within_s: Annotated[float, Ge(1), Le(300)]
    return_after_s: Annotated[float, Ge(1), Le(30)]


class Settings(Section):
    """All settings in effect. Made by `load_settings`; units are in the names, bounds beside the fields."""

    neighbours: Literal["fleet", "none"]
    terrain: Literal["scenario", "flat"]
    battery: Literal["required", "unknown"]
    return_to_anchor: Literal["auto", "ask", "never"]
    on_disconnect: Literal["hold", "resume"]
    position_lost: Literal["hold", "land"]
    replace: Literal["off", "offer"]
    envelope: Envelope
    clearance: Clearance
    separation: Separation
    workspace: Workspace
    operator: OperatorSettings
    pairing: Pairing
    confidence: Confidence
    voice: VoiceSettings
    gesture: Gesture
    gamepad: GamepadSettings
    uncertainty: Uncertainty
    decision: DecisionSettings

    def limits(self) -> Limits:
        """The thresholds that the rules compare with: every field of `Limits` stands in exactly one section."""
        wanted = {field.name for field in dataclasses.fields(Limits)}
        values = {key.rpartition(".")[2]: value for key, value in leaves(self.model_dump())}
        return Limits(**{name: float(value) for name, value in values.items() if name in wanted})


AT_MOST = (
    ("envelope.shortest_m", "envelope.lateral_step_m"),
    ("envelope.shortest_m", "envelope.vertical_step_m"),
    ("envelope.descend_speed_m_s", "envelope.speed_m_s"),
    ("envelope.lateral_step_m", "workspace.workspace_m"),
    ("envelope.vertical_step_m", "workspace.workspace_m"),
    ("workspace.workspace_m", "workspace.session_m"),
    ("operator.standoff_m", "pairing.range_m"),
    ("confidence.disagreement_m", "confidence.disagreement_max_m"),
    ("confidence.noisy_disagreement_m", "confidence.disagreement_max_m"),
    ("uncertainty.tracking_m", "uncertainty.tracking_max_m"),
    ("uncertainty.noisy_tracking_m", "uncertainty.tracking_max_m"),
    ("uncertainty.hover_s", "uncertainty.learn_s"),
)
"""Pairs of keys of which the first may not exceed the second."""


@dataclass(frozen=True)
class _Given:
    """A value and the place a person wrote it."""

    value: object
    source: str


def load_settings(files: Sequence[Path] = (), overrides: Sequence[str] = ()) -> Settings:
    """The defaults, then each file, then each `KEY=VALUE`; the later wins.

    Raises SettingsError with one sentence that names the key, the value, where it was written, and what is allowed.
    """
    text = resources.files("config").joinpath("default.toml").read_text(encoding="utf-8")
    given = {key: _Given(value, "default.toml") for key, value in leaves(tomllib.loads(text))}
    for path in files:
        given.update(_of_file(path, given.keys()))
    for override in overrides:
        given.update(_of_override(override, given.keys()))
    try:
        settings = Settings.model_validate(_tree({key: entry.value for key, entry in given.items()}))
    except ValidationError as error:
        raise SettingsError(_sentence(error, given)) from None
    _check_pairs(given)
    return settings


def leaves(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """(dotted key, value) of everything in a nested mapping that is not a section itself, unless an empty one."""
    for name, value in tree.items():
        if isinstance(value, dict) and value:
            yield from leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _of_file(path: Path, known: Iterable[str]) -> dict[str, _Given]:
    try:
        tree = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"settings file {path} cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise SettingsError(f"settings file {path} is not TOML: {' '.join(str(error).split())}") from None
    found = {}
    for key, value in leaves(tree):
        if value == {} and any(name.startswith(f"{key}.") for name in known):
            continue  # an empty section changes nothing
        _check_known(key, str(path), known)
        found[key] = _Given(value, str(path))
    return found


def _of_override(override: str, known: Iterable[str]) -> dict[str, _Given]:
    key, equals, written = (part.strip() for part in override.partition("="))
    source = f"--set {' '.join(override.split())}"
    if not equals or not key or not written:
        raise SettingsError(f"{source} is not KEY=VALUE, for example --set envelope.speed_m_s=0.3")
    _check_known(key, source, known)
    return {key: _Given(_toml_value(written), source)}


def _toml_value(written: str) -> object:
    """A TOML value; what is none is a bare word. Anything that is not one value stays text and fails its type check."""
    try:
        parsed = tomllib.loads(f"value = {written}")
    except (ValueError, RecursionError):
        return written
    return parsed["value"] if len(parsed) == 1 else written


def _check_known(key: str, source: str, known: Iterable[str]) -> None:
    if key in known:
        return
    inside = [name for name in known if name.startswith(f"{key}.")]
    if inside:
        raise SettingsError(f"{key} ({source}) is a section, not a setting; set one of its keys, such as {inside[0]}")
    raise SettingsError(f"there is no setting {key} ({source}){_guess(key, known)}")


def _guess(key: str, known: Iterable[str]) -> str:
    """A did-you-mean: the same last word in another section, else the closest spelling."""
    name = key.rpartition(".")[2]
    by_name = {full.rpartition(".")[2]: full for full in known}
    close = difflib.get_close_matches(name, by_name, n=1) or difflib.get_close_matches(key, list(known), n=1)
    if close:
        return f"; did you mean {by_name.get(close[0], close[0])}?"
    return "; default.toml lists them all"


def _tree(values: Mapping[str, object]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for key, value in values.items():
        section, dot, name = key.rpartition(".")
        (tree.setdefault(section, {}) if dot else tree)[name] = value
    return tree


def _sentence(error: ValidationError, given: Mapping[str, _Given]) -> str:
    """The first thing wrong, in words."""
    key = ".".join(str(part) for part in error.errors(include_url=False)[0]["loc"])
    entry = given[key]
    return f"setting {key} is {_shown(entry.value)} ({entry.source}), but must be {allowed(key)}"


def _shown(value: object) -> str:
    shown = " ".join(value.split()) if isinstance(value, str) else repr(value)
    return shown if len(shown) <= 60 else f"{shown[:57]}..."


def allowed(key: str) -> str:
    """What the setting `key` may be, in words. Raises KeyError for an unknown key."""
    section, _, name = key.rpartition(".")
    model: Any = Settings.model_fields[section].annotation if section else Settings
    field = model.model_fields[name]
    if field.annotation is bool:
        return "true or false"
    words = get_args(field.annotation)
    if words:
        return " or ".join(f'"{word}"' for word in words)
    low = next(bound.ge for bound in field.metadata if isinstance(bound, Ge))
    high = next(bound.le for bound in field.metadata if isinstance(bound, Le))
    return f"a number from {low} to {high}"


def _check_pairs(given: Mapping[str, _Given]) -> None:
    for smaller, larger in AT_MOST:
        low, high = given[smaller], given[larger]
        if low.value > high.value:  # type: ignore[operator]  # both are numbers: validated
            raise SettingsError(
                f"setting {smaller} is {low.value} ({low.source}), "
                f"but may not exceed {larger}, which is {high.value} ({high.source})"
            )
