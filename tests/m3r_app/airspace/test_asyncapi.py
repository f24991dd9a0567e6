"""The published description of the shared air is that of the code."""

from __future__ import annotations

import importlib.util
import json
import re

from m3r_app.airspace.messages import BODY_OF, LIMIT_BYTES
from m3r_app.airspace.topics import parse_topic
from tests.air import ROOT

spec = importlib.util.spec_from_file_location("asyncapi_script", ROOT / "scripts/asyncapi.py")
assert spec is not None and spec.loader is not None
script = importlib.util.module_from_spec(spec)
spec.loader.exec_module(script)

EXAMPLE = {"cell": "881f8edb2bfffff", "drone": "red", "operator": "alice", "area": "field", "inbox": "0" * 16}


def written() -> dict[str, object]:
    comment, _, rest = (ROOT / "docs/asyncapi.yaml").read_text().partition("\n")
    assert comment.startswith("#")
    return json.loads(rest)


def test_the_file_is_what_the_code_makes() -> None:
    assert (ROOT / "docs/asyncapi.yaml").read_text() == script.text(), "run scripts/asyncapi.py"


def test_every_kind_of_topic_is_described_with_its_body_signer_and_limit() -> None:
    found = written()
    assert len(found["channels"]) == len(BODY_OF) == len(LIMIT_BYTES)
    for name, channel in found["channels"].items():
        topic = parse_topic(re.sub(r"\{(\w+)\}", lambda m: EXAMPLE[m[1]], channel["address"]))
        assert topic is not None and set(channel["parameters"]) == set(re.findall(r"\{(\w+)\}", channel["address"]))
        message = found["components"]["messages"][name]
        assert message["x-limit-bytes"] == LIMIT_BYTES[type(topic)]
        assert message["payload"]["$ref"].endswith(f"/{BODY_OF[type(topic)].__name__}")
        signer = message["x-signer"].format(**EXAMPLE)
        assert topic.signer in (signer, None)
        assert found["operations"][f"tell_{name}"]["bindings"]["mqtt"]["retain"] is False
