"""The 3D scene: pure updates that follow the schemas, live over the WebSocket, and the same in the record."""

from __future__ import annotations

import asyncio
import json
import math
import socket
import struct
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from m3r_app.environment.ground import Ground
from m3r_app.environment.static_scene import static_scene
from m3r_app.options import RunOptions
from m3r_app.plain import plain
from m3r_app.ports import LinkError
from m3r_app.record.foxglove_scene import Scene
from m3r_app.record.foxglove_schemas import SCHEMAS
from m3r_app.record.foxglove_server import PER_VIEWER, QUEUE_LENGTH, Viewer
from m3r_app.run_setup import prepare
from tests.whole import App, m3r

PROTOCOL = "foxglove.sdk.v1"
SECOND = 1_000_000_000
HERE = [14.0, 0.0, -6.0]


def shipped_scene() -> dict[str, Any]:
    setup = prepare(RunOptions())
    return static_scene(setup.world, setup.operator)


def follows(value: Any, schema: dict[str, Any], where: str = "") -> None:
    """The part of JSON Schema that ours use, and no property that is not in it."""
    kind = schema.get("type")
    if kind == "object":
        assert isinstance(value, dict), where
        properties = schema.get("properties", {})
        assert set(value) <= set(properties), f"{where}: {set(value) - set(properties)}"
        for name, item in value.items():
            follows(item, properties[name], f"{where}.{name}")
    elif kind == "array":
        assert isinstance(value, list), where
        for item in value:
            follows(item, schema["items"], f"{where}[]")
    else:
        types = {"number": (int, float), "integer": int, "string": str, "boolean": bool}
        assert isinstance(value, types[str(kind)]), (where, value)
        assert not isinstance(value, float) or math.isfinite(value), where


def updates(scene: Scene, topic: str, **data: Any) -> list[dict[str, Any]]:
    """The scene's updates by one message, each checked against its schema."""
    found = scene.views(topic, plain(data, lossless=True), 5 * SECOND)
    for view in found:
        follows(view.message, SCHEMAS[view.schema])
        json.dumps(view.message, allow_nan=False)
    return [view.message for view in found]


def entities(messages: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    return {entity["id"]: entity for message in messages for entity in message["entities"]}


def test_the_stage_is_ground_obstacles_fence_and_operator() -> None:
    stage = entities(updates(Scene(), "stage", **shipped_scene()))
    assert set(stage) == {"ground", "obstacles", "fence", "operator"}
    mesh = stage["ground"]["triangles"][0]
    assert len(mesh["points"]) == 61 * 61
    assert len(mesh["indices"]) == 6 * 60 * 60
    assert max(mesh["indices"]) < len(mesh["points"])
    assert [label["text"] for label in stage["obstacles"]["texts"]] == ["the wall", "the barn"]
    assert stage["fence"]["lines"]


def test_ground_without_data_is_a_hole() -> None:
    heights = np.zeros((3, 3))
    heights[0, 0] = math.nan
    ground = Ground(np.arange(3.0), np.arange(3.0), heights)
    stage = entities(
        updates(Scene(), "stage", ground=ground, obstacles=[], fence_ne_m=[], fence_levels_m=[], operator=None)
    )
    assert len(stage["ground"]["triangles"][0]["indices"]) == 6 * 3
    assert "operator" not in stage


def test_what_was_asked_for_and_not_granted_is_another_line() -> None:
    scene = Scene()
    updates(scene, "decision", verdict="reduced", requested_m=1.0, granted_m=0.4, findings=[])
    drawn = entities(updates(scene, "plan", points_ned_m=[HERE, [14.0, 0.4, -6.0]]))
    assert drawn["plan"]["lines"][0]["points"][-1] == {"x": 0.4, "y": 14.0, "z": 6.0}
    assert drawn["refused"]["lines"][0]["points"][-1] == pytest.approx({"x": 1.0, "y": 14.0, "z": 6.0})
    updates(scene, "decision", verdict="approved", requested_m=0.4, granted_m=0.4, findings=[])
    (message,) = updates(scene, "plan", points_ned_m=[HERE, [14.0, 0.4, -6.0]])
    assert [gone["id"] for gone in message["deletions"]] == ["refused"]


def test_a_blocked_request_stands_where_the_drone_is_and_vanishes() -> None:
    scene = Scene()
    rejected = {
        "verdict": "rejected",
        "requested_m": 1.0,
        "granted_m": None,
        "findings": [{"passed": False, "text": "too low"}],
    }
    assert updates(scene, "decision", **rejected) == []  # nobody knows where
    updates(scene, "telemetry", t=1.0, position=HERE, vehicle="red")
    blocked = entities(updates(scene, "decision", **rejected))["blocked"]
    assert blocked["texts"][0]["text"] == "blocked: too low"
    assert blocked["lifetime"]["sec"] > 0
    assert blocked["spheres"][0]["pose"]["position"] == {"x": 0.0, "y": 14.0, "z": 6.0}


def test_the_anchor_moves_and_goes() -> None:
    scene = Scene()
    ball = entities(updates(scene, "anchor", position=HERE, radius_m=5.0))["anchor"]["spheres"][0]
    assert ball["size"] == {"x": 10.0, "y": 10.0, "z": 10.0}
    (message,) = updates(scene, "anchor", position=None, radius_m=5.0)
    assert [gone["id"] for gone in message["deletions"]] == ["anchor"]


def test_a_neighbour_tells_its_age_and_grows_with_it() -> None:
    def seen(at_s: float) -> dict[str, Any]:
        heard = {
            "names": ["green"],
            "positions_ned_m": [HERE],
            "velocities_ned_m_s": [[2.0, 0.0, 0.0]],
            "sigmas_m": [0.3],
            "at_s": [at_s],
            "feed_at_s": 10.0,
        }
        return entities(updates(Scene(), "neighbours", neighbours=heard))["neighbour green"]

    fresh, old = seen(9.9), seen(7.0)
    assert fresh["texts"][0]["text"] == "green 0.1 s"
    assert old["texts"][0]["text"] == "green 3.0 s"
    assert fresh["spheres"][0]["size"]["x"] == pytest.approx(2 * (0.3 + 0.2))
    assert old["spheres"][0]["size"]["x"] == pytest.approx(2 * (0.3 + 6.0))
    assert fresh["spheres"][0]["color"] != old["spheres"][0]["color"]
    assert seen(math.nan)["texts"][0]["text"] == "green silent"


@given(
    values=st.lists(
        st.one_of(st.none(), st.floats(), st.text(max_size=3), st.lists(st.floats(), max_size=4)),
        min_size=5,
        max_size=5,
    ),
    topic=st.sampled_from(["telemetry", "anchor", "decision", "plan", "neighbours"]),
)
def test_whatever_is_recorded_the_scene_is_strict_or_silent(topic: str, values: list[Any]) -> None:
    scene = Scene()
    updates(scene, "telemetry", t=1.0, position=HERE, vehicle="red")
    a, b, c, d, e = values
    neighbours = {
        "names": ["x"],
        "positions_ned_m": [a],
        "velocities_ned_m_s": [b],
        "sigmas_m": [c],
        "at_s": [d],
        "feed_at_s": e,
    }
    updates(
        scene,
        topic,
        t=a,
        position=b,
        radius_m=c,
        verdict="rejected",
        requested_m=d,
        findings=e,
        points_ned_m=[HERE, b],
        neighbours=neighbours,
    )


# ---------------------------------------------------------------- live


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


async def watched(port: int, wanted: set[str], then: Any = None) -> dict[str, dict[str, Any]]:
    """Subscribe to everything and read until all wanted topics have come; the first message of each."""
    names: dict[int, str] = {}
    found: dict[str, dict[str, Any]] = {}
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(f"ws://127.0.0.1:{port}", protocols=[PROTOCOL], max_msg_size=0) as ws,
    ):
        if then is not None:
            await then(ws)
        async with asyncio.timeout(60):
            async for message in ws:
                if message.type is aiohttp.WSMsgType.TEXT:
                    told = json.loads(message.data)
                    if told["op"] == "serverInfo":
                        assert told["capabilities"] == []
                    if told["op"] == "advertise":
                        for channel in told["channels"]:
                            names[channel["id"]] = channel["topic"]
                            assert json.loads(channel["schema"]) == SCHEMAS[channel["schemaName"]]
                        subscribed = [{"id": c["id"], "channelId": c["id"]} for c in told["channels"]]
                        await ws.send_json({"op": "subscribe", "subscriptions": subscribed})
                elif message.type is aiohttp.WSMsgType.BINARY and message.data[0] == 1:
                    (subscription,) = struct.unpack_from("<I", message.data, 1)
                    found.setdefault(names[subscription], json.loads(message.data[13:]))
                    if wanted <= set(found):
                        return found
    raise AssertionError(f"only {set(found)}")


async def test_a_flight_live_and_the_same_in_its_record(tmp_path: Path) -> None:
    port, record = free_port(), tmp_path / "flight.mcap"
    script = "0.5 panel go left\n"
    app = App(
        ["run", "--headless", "--pair", "red", "--script", "-", "--view", str(port), "--record", str(record)],
        stdin=script,
    )
    app.until("pair", status="confirmed")
    wanted = {
        "/view/scene/stage",
        "/view/scene/flight",
        "/view/scene/anchor",
        "/view/scene/plan",
        "/view/scene/neighbours",
        "/view/red/frame",
    }
    live = await watched(port, wanted)  # it came late, and is shown the stage all the same
    ran = app.finish()
    assert ran.status == 0
    assert any(f"ws://127.0.0.1:{port}" in event["text"] for event in ran.of("announce"))
    with record.open("rb") as file:
        recorded = {
            channel.topic: (schema, json.loads(message.data))
            for schema, channel, message in make_reader(file).iter_messages()
            if schema
        }
    assert wanted <= set(recorded)
    for topic in wanted:
        schema, message = recorded[topic]
        assert json.loads(schema.data) == SCHEMAS[schema.name]
        follows(message, SCHEMAS[schema.name])
        follows(live[topic], SCHEMAS[schema.name])
    ground = {e["id"]: e for e in live["/view/scene/stage"]["entities"]}["ground"]
    assert (
        ground["triangles"] == {e["id"]: e for e in recorded["/view/scene/stage"][1]["entities"]}["ground"]["triangles"]
    )


async def test_a_viewer_can_only_look() -> None:
    """What it sends is not listened to, and it goes on being shown."""
    port = free_port()
    viewer = Viewer(port)

    async def meddle(ws: aiohttp.ClientWebSocketResponse) -> None:
        await ws.send_json(
            {"op": "advertise", "channels": [{"id": 1, "topic": "/cmd", "encoding": "json", "schemaName": "x"}]}
        )
        await ws.send_bytes(b"\x01" + struct.pack("<I", 1) + b"{}")
        await ws.send_json({"op": "setParameters", "parameters": [{"name": "workspace_m", "value": 500}]})

    try:
        viewer.record("stage", 0.0, shipped_scene())
        await watched(port, {"/view/scene/stage"}, meddle)
    finally:
        viewer.close()


async def test_a_viewer_that_never_reads_costs_nothing() -> None:
    """Far more than any buffer holds is recorded at once; nobody waits."""
    port = free_port()
    viewer = Viewer(port)
    count = QUEUE_LENGTH + 50 * PER_VIEWER
    try:
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(f"ws://127.0.0.1:{port}", protocols=[PROTOCOL]) as ws,
        ):
            viewer.record("announce", 0.0, {"text": "first"})
            subscribed = False
            while not subscribed:
                told = json.loads((await ws.receive()).data)
                if told["op"] == "advertise":
                    await ws.send_json(
                        {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": told["channels"][0]["id"]}]}
                    )
                    subscribed = True
            for number in range(count):
                viewer.record("announce", float(number), {"text": "x" * 1000})
            assert viewer.dropped > 0
    finally:
        viewer.close()


def test_a_port_in_use_is_told() -> None:
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        held.listen()
        port = held.getsockname()[1]
        with pytest.raises(LinkError, match=str(port)):
            Viewer(port)
        ran = m3r("run", "--headless", "--view", str(port))
    assert ran.status == 2
    assert f"port {port} is held by another program" in ran.told


async def test_it_listens_on_loopback_only() -> None:
    viewer = Viewer(port := free_port())
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect(("192.0.2.1", 9))  # no packet is sent: only to learn our own address
            own = probe.getsockname()[0]
        with socket.socket() as outside:
            outside.settimeout(2.0)
            assert outside.connect_ex((own, port)) != 0
    finally:
        viewer.close()
