"""What is spoken of a run: short cues, named by the drone's colour, in the operator's directions. Pure.

The words are chosen by what real recognition makes of them: "other aircraft" became *go left* and "waits, Blue" *activate blue*.
A cue must never be a request: the word *stop* is not in it (it says *holding*), and no phrase of `modalities.voice.phrases` is, as a
whole or in part, so a name that holds a word of them is not spoken either. Source: R1, X4.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from modalities.voice.phrases import PhraseTable, normalise

Event = Mapping[str, Any]
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


_WORD: dict[str, tuple[str, str]] = {
    "go_left": ("left", "left refused"),
    "go_right": ("right", "right refused"),
    "go_forward": ("forward", "forward refused"),
    "go_back": ("back", "back refused"),
    "go_up": ("up", "up refused"),
    "go_down": ("down", "down refused"),
    "turn_left": ("left turn", "left turn refused"),
    "turn_right": ("right turn", "right turn refused"),
    "continue": ("going on", "going on refused"),
}
"""What is flown and what is not, for each command; "turn left" would be a request."""

_LIES = {"terrain_clearance": "ground", "obstacle_clearance": "{something}", "geofence": "border"}
"""What shortened a move lies in its direction; the name of an obstacle or of a drone takes the place of what is in braces."""
_BEYOND = {"go_up": "above", "go_down": "below"}
_REASON: dict[str, tuple[str, str]] = {
    "terrain_clearance": ("ground too near", "ground unknown"),
    "agl": ("too low", "ground unknown"),
    "obstacle_clearance": ("{something} too near", "surroundings unknown"),
    "separation": ("{others} too near", "others unknown"),
    "reservation": ("held by others", "not free"),
    "workspace": ("edge of the workspace", "position unknown"),
    "session": ("too far away", "position unknown"),
    "geofence": ("border too near", "position unknown"),
    "envelope": ("over its limits", "limits unknown"),
    "standoff": ("too near you", "your position unknown"),
    "input_confidence": ("not sure what you asked", "ask again"),
    "localization": ("position uncertain", "position unknown"),
    "terrain_confidence": ("ground uncertain", "ground unknown"),
    "neighbour_age": ("{others} silent", "others silent"),
    "authority": ("not yours", "not yours"),
    "paired": ("not paired", "not paired"),
}
"""Two or three words for each constraint: where it is broken by a number, and where nothing is known."""
_UNSURE = {"voice": "not sure what you said", "gesture": "not sure what you showed"}
_CONTRADICTED = {"X5": "holding, two different requests", "X12": "nothing to go on with"}
"""By requirement; what STOP or a newer request withdrew has been answered by their own cue."""
_NAMED = re.compile(r"too close to (?:the )?(.+?)(?: already, and this does not make it worse)?$|^(.+?): last heard ")

_ANNOUNCED: tuple[tuple[str, str, bool, bool], ...] = (
    ("taking off to", "taking off", True, False),
    ("returning to the anchor in", "returning soon", True, True),
    ("not returning yet", "not returning yet", True, False),
    ("say continue to return", "asks to return", True, False),
    ("not disconnected, ", "still paired, ask again", True, False),
    (": lost, silent for", "lost", True, True),
    ("you are not heard until it is back", "You are not heard", False, True),
    ("is back: you are heard again", "You are heard again", False, False),
    ("voice is off", "Voice is lost", False, True),
    ("hands are off", "Hands are lost", False, True),
    (": hands are not seen", "Hands are not seen", False, True),
    ("gives pictures again", "Hands are seen again", False, False),
)
"""Announcements that no other event tells: a part of the sentence, the cue, whether it is the drone's, whether it is urgent."""


class Cues:
    """From the events of one run, in their order, to what is spoken of them."""

    def __init__(self, *, dry_run: bool = False) -> None:
        """dry_run: what is approved is not flown."""
        self._dry_run = dry_run
        self._drone = ""
        self._paired = False
        self._lost = False
        self._violated_s = -TOGETHER_S
        self._asked: dict[str, tuple[str, str]] = {}
        self._said: dict[str, float] = {}

    def of(self, event: Event) -> Cue | None:
        """What is spoken of this event; None: nothing, or nothing new."""
        if _changes(event):
            self._said.clear()
        cue = self._cue(event)
        if cue is None or event["t"] - self._said.get(cue.text, -AGAIN_S) < AGAIN_S:
            return None
        self._said[cue.text] = event["t"]
        return cue

    def _cue(self, event: Event) -> Cue | None:
        match event["event"]:
            case "request":
                return self._request(event)
            case "decision":
                return self._decision(event)
            case "motion" if event["status"] == "completed":
                return self._named(_done(event["request"], self._asked.get(event["request"], ("", ""))[0]))
            case "mode":
                return self._mode(event)
            case "pair":
                return self._pair(event)
            case "violation":
                return self._violation(event)
            case "announce":
                return self._announce(event["text"])
        return None

    def _request(self, event: Event) -> Cue | None:
        self._asked[event["id"]] = (event["command"], event["modality"])
        if len(self._asked) > REMEMBERED:
            del self._asked[next(iter(self._asked))]
        if event["command"] != "stop":
            return None  # its decision follows
        return self._named("holding", urgent=True) if self._drone else Cue("Nothing to hold", urgent=True)

    def _decision(self, event: Event) -> Cue | None:
        command, modality = self._asked.get(event["request"], ("", ""))
        yes, no = _WORD.get(command, ("move", "move refused"))
        failing = [finding for finding in event["findings"] if not finding["passed"]]
        if event["verdict"] in ("approved", "reduced"):
            beyond = _BEYOND.get(command, "ahead") if event["verdict"] == "reduced" else ""
            flown = ["dry run"] * self._dry_run + [yes, *metres(event["granted_m"])]
            return self._named(", ".join([*flown, *_why(failing, modality, beyond)]))
        constraints = {finding["constraint"] for finding in failing}
        if "contradiction" in constraints:
            known = [_CONTRADICTED[r] for f in failing for r in f["requirements"] if r in _CONTRADICTED]
            return self._named(known[0], urgent=True) if known else None
        if "paired" in constraints:
            return Cue("No drone is paired", urgent=True)
        why = ", ".join(_why(failing, modality))
        if event["verdict"] == "delayed":
            return self._named(f"{yes} in a moment, {why}")
        if event["verdict"] == "replaced":
            return self._named(f"{no}, {why}, slower is offered")
        unsure = "input_confidence" in constraints
        return self._named(why if unsure else ", ".join(part for part in (no, why) if part), urgent=True)

    def _mode(self, event: Event) -> Cue | None:
        match event["cause"]:
            case "stalled":
                return self._named("holding, ask again", urgent=True)
            case "return_approved":
                return self._named("returning")
            case "authority_lost":
                self._lost = True
                return self._named("no longer yours", urgent=True)
        return None

    def _pair(self, event: Event) -> Cue | None:
        name = _spoken_colour(event["vehicle"])
        match event["status"]:
            case "requested":
                self._drone, self._paired = name, False
                return self._named("pairing")
            case "confirmed":
                self._drone, self._paired = name, True
                return self._named("paired")
            case "refused" if self._paired and name == self._drone:
                return self._named("already paired, ask again", urgent=True)
        if self._paired and name != self._drone:
            return Cue(f"{name}: not paired", urgent=True)
        over = "released" if event["status"] == "released" else "not paired"
        cue = None if self._lost else Cue(f"{name}: {over}", urgent=over != "released")
        self._drone, self._paired, self._lost = "", False, False
        return cue

    def _violation(self, event: Event) -> Cue | None:
        since_s, self._violated_s = event["t"] - self._violated_s, event["t"]
        if since_s < TOGETHER_S:
            return None
        held = ["holding"] if event["action"] in ("abort", "hold") else []
        return self._named(", ".join([*held, *_why([event], "")]), urgent=True)

    def _announce(self, text: str) -> Cue | None:
        for part, said, of_drone, urgent in _ANNOUNCED:
            if part in text:
                return self._named(said, urgent=urgent) if of_drone else Cue(said, urgent)
        return None

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


def _changes(event: Event) -> bool:
    """Whether something has changed, so that what was said may be said again."""
    if event["event"] == "mode":
        return bool(event["mode"] != event["previous"])
    return event["event"] in ("request", "motion", "pair")


def _done(request_id: str, command: str) -> str:
    if request_id == "return":
        return "at the anchor again"
    return f"{_WORD[command][0]} done" if command in _WORD and command != "continue" else "done"


def _why(failing: Sequence[Event], modality: str, beyond: str = "") -> list[str]:
    """The first reason: all of them are written. beyond: where, in the direction of the move, what shortened it lies."""
    return [_reason(finding, modality, beyond) for finding in failing[:1]]


def _reason(finding: Event, modality: str, beyond: str) -> str:
    constraint = finding["constraint"]
    broken, unknown = _REASON.get(constraint, ("not safe", "not safe"))
    if finding["margin"] is None:
        return unknown
    if constraint == "input_confidence":
        return _UNSURE.get(modality, broken)
    if beyond and constraint in _LIES:
        broken = f"{_LIES[constraint]} {beyond}"
    name = _name_in(finding["text"])
    if constraint in ("separation", "neighbour_age"):
        name = name.capitalize()
    return re.sub(r"\{(.+)\}", name or r"\1", broken)


def _name_in(text: str) -> str:
    """The name of whom or what a finding is about; empty where it has none that may be spoken."""
    found = _NAMED.search(text)
    words = normalise(found[1] or found[2]).split() if found else []
    if not words or len(words) > LONGEST_NAME or not all(w.isalpha() and w not in COMMAND_WORDS for w in words):
        return ""
    return "" if words[0] in ("an", "other") else " ".join(words)  # "an obstacle", "other aircraft": no names


def _spoken_colour(colour: str) -> str:
    """A colour that is a word of the phrases would be half a request."""
    return "Drone" if colour.lower() in COMMAND_WORDS else colour.capitalize()
