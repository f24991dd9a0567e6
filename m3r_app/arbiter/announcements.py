"""What the operator is told by the arbiter: what it is about, its numbers, and, last of all, the sentence. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from m3r_app.arbiter.wording import WORD_OF, decided
from m3r_app.output import Notice
from safety.vocabulary import Decision, Primitive


@dataclass(frozen=True, slots=True)
class Announce:
    """Something to tell. vehicle: the drone's colour, empty: no drone. because: the reasons, sentences already.

    metres, seconds: what each notice says of it in `sentence`. asked: what was asked for, in words, of a decision.
    """

    notice: Notice
    vehicle: str = ""
    because: tuple[str, ...] = ()
    metres: tuple[float, ...] = ()
    seconds: float = 0.0
    primitive: Primitive | None = None
    decision: Decision | None = None
    asked: str = ""
    dry_run: bool = False

    @property
    def text(self) -> str:
        """The sentence."""
        return sentence(self)


def sentence(said: Announce) -> str:
    """One short sentence, named by the drone's colour, with the numbers."""
    if said.decision is not None:
        text = decided(said.vehicle, said.asked, said.decision)
        return f"dry run, {text}" if said.dry_run else text
    return f"{said.vehicle.capitalize() or 'No drone'}: {_words(said)}"


def _words(said: Announce) -> str:
    why = "; ".join(dict.fromkeys(said.because))
    match said.notice:
        case Notice.DONE:
            moved = "".join(f", {m:.2f} m" for m in said.metres)
            return f"{WORD_OF[said.primitive] if said.primitive is not None else ''} done{moved}"
        case Notice.HOLDING:
            return "holding"
        case Notice.NOTHING_TO_HOLD:
            return "nothing to hold, this app has no authority over a drone"
        case Notice.DROPPED:
            return f"holding, {why}; ask again"
        case Notice.ABORTED:
            return f"holding, {why}"
        case Notice.HELD_ANEW:
            return f"{why}: it holds at where it now believes to be"
        case Notice.RETURNING_SOON:
            return f"returning to the anchor in {said.seconds:.0f} seconds"
        case Notice.NOT_RETURNING_YET:
            return f"not returning yet, {why}"
        case Notice.ASKS_TO_RETURN:
            return "say continue to return to the anchor"
        case Notice.PAIRED if said.metres:
            wanders_m, more_m = said.metres
            return f"paired, facing you; its position wanders by {wanders_m:.1f} m, so it keeps {more_m:.1f} m more from everything"
        case Notice.PAIRED:
            return "paired, facing you"
        case Notice.ALREADY_PAIRED:
            return "already paired"
        case Notice.ALREADY_PAIRING:
            return "already pairing"
        case Notice.NOT_PAIRED:
            return f"not paired, {why}"
        case Notice.NOT_PAIRING:
            return f"not pairing, {why}"
        case Notice.NOTHING_TO_DISCONNECT:
            return f"{said.asked or 'no drone'} is not paired, so there is nothing to disconnect"
        case Notice.NOT_DISCONNECTED:
            return f"not disconnected, {why}"
        case _:
            return why
