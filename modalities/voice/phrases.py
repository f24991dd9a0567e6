"""What may be said: the phrase table, the grammar made of it, and the paper's three checks.

Source: paper section on voice-based maneuvers. Unlike the paper's substring search the *whole utterance* must equal a
phrase; only STOP counts wherever it stands, because a false stop is safe.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from safety.vocabulary import Command

STOP_WORD = "stop"

_DIRECTIONS: dict[str, Command] = {
    "left": Command.GO_LEFT,
    "right": Command.GO_RIGHT,
    "forward": Command.GO_FORWARD,
    "forwards": Command.GO_FORWARD,
    "back": Command.GO_BACK,
    "backward": Command.GO_BACK,
    "backwards": Command.GO_BACK,
    "up": Command.GO_UP,
    "down": Command.GO_DOWN,
}
_TURNS: dict[str, Command] = {"left": Command.TURN_LEFT, "right": Command.TURN_RIGHT}
_PAIRING: dict[str, Command] = {"activate": Command.ACTIVATE, "disconnect": Command.DISCONNECT}

# Everyday words that compete with the commands for what was said, so that speech which is no request is not bent into
# one. Common English words, plus the answers and numbers people give each other. Words that sound almost like one of a
# command (last, late, low, time) are left out: they would take its place.
OTHER_WORDS: tuple[str, ...] = tuple(
    """
    the a of to and in is you that it he was for on are with as his they be at one have this from or had by hot but
    some what there we out other were all your when use word how said an each she which do their if will way about
    many then them would write like so these her long make thing see him two has look more day could come did my sound
    no most number who over know water than call first people may side been now find any new work part take get place
    made where after little only round man year came show every good me give our under name very through just form
    much great think say help line before cause same mean differ move boy old too does tell sentence three want air
    well also play small end put home read hand port large spell even land here must big high such follow act why ask
    men change went light kind off need house picture try us again animal point mother world near build self father
    head stand own page should country found answer school grow study learn plant cover food sun four thought keep eye
    never door between city tree cross since hard start might story saw far sea draw while press close night real life
    few open seem together next children begin walk example ease paper often always music those both mark book letter
    until mile river car feet care second group carry took rain eat room friend began idea fish mountain north once
    base hear horse cut sure watch face wood yes okay hello please thanks happy bird cat dog bed wow zero five six
    seven eight nine ten coffee order medium milk sugar cup slow blow around going deactivate connect drone battery
    sorry nothing maybe later
    """.split()
)

# Words that begin like *stop* but go on otherwise: without them, what begins with s is bent into it. Words with "st" would
# keep the decoder from telling until they are over, and STOP must not wait.
STOP_RIVALS: tuple[str, ...] = ("seven", "six", "so", "see", "say", "sorry", "sun")


@dataclass(frozen=True, slots=True)
class Phrase:
    """What an utterance asks for. colour: the drone named, for ACTIVATE and DISCONNECT only."""

    command: Command
    colour: str | None = None


class PhraseTable:
    """Every legal phrase, for the drones of these colours."""

    def __init__(self, colours: Iterable[str]) -> None:
        """Raises ValueError for a colour that is not one plain word, as nobody could say it."""
        self.colours = tuple(dict.fromkeys(colour.lower() for colour in colours))
        for colour in self.colours:
            if not re.fullmatch(r"[a-z]+", colour):
                raise ValueError(f"{colour!r} is not a colour that can be said: use one plain word such as red")
        self._activation = {
            f"{word} {colour}": Phrase(command, colour) for word, command in _PAIRING.items() for colour in self.colours
        }
        self._continue = {"continue": Phrase(Command.CONTINUE)}
        self._directional = {
            f"{verb} {way}": Phrase(command) for verb in ("go", "fly") for way, command in _DIRECTIONS.items()
        } | {f"turn {way}": Phrase(command) for way, command in _TURNS.items()}

    @property
    def phrases(self) -> tuple[str, ...]:
        """Every legal phrase: the recogniser's grammar."""
        return (*self._activation, STOP_WORD, *self._continue, *self._directional)

    @property
    def words(self) -> tuple[str, ...]:
        """Every word of them, once."""
        return tuple(dict.fromkeys(word for phrase in self.phrases for word in phrase.split()))

    def interpret(self, utterance: str) -> Phrase | None:
        """The paper's three checks in priority order: activation, STOP and CONTINUE, directions. None: no request."""
        text = normalise(utterance)
        if text in self._activation:
            return self._activation[text]
        if contains_stop(text):
            return Phrase(Command.STOP)
        return self._continue.get(text) or self._directional.get(text)

    def begins_phrase(self, utterance: str) -> bool:
        """Whether it is a legal phrase that still lacks its end ("go"), so that the speaker is not finished."""
        text = normalise(utterance)
        return bool(text) and any(phrase.startswith(text + " ") for phrase in self.phrases)


def normalise(utterance: str) -> str:
    """Lower case, single spaces, no punctuation; "[unk]" stays, as it stands for a word that was said."""
    return " ".join(re.sub(r"[^a-z\[\]' ]+", " ", utterance.lower()).split())


def contains_stop(utterance: str) -> bool:
    """Whether the word *stop* stands anywhere in it. Source: design 3."""
    return STOP_WORD in normalise(utterance).split()
