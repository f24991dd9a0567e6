"""Writes docs/mode-machine.md: the mode machine's table beside a controller synthesised from the requirements.

From the project's root: .venv/bin/python -m scripts.mode_machine. `tests/formal/test_synthesis.py` compares the page with what this makes.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from m3r_app.arbiter.modes import TRANSITIONS, WHILE_HELD, next_state
from safety.vocabulary import Cause, State
from tests.formal.exploration import ALPHABET, INVARIANTS
from tests.formal.justified import STRICTER, UNTAKEN, WITHOUT_ENTRY, justification
from tests.formal.specification import ASSUMPTIONS, FAIR, GUARANTEES, REST, Solved, solved

PAGE = Path(__file__).resolve().parents[1] / "docs" / "mode-machine.md"

Key = tuple[State, Cause, bool]


def forbidden(game: Solved) -> list[Key]:
    """Entries that the table takes and the game does not allow."""
    return [k for k, to in game.allowed.items() if _taken(k) is not None and _taken(k) not in to]


def without_entry(game: Solved) -> list[Key]:
    """What can happen in the game although the table has nothing for it."""
    return _sorted(k for k in game.allowed if _taken(k) is None)


def stricter(game: Solved) -> list[Key]:
    """Where the game allows more than the table takes."""
    return _sorted(k for k, to in game.allowed.items() if _taken(k) is not None and len(to) > 1)


def never_met(game: Solved) -> list[Key]:
    """Entries that no play of the game comes to."""
    entries = [*((s, c, False) for s, c in TRANSITIONS), *((s, c, True) for s, c in WHILE_HELD)]
    return [k for k in entries if k not in game.allowed]


def _taken(key: Key) -> State | None:
    return next_state(key[0], key[1], held=key[2])


def _sorted(keys: Iterable[Key]) -> list[Key]:
    states, causes = list(State), list(Cause)
    return sorted(keys, key=lambda k: (states.index(k[0]), causes.index(k[1]), k[2]))


def _names(states: Iterable[State]) -> str:
    return ", ".join(sorted(f"`{s}`" for s in states))


def page() -> str:
    game = solved()
    lines = [
        "# The mode machine, synthesised and compared",
        "",
        "Made by `.venv/bin/python -m scripts.mode_machine`; a test compares it. The machine that flies is one table",
        "(`m3r_app/arbiter/modes.py`). Here the same machine is specified from the requirements alone, as a game between what happens",
        "and what is answered (GR(1), `tests/formal/specification.py`), solved with `omega`, and the table is held against all that a",
        "winning machine may do.",
        "",
        f"* realizable: {'yes' if game.realizable else 'NO'}; {len(ASSUMPTIONS)} assumptions and {len(FAIR)} kinds of answer that come in the end;",
        f"  {len(GUARANTEES)} guarantees, and one that holds for ever: again and again the machine is in {_names(REST)};",
        f"* {game.reached} situations (state, cause, history) are met in play, {len(game.allowed)} kinds of question (state, cause, held) among them;",
        (
            f"* the table answers {len(game.allowed) - len(without_entry(game))} of these from its {len(TRANSITIONS)} + {len(WHILE_HELD)} entries;"
            f" answers that the game forbids: {len(forbidden(game))}; entries that no play comes to: {len(never_met(game))};"
        ),
        f"* the game allows more than the table takes in {len(stricter(game))} places, and asks {len(without_entry(game))} times where the table has no entry.",
        "",
        "## Where the table is stricter",
        "",
        "| in | when | the table | allowed as well | why |",
        "|---|---|---|---|---|",
    ]
    for key in stricter(game):
        state, cause, held = key
        taken = _taken(key)
        more = _names(game.allowed[key] - {taken})
        lines.append(f"| `{state}`{' (held)' if held else ''} | {cause} | `{taken}` | {more} | {STRICTER[cause]} |")
    lines += [
        "",
        "## What happens without an entry",
        "",
        "| in | when | what becomes of it | allowed | why |",
        "|---|---|---|---|---|",
    ]
    for state, cause, held in without_entry(game):
        to, why = WITHOUT_ENTRY[state, cause]
        lines.append(f"| `{state}` | {cause} | `{to}` | {_names(game.allowed[state, cause, held])} | {why} |")
    never = sum(map(len, UNTAKEN.values()))
    whole = len(TRANSITIONS) + len(WHILE_HELD)
    lines += [
        "",
        "## Explored",
        "",
        f"`tests/formal/test_exploration.py` puts the arbiter itself before each of {len(ALPHABET)} events in every abstract state that it finds,",
        f"and judges every step. {whole - never} of the {whole} entries are taken; a test holds that the other {never} are these:",
        "",
        *(f"* {why}: {len(entries)}" for why, entries in UNTAKEN.items()),
        "",
        "| requirements | what holds of every step |",
        "|---|---|",
        *(f"| {', '.join(ids)} | {what} |" for what, (ids, _) in INVARIANTS.items()),
    ]
    lines += ["", "## What is assumed", "", "| source | assumption |", "|---|---|"]
    lines += [f"| {r.source} | {r.says} |" for r in ASSUMPTIONS]
    lines += [
        f"| deadlines | whoever stays in {state} is told {' or '.join(causes)} in the end |"
        for state, causes in FAIR.items()
    ]
    lines += ["", "## What is guaranteed", "", "| source | guarantee |", "|---|---|"]
    lines += [f"| {r.source} | {r.says} |" for r in GUARANTEES]
    lines += [
        "",
        "## Every entry, and what it is there for",
        "",
        "| from | cause | to | requirements |",
        "|---|---|---|---|",
    ]
    for table, held in ((TRANSITIONS, False), (WHILE_HELD, True)):
        for (state, cause), to in table.items():
            ids = ", ".join(justification(state, cause, held=held))
            lines.append(f"| `{state}`{' (held)' if held else ''} | {cause} | `{to}` | {ids} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
