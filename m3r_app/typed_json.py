"""Our frozen values as JSON and back, bit for bit and type by type. Used where a flight must be stepped through again.

Every value has one text. A composite is a list that begins with its type: a class by name with its fields in their order, "()"
a tuple, "[]" a list, "{}" a dictionary, "<>" a set, "#" an array (its bytes, little-endian, in base64), "~" a float that is no
finite number, "fn" a function (which has no way back).
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import math
from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from types import FunctionType
from typing import Any

import numpy as np

Encode = Callable[[Any], str]


class TypedJsonError(ValueError):
    """A value that cannot be written or read; one sentence that names its type."""


class TypedJson:
    """Writes and reads values of the given classes (frozen dataclasses, named tuples, enums) and what they are made of.

    apart: classes whose values are large and stay: in a text only the sha256 of theirs stands, and `documents` has it.
    """

    def __init__(self, classes: Iterable[type], apart: tuple[type, ...] = ()) -> None:
        self._classes: dict[str, type] = {}
        for one in classes:
            if self._classes.setdefault(one.__name__, one) is not one:
                raise TypedJsonError(f"two classes are called {one.__name__}, so a record could not tell them apart")
        self._apart = apart
        self._known_apart: dict[int, tuple[object, str]] = {}
        self.documents: dict[str, str] = {}
        """The texts of what is kept apart, by sha256."""
        self._encoders: dict[type, Encode] = {
            type(None): lambda _: "null",
            bool: lambda value: "true" if value else "false",
            int: repr,
            float: _float,
            str: json.dumps,
            tuple: lambda value: self._sequence("()", value),
            list: lambda value: self._sequence("[]", value),
            dict: self._mapping,
            set: self._set,
            frozenset: self._set,
            np.ndarray: _array,
            FunctionType: lambda value: f'["fn","{value.__module__}.{value.__qualname__}"]',
        }

    def shapes(self) -> dict[str, list[str]]:
        """The field names of every class that has fields, for a reader to compare with its own."""
        return {name: list(_fields(one)) for name, one in self._classes.items() if not issubclass(one, Enum)}

    def text(self, value: object) -> str:
        """The one text of a value. Raises TypedJsonError for a type that is not known."""
        encode = self._encoders.get(type(value))
        if encode is None:
            encode = self._encoders[type(value)] = self._learnt(type(value))
        return encode(value)

    def value(self, parsed: Any) -> Any:
        """The value of a parsed text. Raises TypedJsonError for a class or a document that is not known."""
        if not isinstance(parsed, list):
            return parsed
        kind, *rest = parsed
        match kind:
            case "~":
                return float(rest[0])
            case "()":
                return tuple(self.value(one) for one in rest)
            case "[]":
                return [self.value(one) for one in rest]
            case "{}":
                return {self.value(key): self.value(one) for key, one in rest}
            case "<>":
                return frozenset(self.value(one) for one in rest)
            case "#":
                dtype, shape, data = rest
                return np.frombuffer(base64.b64decode(data), dtype=dtype).reshape(shape).copy()
            case "apart":
                return self._from_apart(rest[0])
        return self._of_class(kind, rest)

    # ------------------------------------------------------------ classes

    def _of_class(self, name: str, rest: list[Any]) -> Any:
        one = self._classes.get(name)
        if one is None:
            raise TypedJsonError(f"it holds a {name}, which this m3r does not know")
        if issubclass(one, Enum):
            return one[rest[0]]
        names = _fields(one)
        if len(names) != len(rest):
            raise TypedJsonError(f"its {name} has {len(rest)} fields, this m3r's has {len(names)}")
        return one(**dict(zip(names, (self.value(field) for field in rest), strict=True)))

    def _from_apart(self, digest: str) -> Any:
        text = self.documents.get(digest)
        if text is None or hashlib.sha256(text.encode()).hexdigest() != digest:
            raise TypedJsonError(f"the document {digest[:12]}… that it needs is missing or was changed")
        for known, of in self._known_apart.values():
            if of == digest:
                return known
        value = self.value(json.loads(text))
        self._known_apart[id(value)] = value, digest
        return value

    def _learnt(self, kind: type) -> Encode:
        if issubclass(kind, self._apart):
            write = self._class(kind)
            return lambda value: self._put_apart(value, write)
        if issubclass(kind, np.generic):
            return lambda value: self.text(value.item())
        if issubclass(kind, Enum):
            self._must_know(kind)
            return lambda value: f'["{kind.__name__}","{value.name}"]'
        return self._class(kind)

    def _class(self, kind: type) -> Encode:
        self._must_know(kind)
        names = _fields(kind)
        head = f'["{kind.__name__}"'

        def write(value: object) -> str:
            return "".join((head, *(f",{self.text(getattr(value, name))}" for name in names), "]"))

        return write

    def _must_know(self, kind: type) -> None:
        if self._classes.get(kind.__name__) is not kind:
            raise TypedJsonError(f"{kind.__module__}.{kind.__name__} is not among what a record may hold")

    def _put_apart(self, value: object, write: Encode) -> str:
        known = self._known_apart.get(id(value))
        if known is None:
            text = write(value)
            digest = hashlib.sha256(text.encode()).hexdigest()
            self.documents[digest] = text
            known = self._known_apart[id(value)] = value, digest  # held, so that its id stays its own
        return f'["apart","{known[1]}"]'

    # ------------------------------------------------------------ collections

    def _sequence(self, tag: str, values: Iterable[object]) -> str:
        return "".join((f'["{tag}"', *(f",{self.text(one)}" for one in values), "]"))

    def _mapping(self, values: Mapping[object, object]) -> str:
        pairs = (f",[{self.text(key)},{self.text(one)}]" for key, one in values.items())
        return "".join(('["{}"', *pairs, "]"))

    def _set(self, values: Iterable[object]) -> str:
        return "".join(('["<>"', *sorted(f",{self.text(one)}" for one in values), "]"))


def _fields(one: type) -> tuple[str, ...]:
    """What its constructor takes."""
    if dataclasses.is_dataclass(one):
        return tuple(field.name for field in dataclasses.fields(one) if field.init)
    names: tuple[str, ...] | None = getattr(one, "_fields", None)
    if names is None:
        raise TypedJsonError(f"{one.__module__}.{one.__name__} is neither a dataclass nor a named tuple")
    return names


def _float(value: float) -> str:
    return repr(value) if math.isfinite(value) else f'["~","{value!r}"]'


def _array(array: np.ndarray[Any, Any]) -> str:
    little = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
    data = base64.b64encode(little.tobytes()).decode()
    return f'["#","{little.dtype.str}",{json.dumps(list(array.shape), separators=(",", ":"))},"{data}"]'
