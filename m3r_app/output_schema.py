"""The output contract made from its types: events read back, their JSON Schema, and the page that describes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from enum import Enum, EnumType
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from pydantic import TypeAdapter, ValidationError

from m3r_app.output import EVENT_TYPES, FindingTold, OutputEvent

_ADAPTERS: dict[str, TypeAdapter[OutputEvent]] = {kind.name: TypeAdapter(kind) for kind in EVENT_TYPES}


class EventError(ValueError):
    """What is no event of the output; one sentence."""


def event_of(name: str, values: Mapping[str, Any]) -> OutputEvent:
    """The event of that name with these fields, as a record or a line of the output holds them. Raises EventError."""
    try:
        return _ADAPTERS[name].validate_python(
            {key: value for key, value in values.items() if key not in ("t", "event")}
        )
    except KeyError:
        raise EventError(f"{name} is no event of the output") from None
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        raise EventError(f"{name}: {'.'.join(str(part) for part in first['loc'])}: {first['msg']}") from None


def schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of one line of the output."""
    definitions: dict[str, Any] = {}
    for kind in EVENT_TYPES:
        found = _ADAPTERS[kind.name].json_schema(mode="serialization", ref_template="#/$defs/{model}")
        definitions |= found.pop("$defs", {})
        definitions[kind.__name__] = {
            "type": "object",
            "title": kind.name,
            "description": _summary(kind),
            "properties": {
                "t": {"type": "number", "minimum": 0, "description": "seconds since the run began"},
                "event": {"const": kind.name},
                **_described(kind, found["properties"]),
            },
            "required": ["t", "event", *found["properties"]],
            "additionalProperties": False,
        }
    told = definitions[FindingTold.__name__]
    told["properties"] = _described(FindingTold, told["properties"])
    told["required"] = list(told["properties"])
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "One line of the machine-readable output of m3r run --headless",
        "oneOf": [{"$ref": f"#/$defs/{kind.__name__}"} for kind in EVENT_TYPES],
        "$defs": definitions,
    }


def documentation() -> str:
    """docs/output.md: every event, every field with its type and meaning."""
    parts = [_HEAD]
    for kind in EVENT_TYPES:
        parts += [f"## `{kind.name}`\n", f"{kind.__doc__}\n", _table(kind)]
    parts += ["## A finding\n", f"{FindingTold.__doc__}\n", _table(FindingTold), "## Words\n"]
    for word in sorted(_enums(), key=lambda e: e.__name__):
        members: list[Enum] = list(word)
        values = ", ".join(f"`{member.value}`" for member in members)
        parts.append(f"* **{word.__name__}**: {values}. {_summary(word)}\n")
    return "\n".join(parts)


_HEAD = """# The machine-readable output

`m3r run --headless` prints one JSON object a line on standard output, in the order in which things happen. Every object has `t`,
seconds since the run began, and `event`, the name of one of the events below; the last one is always `end`. Lengths are in
metres, angles in degrees, speeds in metres a second. Numbers that do not exist are `null`; what is said is ASCII. The flight
record holds the same events under the same names. A program that acts on an event looks at its words and numbers, never at a
sentence (`text`, `reasons`): those are for people, and their wording may change.

This page and [output.schema.json](output.schema.json) are made by `scripts/output_contract.py` from `m3r_app/output.py`.
"""


def _summary(kind: type) -> str:
    return " ".join((kind.__doc__ or "").split())


def _described(kind: type, properties: dict[str, Any]) -> dict[str, Any]:
    hints = get_type_hints(kind, include_extras=True)
    return {
        name: {**{k: v for k, v in value.items() if k not in ("title", "default")}, **_description(hints[name])}
        for name, value in properties.items()
    }


def _description(hint: Any) -> dict[str, str]:
    return {"description": hint.__metadata__[0]} if get_origin(hint) is Annotated else {}


def _table(kind: type) -> str:
    hints = get_type_hints(kind, include_extras=True)
    rows = [f"| `{name}` | {_type(hints[name])} | {_meaning(hints[name])} |" for name in _field_names(kind)]
    return "\n".join(["| field | type | meaning |", "|---|---|---|", *rows, ""])


def _field_names(kind: Any) -> list[str]:
    return [field.name for field in fields(kind)]


def _meaning(hint: Any) -> str:
    return str(hint.__metadata__[0]) if get_origin(hint) is Annotated else ""


def _type(hint: Any) -> str:
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _type(inner[0])
    if origin is Literal:
        return " or ".join(f"`{value}`" for value in inner)
    if origin is tuple:
        return f"list of {_type(inner[0])}" if inner[-1] is Ellipsis else f"list of {len(inner)}: {_type(inner[0])}"
    if origin is UnionType or len(inner) > 1:
        return " or ".join(_type(one) for one in inner)
    names = {NoneType: "null", str: "string", bool: "boolean", int: "integer", float: "number", FindingTold: "finding"}
    if hint in names:
        return names[hint]
    if isinstance(hint, EnumType):
        return f"word of {hint.__name__}"
    return "list of 3 numbers"


def _enums() -> set[EnumType]:
    found: set[EnumType] = set()
    for kind in EVENT_TYPES:
        for hint in get_type_hints(kind).values():
            if isinstance(hint, EnumType):
                found.add(hint)
    return found
