"""The machine-readable output: every event as one line of strict JSON."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from m3r_app.plain import plain

if TYPE_CHECKING:
    from collections.abc import Mapping

DECIMALS = 7
"""A centimetre of latitude, a tenth of a microsecond."""


def line(event: Mapping[str, Any]) -> str:
    """One event, `t` and `event` first. Numbers that do not exist are null; only ASCII, whatever was said."""
    first = {name: event[name] for name in ("t", "event")}
    return json.dumps(_rounded(plain({**first, **event}, lossless=False)), allow_nan=False)


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, DECIMALS) + 0.0  # no -0.0
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return value
