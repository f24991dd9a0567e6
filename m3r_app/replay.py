"""A flight record taken step by step once more: the same, bit for bit, or what would have been decided under other limits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from m3r_app.arbiter.effects import Effect, Report
from m3r_app.arbiter.state import ArbiterState, Policy
from m3r_app.arbiter.step import step
from m3r_app.output import DecisionEvent, RequestEvent
from m3r_app.record.recorder import RecordError
from m3r_app.step_record import RecordedFlight, RecordedStep, StateDigest, read_flight
from safety.limits import Limits


@dataclass(frozen=True)
class Difference:
    """Where a replay first departs from its record."""

    number: int
    t_s: float
    event: str
    what: str


@dataclass(frozen=True)
class Replay:
    """What a replay came to. missing: steps that the record lacks; whole: it was closed and nothing is missing.

    same_source: the code that decided then is byte for byte this one; None: the record does not say.
    """

    path: Path
    steps: int
    length_s: float
    missing: int
    whole: bool
    same_source: bool | None
    difference: Difference | None


def replay(path: Path, source_sha256: str) -> Replay:
    """Take every step of a record and compare all effects and states. Raises RecordError."""
    flight = read_flight(path)
    state, digest = flight.start, StateDigest(flight.text)
    count = missing = 0
    length_s = 0.0
    difference = None
    for recorded in flight.steps():
        missing = recorded.number - count - 1
        if missing:
            break  # from here on the state is not known any more
        count, length_s = recorded.number, recorded.t_s
        state, effects, now = _again(path, state, recorded, digest)
        difference = _compared(flight, recorded, effects, now)
        if difference is not None:
            break
    return Replay(
        path,
        count,
        length_s,
        missing,
        flight.complete and not missing,
        None if "source_sha256" not in flight.metadata else flight.metadata["source_sha256"] == source_sha256,
        difference,
    )


def _again(
    path: Path, state: ArbiterState, recorded: RecordedStep, digest: StateDigest | None = None
) -> tuple[ArbiterState, tuple[Effect, ...], str]:
    """One step, and the digest of the state after it. Raises RecordError: what no m3r has written may be anything."""
    try:
        state, effects = step(state, recorded.event, recorded.now_s)
        return state, effects, digest.of(state) if digest is not None else ""
    except Exception as error:  # noqa: BLE001
        why = f"step {recorded.number} cannot be taken ({type(error).__name__}: {error}): it holds what no m3r writes"
        raise RecordError(f"{path} cannot be replayed: {why}") from None


def _compared(
    flight: RecordedFlight, recorded: RecordedStep, effects: tuple[Effect, ...], digest: str
) -> Difference | None:
    event = type(recorded.event).__name__
    now = flight.text.text(effects)
    if now != recorded.effects:
        what = f"it was {recorded.effects[:200]}, and is {now[:200]}"
        return Difference(recorded.number, recorded.t_s, event, f"what the shell is to do differs: {what}")
    if digest != recorded.state_digest:
        return Difference(recorded.number, recorded.t_s, event, "the state after it differs")
    return None


@dataclass(frozen=True)
class Fate:
    """What became of one request. granted_m: of metres or degrees asked for; verdicts: empty where there was none."""

    request: str
    command: str
    verdict: str = ""
    granted_m: float | None = None
    failed: tuple[str, ...] = ()
    """The constraints that did not pass."""


def fates(path: Path, limits: Limits | None = None, policy: Policy | None = None) -> tuple[Fate, ...]:
    """Every request of a record with its final decision, judged with these limits instead of its own.

    What was flown stays as it was: each decision is that of its moment, with the drone where it really was. Raises RecordError.
    """
    flight = read_flight(path)
    state = flight.start
    state = replace(state, limits=limits or state.limits, policy=policy or state.policy)
    found: dict[str, Fate] = {}
    for recorded in flight.steps():
        state, effects, _ = _again(path, state, recorded)
        for effect in effects:
            if isinstance(effect, Report):
                _told(found, effect)
    return tuple(found.values())


def _told(found: dict[str, Fate], effect: Report) -> None:
    match effect.told:
        case RequestEvent() as request:
            found.setdefault(request.id, Fate(request.id, request.command))
        case DecisionEvent() as decision if decision.request in found:
            failed = tuple(one.constraint for one in decision.findings if not one.passed)
            found[decision.request] = replace(
                found[decision.request], verdict=str(decision.verdict), granted_m=decision.granted_m, failed=failed
            )
