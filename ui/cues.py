"""What is spoken of a run: short cues, named by the drone's colour, in the operator's directions. Pure.

The words are chosen by what real recognition makes of them: "other aircraft" became *go left* and "waits, Blue" *activate blue*.
A cue must never be a request: the word *stop* is not in it (it says *holding*), and no phrase of `modalities.voice.phrases` is, as a
whole or in part, so a name that holds a word of them is not spoken either. Source: R1, X4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import assert_never

from m3r_app.output import (
    RETURN,
    Action,
    AnnounceEvent,
    DecisionEvent,
    EndEvent,
    FindingTold,
    ModeEvent,
    MotionEvent,
    MotionStatus,
    Notice,
    OutputEvent,
    PairEvent,
    PairStatus,
    RequestEvent,
    Told,
    ViolationEvent,
)
from modalities.voice.phrases import PhraseTable, normalise
from safety.constraints import DECLARED
from safety.declarations import CONTRADICTION, INPUT_CONFIDENCE, PAIRED
from safety.vocabulary import Cause, Command, Modality, Verdict

COMMAND_WORDS = frozenset(PhraseTable(("x",)).words) - {"x"}
AGAIN_S = 10.0
"""While nothing else changes, the same is told again only after this long."""
TOGETHER_S = 0.2
"""Violations this close together are one: the first is spoken, all are written."""
REMEMBERED = 32
"""Requests that may still be decided or flown."""
LONGEST_NAME = 3
"""Words of an obstacle's name; a longer one is just an obstacle."""


@dataclass(frozen=True, slots=True)
class Cue:
    """One short sentence. urgent: it may cut off what is being spoken."""

    text: str
    urgent: bool = False


_WORD: dict[Command, tuple[str, str]] = {
    Command.GO_LEFT: ("left", "left refused"),
    Command.GO_RIGHT: ("right", "right refused"),
    Command.GO_FORWARD: ("forward", "forward refused"),
    Command.GO_BACK: ("back", "back refused"),
    Command.GO_UP: ("up", "up refused"),
    Command.GO_DOWN: ("down", "down refused"),
    Command.TURN_LEFT: ("left turn", "left turn refused"),
    Command.TURN_RIGHT: ("right turn", "right turn refused"),
    Command.CONTINUE: ("going on", "going on refused"),
}
"""What is flown and what is not, for each command; "turn left" would be a request."""

_BEYOND = {Command.GO_UP: "above", Command.GO_DOWN: "below"}
_UNSURE = {Modality.VOICE: "not sure what you said", Modality.GESTURE: "not sure what you showed"}
_CONTRADICTED = {"X5": "holding, two different requests", "X12": "nothing to go on with"}
"""By requirement; what STOP or a newer request withdrew has been answered by their own cue."""

_OF_THE_DRONE: dict[Notice, tuple[str, bool]] = {
    Notice.TAKING_OFF: ("taking off", False),
    Notice.RETURNING_SOON: ("returning soon", True),
    Notice.NOT_RETURNING_YET: ("not returning yet", False),
    Notice.ASKS_TO_RETURN: ("asks to return", False),
    Notice.NOT_DISCONNECTED: ("still paired, ask again", False),
    Notice.VEHICLE_SILENT: ("lost", True),
}
"""Announcements that no other event tells, in the drone's name: the cue, and whether it is urgent."""
_OF_THE_SENSES: dict[Notice, Cue] = {
    Notice.VOICE_GONE: Cue("You are not heard", urgent=True),
    Notice.VOICE_BACK: Cue("You are heard again"),
    Notice.VOICE_OFF: Cue("Voice is lost", urgent=True),
    Notice.HANDS_OFF: Cue("Hands are lost", urgent=True),
    Notice.HANDS_NOT_SEEN: Cue("Hands are not seen", urgent=True),
    Notice.HANDS_SEEN_AGAIN: Cue("Hands are seen again"),
}


class Cues:
    """From the events of one run, in their order, to what is spoken of them."""

    def __init__(self, *, dry_run: bool = False) -> None:
        """dry_run: what is approved is not flown."""
        self._dry_run = dry_run
        self._drone = ""
        self._paired = False
        self._lost = False
        self._violated_s = -TOGETHER_S
        self._asked: dict[str, tuple[Command, Modality]] = {}
        self._said: dict[str, float] = {}

    def of(self, told: Told) -> Cue | None:
        """What is spoken of this event; None: nothing, or nothing new."""
        if _changes(told.event):
            self._said.clear()
        cue = self._cue(told)
        if cue is None or told.t_s - self._said.get(cue.text, -AGAIN_S) < AGAIN_S:
            return None
        self._said[cue.text] = told.t_s
        return cue

    def _cue(self, told: Told) -> Cue | None:
        match told.event:
            case RequestEvent() as event:
                return self._request(event)
            case DecisionEvent() as event:
                return self._decision(event)
            case MotionEvent() as event:
                return self._motion(event)
            case ModeEvent() as event:
                return self._mode(event)
            case PairEvent() as event:
                return self._pair(event)
            case ViolationEvent() as event:
                return self._violation(event, told.t_s)
            case AnnounceEvent() as event:
                return self._announce(event)
            case EndEvent():
                return None
            case _ as event:
                assert_never(event)

    def _request(self, event: RequestEvent) -> Cue | None:
        self._asked[event.id] = (event.command, event.modality)
        if len(self._asked) > REMEMBERED:
            del self._asked[next(iter(self._asked))]
        if event.command is not Command.STOP:
            return None  # its decision follows
        return self._named("holding", urgent=True) if self._drone else Cue("Nothing to hold", urgent=True)

    def _decision(self, event: DecisionEvent) -> Cue | None:
        command, modality = self._asked.get(event.request, (None, None))
        yes, no = ("move", "move refused") if command is None else _WORD.get(command, ("move", "move refused"))
        failing = event.failing
        if event.verdict in (Verdict.APPROVED, Verdict.REDUCED):
            beyond = ""
            if event.verdict is Verdict.REDUCED:
                beyond = "ahead" if command is None else _BEYOND.get(command, "ahead")
            flown = ["dry run"] * self._dry_run + [yes, *metres(event.granted_m)]
            return self._named(", ".join([*flown, *_why(failing, modality, beyond)]))
        constraints = {finding.constraint for finding in failing}
        if CONTRADICTION.name in constraints:
            known = [_CONTRADICTED[r] for f in failing for r in f.requirements if r in _CONTRADICTED]
            return self._named(known[0], urgent=True) if known else None
        if PAIRED.name in constraints:
            return Cue("No drone is paired", urgent=True)
        why = ", ".join(_why(failing, modality))
        if event.verdict is Verdict.DELAYED:
            return self._named(f"{yes} in a moment, {why}")
        if event.verdict is Verdict.REPLACED:
            return self._named(f"{no}, {why}, slower is offered")
        unsure = INPUT_CONFIDENCE.name in constraints
        return self._named(why if unsure else ", ".join(part for part in (no, why) if part), urgent=True)

    def _motion(self, event: MotionEvent) -> Cue | None:
        if event.status is not MotionStatus.COMPLETED:
            return None
        if event.request == RETURN:
            return self._named("at the anchor again")
        command, _ = self._asked.get(event.request, (None, None))
        if command is None or command is Command.CONTINUE or command not in _WORD:
            return self._named("done")
        return self._named(f"{_WORD[command][0]} done")

    def _mode(self, event: ModeEvent) -> Cue | None:
        if event.cause is Cause.STALLED:
            return self._named("holding, ask again", urgent=True)
        if event.cause is Cause.RETURN_APPROVED:
            return self._named("returning")
        if event.cause is Cause.AUTHORITY_LOST:
            self._lost = True
            return self._named("no longer yours", urgent=True)
        return None

    def _pair(self, event: PairEvent) -> Cue | None:
        name = _spoken_colour(event.vehicle)
        if event.status is PairStatus.REQUESTED:
            self._drone, self._paired = name, False
            return self._named("pairing")
        if event.status is PairStatus.CONFIRMED:
            self._drone, self._paired = name, True
            return self._named("paired")
        if event.status is PairStatus.REFUSED and self._paired and name == self._drone:
            return self._named("already paired, ask again", urgent=True)
        if self._paired and name != self._drone:
            return Cue(f"{name}: not paired", urgent=True)
        released = event.status is PairStatus.RELEASED
        cue = None if self._lost else Cue(f"{name}: {'released' if released else 'not paired'}", urgent=not released)
        self._drone, self._paired, self._lost = "", False, False
        return cue

    def _violation(self, event: ViolationEvent, t_s: float) -> Cue | None:
        since_s, self._violated_s = t_s - self._violated_s, t_s
        if since_s < TOGETHER_S:
            return None
        held = ["holding"] if event.action in (Action.ABORT, Action.HOLD) else []
        return self._named(", ".join([*held, _reason(event, None)]), urgent=True)

    def _announce(self, event: AnnounceEvent) -> Cue | None:
        if event.notice in _OF_THE_DRONE:
            said, urgent = _OF_THE_DRONE[event.notice]
            return self._named(said, urgent=urgent)
        return _OF_THE_SENSES.get(event.notice)

    def _named(self, text: str, *, urgent: bool = False) -> Cue:
        return Cue(f"{self._drone or 'Drone'}: {text}", urgent)


def metres(length_m: float | None) -> list[str]:
    """A length in words, to the centimetre below a metre, else to the decimetre; nothing where there is none."""
    if length_m is None:
        return []
    centimetres = round(100.0 * length_m)
    if centimetres < 100:
        return [f"{number(centimetres)} centimetre{'s'[: centimetres != 1]}"]
    whole, tenth = divmod(round(10.0 * length_m), 10)
    point = f" point {number(tenth)}" if tenth else ""
    return [f"{number(whole)}{point} metre{'s'[: (whole, tenth) != (1, 0)]}"]


_SMALL = (
    "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen seventeen "
    "eighteen nineteen"
).split()
_TENS = "twenty thirty forty fifty sixty seventy eighty ninety".split()


def number(n: int) -> str:
    """A number from 0 to 99 in words; others in digits."""
    if not 0 <= n < 100:
        return str(n)
    if n < len(_SMALL):
        return _SMALL[n]
    return _TENS[n // 10 - 2] + (f"-{_SMALL[n % 10]}" if n % 10 else "")


def _changes(event: OutputEvent) -> bool:
    """Whether something has changed, so that what was said may be said again."""
    if isinstance(event, ModeEvent):
        return event.mode is not event.previous
    return isinstance(event, RequestEvent | MotionEvent | PairEvent)


def _why(failing: tuple[FindingTold, ...], modality: Modality | None, beyond: str = "") -> list[str]:
    """The first reason: all of them are written. beyond: where, in the direction of the move, what shortened it lies."""
    return [_reason(finding, modality, beyond) for finding in failing[:1]]


def _reason(found: FindingTold | ViolationEvent, modality: Modality | None, beyond: str = "") -> str:
    constraint = DECLARED[found.constraint]
    words = constraint.spoken
    if found.margin is None:
        return words.unknown
    if constraint is INPUT_CONFIDENCE and modality is not None:
        return _UNSURE.get(modality, words.broken)
    said = f"{words.ahead} {beyond}" if beyond and words.ahead else words.broken
    name = _speakable(found.subject)
    for general in _GENERAL:
        aircraft = general == "others"
        said = said.replace(f"{{{general}}}", (name.capitalize() if aircraft else name) or general)
    return said


_GENERAL = ("something", "others")
"""What stands in braces in a reason, and is said where there is no name."""


def _speakable(name: str) -> str:
    """The name of whom or what a finding is about; empty where it has none that may be spoken."""
    words = normalise(name).split()
    words = words[1:] if words[:1] == ["the"] else words
    if not words or len(words) > LONGEST_NAME or not all(w.isalpha() and w not in COMMAND_WORDS for w in words):
        return ""
    return " ".join(words)


def _spoken_colour(colour: str) -> str:
    """A colour that is a word of the phrases would be half a request."""
    return "Drone" if colour.lower() in COMMAND_WORDS else colour.capitalize()
