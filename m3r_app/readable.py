"""Text that somebody else sent, made fit to be shown: nothing in it moves a cursor, hides or reorders what stands beside it."""

from __future__ import annotations

import unicodedata

LONGEST = 200
"""Characters; a MAVLink status text has 50, several of them chained a few hundred."""
HIDDEN = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
"""Unicode categories that a terminal acts on or that cannot be seen: controls (escape sequences), directions, private use."""


def readable(text: str, longest: int = LONGEST) -> str:
    """One line of what can be read, at most `longest` characters: the rest of a terminal's escape sequence is harmless text."""
    seen = "".join(" " if c.isspace() else "" if unicodedata.category(c) in HIDDEN else c for c in text[: 4 * longest])
    line = " ".join(seen.split())
    return line if len(line) <= longest else f"{line[: longest - 1]}…"
