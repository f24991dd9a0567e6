"""Our values as plain JSON values, and back. Used by the flight record (lossless) and the headless output (null for no number)."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from enum import Enum
from typing import Any

import numpy as np

ARRAY_LENGTH = 20_000
"""Larger arrays (a terrain model) are told by shape and digest instead of by their elements."""

_NAMES = {math.inf: "Infinity", -math.inf: "-Infinity"}
_NUMBERS = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}


def plain(value: object, *, lossless: bool) -> Any:
    """`value` as strict JSON can hold it: dataclasses and mappings as objects, named tuples and arrays as lists.

    A float that is no finite number becomes "NaN", "Infinity" or "-Infinity" if lossless (`restored` undoes it), else null.
    What is nothing of the kind is told by its `str`.
    """
    match value:
        case Enum():
            return plain(value.value, lossless=lossless)
        case None | bool() | int() | str():
            return value
        case float():
            return _number(value, lossless=lossless)
        case np.generic():
            return plain(value.item(), lossless=lossless)
        case np.ndarray():
            return _array(value, lossless=lossless)
        case dict():
            return {str(plain(key, lossless=lossless)): plain(item, lossless=lossless) for key, item in value.items()}
        case list() | tuple():
            return [plain(item, lossless=lossless) for item in value]
        case set() | frozenset():
            return sorted((plain(item, lossless=lossless) for item in value), key=str)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name), lossless=lossless) for field in dataclasses.fields(value)}
    return str(value)


def restored(value: Any) -> Any:
    """What `plain(..., lossless=True)` made of floats, undone in a parsed JSON value."""
    match value:
        case str():
            return _NUMBERS.get(value, value)
        case list():
            return [restored(item) for item in value]
        case dict():
            return {key: restored(item) for key, item in value.items()}
    return value


def _number(value: float, *, lossless: bool) -> float | str | None:
    number = float(value)
    if math.isfinite(number):
        return number
    return _NAMES.get(number, "NaN") if lossless else None


def _array(array: np.ndarray[Any, Any], *, lossless: bool) -> Any:
    if array.size > ARRAY_LENGTH:
        digest = hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()
        return {"shape": list(array.shape), "dtype": str(array.dtype), "sha256": digest}
    if np.issubdtype(array.dtype, np.floating) and bool(np.isfinite(array).all()):
        return array.tolist()
    return plain(array.tolist(), lossless=lossless)
