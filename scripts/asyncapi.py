"""Write docs/asyncapi.yaml from the code: what is said in the shared air, for other programs to take part.

    python scripts/asyncapi.py

AsyncAPI 3.0, written as JSON, which is YAML too. A test compares the file with what this makes.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from m3r_app.airspace.messages import BODY_OF, HELD_MAX, LIMIT_BYTES  # noqa: E402
from m3r_app.airspace.signatures import WINDOW_S  # noqa: E402
from m3r_app.airspace.topics import NAME, AnswerTopic, AskTopic, HeldTopic, StateTopic, Topic  # noqa: E402

FILE = ROOT / "docs" / "asyncapi.yaml"
SIGNATURE = (
    "One line, a line feed, then the JSON body: `M3R1 KEY-ID LIFE SEQUENCE UNIX-MS MAC`. LIFE is 16 hexadecimal digits, new at "
    "each start of a signer; SEQUENCE rises by one with every message of that life; MAC is the hexadecimal HMAC-SHA256, by the "
    "key of KEY-ID, of the topic, a line feed, the line up to and without the space before MAC, a line feed, and the body. "
    f"Messages more than {WINDOW_S:.0f} s off the receiver's clock, repeated, overtaken within their topic or signed by "
    "anybody but whom the topic names are dropped, and so are retained ones."
)
PARAMETERS: dict[str, dict[str, Any]] = {
    "cell": {"description": "H3 cell of resolution 8 (15 hexadecimal digits), in which the drone is or nearly is."},
    "drone": {"description": f"Name of a drone: {NAME}"},
    "operator": {"description": f"Name of an operator: {NAME}"},
    "area": {"description": f"Name of the area that one authority looks after: {NAME}"},
    "inbox": {"description": "One app of the operator: 16 hexadecimal digits, new at each start."},
}
CHANNELS: dict[type[Topic], tuple[str, Topic, str, str, int, str]] = {
    StateTopic: (
        "state",
        StateTopic("{cell}", "{drone}"),
        "drone.{drone}",
        (
            "Where a drone is, 5 to 10 times a second, in its cell and those that begin within 50 m. Listen to the own cell and "
            "the six around."
        ),
        0,
        "the drone itself, and operators who fly it",
    ),
    AskTopic: (
        "ask",
        AskTopic("{area}", "{drone}", "{operator}"),
        "operator.{operator}",
        (
            "Claim a drone, renew that at least every 5 s, give it up; reserve a volume for a maneuver, free it. Response topic: "
            "the app's inbox; correlation data: the 8 bytes of `id`."
        ),
        1,
        "this operator, for drones that he flies",
    ),
    AnswerTopic: (
        "answer",
        AnswerTopic("{operator}", "{inbox}"),
        "airspace.{area}",
        "What the authority says to one ask, with its correlation data. Fencing numbers of new grants only rise.",
        1,
        "authorities",
    ),
    HeldTopic: (
        "held",
        HeldTopic("{area}"),
        "airspace.{area}",
        (
            f"All live claims and volumes of an area (at most {HELD_MAX} each), twice a second and at each change. Not heard for "
            "2.5 s, the authority is gone, and nothing is granted."
        ),
        0,
        "the authority of the area",
    ),
}


def document() -> dict[str, Any]:
    """The whole document."""
    schemas: dict[str, Any] = {}
    channels, operations, messages = {}, {}, {}
    for kind, (name, topic, signer, about, qos, who) in CHANNELS.items():
        body = BODY_OF[kind].model_json_schema(ref_template="#/components/schemas/{model}")
        schemas |= _plain(body.pop("$defs", {}))
        schemas[BODY_OF[kind].__name__] = _plain(body)
        address = str(topic)
        channels[name] = {
            "address": address,
            "description": about,
            "parameters": {key: PARAMETERS[key] for key in PARAMETERS if f"{{{key}}}" in address},
            "messages": {name: {"$ref": f"#/components/messages/{name}"}},
        }
        messages[name] = {
            "name": name,
            "contentType": "application/json",
            "description": f"Signed by {signer}; at most {LIMIT_BYTES[kind]:,} bytes with its signature. {SIGNATURE}",
            "payload": {"$ref": f"#/components/schemas/{BODY_OF[kind].__name__}"},
            "x-signer": signer,
            "x-limit-bytes": LIMIT_BYTES[kind],
        }
        operations[f"tell_{name}"] = {
            "action": "send",
            "channel": {"$ref": f"#/channels/{name}"},
            "description": f"May be published by {who}; never retained.",
            "bindings": {"mqtt": {"qos": qos, "retain": False, "bindingVersion": "0.2.0"}},
            "messages": [{"$ref": f"#/channels/{name}/messages/{name}"}],
        }
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "M3R shared air",
            "version": "1",
            "description": "Claims, neighbours and reserved volumes of drones over MQTT 5. Durations are relative, so that no "
            "clock need be shared; coordinates are WGS 84 with metres above mean sea level; velocities are north, east, down.",
        },
        "defaultContentType": "application/json",
        "channels": channels,
        "operations": operations,
        "components": {"messages": messages, "schemas": dict(sorted(schemas.items()))},
    }


def _plain(schema: Any) -> Any:
    """In AsyncAPI a discriminator is only the name of the key."""
    if isinstance(schema, list):
        return [_plain(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    return {
        key: value["propertyName"] if key == "discriminator" and isinstance(value, dict) else _plain(value)
        for key, value in schema.items()
    }


def text() -> str:
    """The file's content."""
    return (
        "# Written by scripts/asyncapi.py from the code. JSON, which is YAML too.\n"
        + json.dumps(document(), indent=2)
        + "\n"
    )


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
