"""Values as text for the golden cases."""

from __future__ import annotations

import hashlib
import sys
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

from safety.situation import World


def shown(value: Any) -> str:
    """Every value as text, by name; what is as by default is left out, numbers to six places."""
    match value:
        case float():
            return f"{0.0 if abs(value) < 1e-9 else value:.6g}"
        case Enum():
            return str(value.value)
        case World():
            return "World"
        case np.ndarray():
            return shown(value.tolist())
        case _ if is_dataclass(value):
            told = ((f.name, getattr(value, f.name), f.default) for f in fields(value) if not f.name.startswith("_"))
            parts = [
                f"{name}={shown(each)}" for name, each, default in told if name != "rules" and not _same(each, default)
            ]
            return f"{type(value).__name__}({', '.join(parts)})"
        case tuple() | list():
            return f"[{', '.join(shown(each) for each in value)}]"
        case dict():
            return f"{{{', '.join(sorted(f'{shown(k)}: {shown(v)}' for k, v in value.items()))}}}"
        case set() | frozenset():
            return f"{{{', '.join(sorted(map(shown, value)))}}}"
    return repr(value)


def _same(a: Any, b: Any) -> bool:
    return type(a) is type(b) and not isinstance(a, np.ndarray) and bool(a == b)


def line(name: str, short: str, *values: Any) -> str:
    text = "\n".join(shown(value) for value in values)
    if name in sys.argv[1:]:
        print(name, short, text, sep="\n")
    return f"{name}: {short} {hashlib.sha256(text.encode()).hexdigest()[:8]}"
