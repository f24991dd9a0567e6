"""Claims, volumes and neighbours over a real Mosquitto with the shipped configuration. P1, X8, X10, R5, R11."""

from __future__ import annotations

import asyncio
import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import aiomqtt
import numpy as np
import pytest

from m3r_app.airspace import mqtt_connection
from m3r_app.airspace.authority import CLAIM_S
from m3r_app.airspace.credentials import AirError, load_credentials, parse_broker, tls_context
from m3r_app.airspace.service import LISTEN_S, AirspaceService
from m3r_app.airspace.shared import OURS_S
from m3r_app.airspace.store import Store
from m3r_app.airspace.topics import AskTopic, HeldTopic, StateTopic, cell_of
from safety.vocabulary import Ned, ReservedVolume
from tests.air import HERE, ROOT, App, Broker, Proxy, app, authority, broker, until

SOAK = os.environ.get("M3R_SOAK") == "1"
RED, BLUE = Ned(0.0, 0.0, -10.0), Ned(30.0, 0.0, -10.0)
pytestmark = pytest.mark.xdist_group("air")


@pytest.fixture
def air(tmp_path: Path) -> Iterator[Broker]:
    with broker(tmp_path) as one:
        yield one


def volume(drone: str, north_m: float = 0.0, lasts_s: float = 5.0) -> ReservedVolume:
    now_s = time.monotonic()
    return ReservedVolume(drone, Ned(north_m, 0, -10), Ned(north_m + 1, 0, -10), 2.0, now_s, now_s + lasts_s)


async def reserved(
    one: App, drone: str, lease: str, north_m: float = 0.0, asked: ReservedVolume | None = None
) -> tuple[str, str]:
    answered: asyncio.Future[tuple[str, str]] = asyncio.get_running_loop().create_future()
    one.shared.reserve(drone, lease, asked or volume(drone, north_m), lambda *answer: answered.set_result(answer))
    return await asyncio.wait_for(answered, 2.0)


@pytest.mark.requirement("X3")
async def test_one_drone_has_one_operator_and_is_handed_over_in_order(air: Broker, tmp_path: Path) -> None:
    async with (
        authority(air, tmp_path / "memory"),
        app(air, "alice", red=RED) as alice,
        app(air, "bob", blue=BLUE) as bob,
        app(air, "bob", green=BLUE) as also_bob,
    ):
        assert await alice.claim("red") is None
        assert await bob.claim("red") == "alice holds it"
        await until(lambda: "Red: bob asks for it; disconnect to hand it over" in alice.told)
        assert (
            await alice.claim("yellow")
            == "the credentials of operator.alice do not allow it: give ones made for yellow"
        )
        alice.shared.give_up("red")
        assert alice.shared.lost("red") == "it is not claimed any more"
        assert await alice.claim("red") == "bob has asked for it before and comes first"
        assert await bob.claim("red") is None
        assert await also_bob.claim("red") == "another app of bob holds it"


@pytest.mark.requirement("X8", "X10")
async def test_nothing_that_one_asks_ends_the_authority(
    air: Broker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Volumes at the bounds of what may be asked; then one that nobody foresaw: left unanswered, and all others are served."""
    async with (
        authority(air, tmp_path / "memory"),
        app(air, "alice", red=RED) as alice,
        app(air, "bob", blue=BLUE) as bob,
    ):
        assert await alice.claim("red") is None and await bob.claim("blue") is None
        for i in range(3):
            low = volume("red", 10.0 * i, 60.0)
            down_m = 500.0 + HERE.amsl_m
            wide = replace(
                low, start=low.start._replace(down=down_m), end=low.end._replace(down=down_m), radius_m=100.0
            )
            assert await reserved(alice, "red", f"low{i}", asked=wide) == ("granted", "")
        decide = AirspaceService._decide
        monkeypatch.setattr(
            AirspaceService, "_decide",
            lambda self, a, topic, body: decide(self, a, topic, body) if topic.operator != "alice" else 1 // 0,
        )  # fmt: skip
        alice.shared.free("red", "low0")
        assert (await reserved(bob, "blue", "b", 1000.0))[0] == "granted"


@pytest.mark.requirement("X10")
async def test_what_is_told_of_a_lease_says_nothing_of_whose_app_it_is(air: Broker, tmp_path: Path) -> None:
    async with authority(air, tmp_path / "memory"), app(air, "alice", red=RED) as alice:
        assert await alice.claim("red") is None
        assert await reserved(alice, "red", "r1") == ("granted", "")
        (lease,) = json.loads((tmp_path / "memory").read_text())["volumes"]
        assert alice.shared._inbox.inbox not in lease["lease"] and "r1" not in lease["lease"]


@pytest.mark.requirement("R5")
async def test_what_one_tells_the_other_sees(air: Broker, tmp_path: Path) -> None:
    async with (
        authority(air, tmp_path / "memory"),
        app(air, "alice", red=RED) as alice,
        app(air, "bob", blue=BLUE) as bob,
    ):
        await until(lambda: alice.sees("red", "blue") and bob.sees("blue", "red"))
        seen = alice.neighbours("red")
        assert seen.names == ("blue",)
        assert seen.positions_ned_m[0] == pytest.approx(BLUE, abs=1e-3)
        assert 0.0 <= time.monotonic() - seen.at_s[0] < 0.5
        assert alice.feed_age_s("red") < 0.5


@pytest.mark.requirement("X10")
async def test_air_is_given_to_one_at_a_time(air: Broker, tmp_path: Path) -> None:
    async with (
        authority(air, tmp_path / "memory"),
        app(air, "alice", red=RED) as alice,
        app(air, "bob", blue=BLUE) as bob,
    ):
        assert (await reserved(alice, "red", "a"))[0] == "denied", "not claimed"
        assert await alice.claim("red") is None and await bob.claim("blue") is None
        assert await reserved(alice, "red", "a") == ("granted", "")
        answer, why = await reserved(bob, "blue", "a", 3.0)
        assert answer == "denied" and why.startswith("red holds it for another ")
        await until(lambda: len(bob.shared.held_by_others("blue")) == 1)
        (held,) = bob.shared.held_by_others("blue")
        assert held.holder == "red" and held.start == pytest.approx(Ned(0, 0, -10), abs=1e-3)
        assert alice.shared.held_by_others("red") == ()
        assert (await reserved(bob, "blue", "b", 30.0))[0] == "granted"
        alice.shared.free("red", "a")
        await until(lambda: bob.shared.held_by_others("blue") == ())
        assert (await reserved(bob, "blue", "c", 3.0))[0] == "granted"


async def test_broker_restarts_leave_claims_in_the_same_hands(air: Broker, tmp_path: Path) -> None:
    """3 of them here, 50 with M3R_SOAK=1; each is said and over within seconds."""
    async with (
        authority(air, tmp_path / "memory"),
        app(air, "alice", red=RED) as alice,
        app(air, "bob", blue=BLUE) as bob,
    ):
        assert await alice.claim("red") is None and await bob.claim("blue") is None
        for n in range(50 if SOAK else 3):
            air.stop(hard=n % 2 == 0)
            assert await until(lambda: not alice.link.up and not bob.link.up) < 2.0
            air.start()
            assert await until(lambda: alice.feed_age_s("red") < 0.5 and bob.feed_age_s("blue") < 0.5) < 8.0
            assert (await _settled(bob.claim, "red")) == "alice holds it"
            assert alice.shared.lost("red") is None and bob.shared.lost("blue") is None
            alice.shared.give_up("blue")
        assert any("is lost" in said or "nobody answers" in said for said in alice.told)


async def _settled(claim, drone: str) -> str | None:
    """The answer of the authority, once it is back itself."""
    deadline_s = time.monotonic() + 8.0
    while (answer := await claim(drone)) is not None and "holds it" not in answer:
        assert time.monotonic() < deadline_s, answer
        await asyncio.sleep(0.05)
    return answer


@pytest.mark.requirement("X10", "X3")
async def test_a_partition_is_noticed_and_never_makes_two_holders(air: Broker, tmp_path: Path) -> None:
    """Ours ends before anybody else can have it, though nobody closes a connection. Source: X10."""
    async with (
        authority(air, tmp_path / "memory"),
        Proxy(air.port) as network,
        app(air, "alice", port=network.port, red=RED) as alice,
        app(air, "bob", blue=BLUE) as bob,
    ):
        assert await alice.claim("red") is None
        await until(lambda: bob.sees("blue", "red"))
        network.cut()
        cut_s = time.monotonic()
        assert await until(lambda: any("does not pass our messages on" in said for said in alice.told)) < 2.0
        assert await reserved(alice, "red", "a") == ("denied", f"mqtts://localhost:{network.port} is not reached")
        lost_s = granted_s = None
        while granted_s is None:
            now_s = time.monotonic()
            if lost_s is None and alice.shared.lost("red") is not None:
                lost_s = now_s - cut_s
            assert now_s - cut_s < CLAIM_S + 3.0
            if await bob.claim("red") is None:
                granted_s = time.monotonic() - cut_s
            if lost_s is None and alice.shared.lost("red") is not None:
                lost_s = now_s - cut_s
        assert lost_s is not None and lost_s <= OURS_S + 0.5 and lost_s < granted_s <= CLAIM_S + 1.5
        assert alice.feed_age_s("red") > 1.0 and bob.sees("blue", "red"), "silent, but not forgotten"
        network.heal()
        await until(lambda: alice.feed_age_s("red") < 0.5)
        assert await _settled(alice.claim, "red") == "bob holds it"


async def test_an_authority_that_starts_again_remembers_and_two_are_refused(air: Broker, tmp_path: Path) -> None:
    memory = tmp_path / "memory"
    async with app(air, "alice", red=RED) as alice, app(air, "bob", blue=BLUE) as bob:
        assert "is not heard" in (await alice.claim("red") or "")
        async with authority(air, memory):
            assert await _granted(alice, "red")
            before = json.loads(memory.read_text())["fence"]
            with pytest.raises(AirError, match="another airspace authority uses"):
                Store(memory, "field")
            second = AirspaceService(
                parse_broker(air.url),
                load_credentials(air.credentials("airspace.field"), "airspace"),
                Store(tmp_path / "other", "field"),
                lambda _: None,
            )
            with pytest.raises(AirError, match="another airspace authority of field is at work"):
                await asyncio.wait_for(second.run(), 5.0)
        async with authority(air, memory):
            assert await _settled(bob.claim, "red") == "alice holds it"
            assert alice.shared.lost("red") is None
            assert await _granted(bob, "green") and json.loads(memory.read_text())["fence"] > before


async def _granted(one: App, drone: str) -> bool:
    deadline_s = time.monotonic() + 8.0
    while await one.claim(drone) is not None:
        assert time.monotonic() < deadline_s
        await asyncio.sleep(0.05)
    return True


async def test_an_authority_starts_in_its_listening_time_and_says_nothing_else(air: Broker, tmp_path: Path) -> None:
    """It has nothing to hear of itself before it speaks, and takes no silence for a dead network."""
    said: list[str] = []
    ready = asyncio.Event()
    secret = load_credentials(air.credentials("airspace.field"), "airspace")
    service = AirspaceService(parse_broker(air.url), secret, Store(tmp_path / "memory", "field"), said.append)
    task = asyncio.create_task(service.run(ready.set))
    await asyncio.wait_for(ready.wait(), LISTEN_S + 1.0)
    assert said == []
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


@pytest.mark.requirement("X3", "X10")
async def test_without_an_authority_nothing_is_granted_and_claims_end(air: Broker, tmp_path: Path) -> None:
    async with app(air, "alice", red=RED) as alice:
        async with authority(air, tmp_path / "memory"):
            assert await alice.claim("red") is None
        assert await until(lambda: alice.shared.lost("red") is not None) < OURS_S + 0.5
        assert alice.shared.lost("red") == "its claim could not be renewed for 4 s"
        assert (await reserved(alice, "red", "a"))[0] == "denied"
        assert "is not heard" in (await alice.claim("green") or "")
        await until(lambda: any("airspace authority of field is not heard" in said for said in alice.told))


# ---------------------------------------------------------------- nobody gets in


async def intruder(air: Broker, user: str = "operator.bob", **settings: object) -> aiomqtt.Client:
    """Somebody with a valid login: in a hijacked session, or an insider."""
    secret = load_credentials(air.credentials(user), "operator", "drone", "airspace")
    return aiomqtt.Client(
        "localhost", air.port, username=secret.user, password=secret.password,
        protocol=aiomqtt.ProtocolVersion.V5, tls_context=tls_context(secret, parse_broker(air.url)), **settings,
    )  # fmt: skip


async def test_a_stolen_client_id_costs_a_moment_and_nothing_else(air: Broker, tmp_path: Path) -> None:
    async with authority(air, tmp_path / "memory"), app(air, "alice", red=RED) as alice:
        assert await alice.claim("red") is None
        for _ in range(3):
            stolen = alice.link.client_id
            async with await intruder(air, "drone.yellow", identifier=stolen):
                await until(lambda seen=stolen: alice.link.client_id != seen and alice.link.up)
            await until(lambda: alice.feed_age_s("red") < 0.5)
            assert alice.shared.lost("red") is None


@pytest.mark.requirement("X6")
async def test_forged_replayed_and_torn_messages_are_dropped_and_counted(air: Broker, tmp_path: Path) -> None:
    """Even from inside a session that may publish there, and none of it takes anybody out of the sky."""
    async with (
        authority(air, tmp_path / "memory"),
        app(air, "alice", red=RED) as alice,
        app(air, "bob", blue=BLUE) as bob,
    ):
        await until(lambda: alice.sees("red", "blue"))
        topic = str(StateTopic(cell_of(HERE), "blue"))
        async with await intruder(air) as client:
            await client.subscribe("m3r/1/state/+/+")
            captured: list[bytes] = []
            async for message in client.messages:
                if str(message.topic) == topic:
                    captured.append(bytes(message.payload))
                    break
            (real,) = captured
            await until(lambda: alice.shared.dropped.get("x", 0) == 0)
            far = real.replace(b'"amsl_m":590', b'"amsl_m":990')
            assert far != real
            for payload in (real, far, real[:-7], real[:40], b"", b"\xff" * 900, b"x" * 5000):
                await client.publish(topic, payload, qos=1)
            await client.publish(str(StateTopic(cell_of(HERE), "green")), real, qos=1)
        await until(lambda: sum(alice.shared.dropped.values()) >= 8)
        counts = alice.shared.dropped
        assert counts["replayed"] == 1 and counts["forged"] >= 2 and counts["unreadable"] >= 3
        assert counts["too long"] == 1 and counts["wrong signer"] == 1
        assert alice.neighbours("red").names == ("blue",)
        assert alice.neighbours("red").positions_ned_m[0] == pytest.approx(BLUE, abs=1e-3)
        assert bob.sees("blue", "red")


@pytest.mark.parametrize("count", [100_000 if SOAK else 2_000])
async def test_noise_on_every_topic_harms_nobody(air: Broker, tmp_path: Path, count: int) -> None:
    """2,000 payloads through the broker here, 100,000 with M3R_SOAK=1: none is taken, nothing grows, everybody goes on."""
    seed = random.Random(7)
    async with (
        authority(air, tmp_path / "memory"),
        app(air, "alice", red=RED) as alice,
        app(air, "bob", blue=BLUE) as bob,
    ):
        assert await alice.claim("red") is None
        await until(lambda: alice.sees("red", "blue"))
        inbox = alice.shared._inbox
        topics = {
            "operator.bob": [StateTopic(cell_of(HERE), "green"), AskTopic("field", "green", "bob")],
            "airspace.field": [inbox, HeldTopic("field")],
        }
        before = (tmp_path / "memory").read_bytes()
        sent = 0
        async with await intruder(air) as insider, await intruder(air, "airspace.field") as forger:
            while sent < count:
                for client, user in ((insider, "operator.bob"), (forger, "airspace.field")):
                    for topic in topics[user]:
                        noise = seed.randbytes(seed.randrange(300))
                        if sent % 3 == 0:
                            noise = b"M3R1 drone.green " + b"0" * 16 + b" 1 1 " + b"0" * 64 + b"\n" + noise
                        elif sent % 3 == 1:
                            noise = json.dumps({"place": None, "more": noise.hex()}).encode()
                        await client.publish(str(topic), noise, qos=0)
                        sent += 1
                if sent % 100 == 0:
                    await asyncio.sleep(0.01)
            last = alice.shared.dropped
            await until(lambda: sum(last.values()) + alice.link.overflowed >= 0.7 * count, 60.0)
        assert alice.neighbours("red").names == ("blue",) and bob.sees("blue", "red")
        assert alice.shared.lost("red") is None and (tmp_path / "memory").read_bytes() == before
        assert len(alice.shared._channel.verifier._last) <= 8 and len(alice.shared._pending) <= 8
        assert await bob.claim("green") is None, "the authority still grants"


async def test_who_may_not_publish_notices_it_within_two_seconds(air: Broker, tmp_path: Path) -> None:
    """A denied publish is silent in MQTT: the own state does not come back."""
    greedy = tmp_path / "greedy.json"
    secret = json.loads(air.credentials("operator.bob").read_text())
    greedy.write_text(json.dumps(secret | {"flies": ["yellow"]}))
    greedy.chmod(0o600)
    async with authority(air, tmp_path / "memory"), app(air, "bob", credentials=greedy, yellow=BLUE) as bob:
        assert await until(lambda: any("may not publish there" in said for said in bob.told)) < 2.0
        assert bob.feed_age_s("yellow") == float("inf")
        async with app(air, "alice", red=RED) as alice:
            await until(lambda: alice.feed_age_s("red") < 0.5)
            assert not alice.sees("red", "yellow")


@pytest.mark.requirement("R11", "X6")
@pytest.mark.parametrize(("ahead_s", "sees"), [(3.0, True), (-3.0, True), (60.0, False)])
async def test_clocks_that_differ(air: Broker, tmp_path: Path, ahead_s: float, sees: bool) -> None:
    """Up to 5 s a state is taken and never thought fresher than it is; beyond, the drone is nowhere, which refuses."""
    async with authority(air, tmp_path / "memory"), app(air, "alice", red=RED) as alice:
        async with app(air, "bob", ahead_s=ahead_s, blue=BLUE):
            await until(lambda: alice.sees("red", "blue"))
            await until(lambda: alice.feed_age_s("red") < 0.5)
            seen = alice.neighbours("red")
            age_s = time.monotonic() - seen.at_s[0]
            if not sees:
                assert np.isnan(seen.positions_ned_m).all(), "nobody knows where it is"
                assert any("Blue is not to be relied on: its clock" in said for said in alice.told)
            elif ahead_s < -1.0:
                assert 3.0 <= age_s < 3.6
            else:
                assert 0.0 <= age_s < 0.6


# ---------------------------------------------------------------- one sentence each


async def why(air: Broker, port: int | None = None, credentials: Path | None = None) -> str:
    with pytest.raises(AirError) as told:
        async with app(air, "alice", port=port, credentials=credentials):
            pass
    return str(told.value)


async def test_what_is_wrong_with_a_broker_is_one_sentence(air: Broker, tmp_path: Path) -> None:
    secret = json.loads(air.credentials("operator.alice").read_text())

    def changed(**changes: object) -> Path:
        path = tmp_path / "changed.json"
        path.unlink(missing_ok=True)
        path.write_text(json.dumps(secret | changes))
        path.chmod(0o600)
        return path

    other = tmp_path / "other"
    other.mkdir()
    with broker(other) as somebody:
        foreign = json.loads(somebody.credentials("operator.alice").read_text())["ca"]
    assert await why(air, credentials=changed(password="guessed")) == (
        f"{air.url} does not accept the password of operator.alice: use credentials made for this broker"
    )
    assert f"the certificate of {air.url} is not to be trusted" in await why(air, credentials=changed(ca=foreign))
    assert "cannot be read" in await why(air, credentials=changed(ca="no certificate"))
    closed = 1
    assert (
        await why(air, port=closed)
        == f"nobody answers at mqtts://localhost:{closed}: start the broker, or correct --broker"
    )
    async with Saying(b"\x20\x02\x00\x01") as port:  # CONNACK of MQTT 3.1.1: unacceptable protocol version
        plain = Broker(air.folder, port, tls=False)
        assert (
            await why(plain) == f"mqtt://127.0.0.1:{port} does not speak MQTT 5: use one that does, such as Mosquitto 2"
        )
    async with Saying(b"HTTP/1.1 400 Bad Request\r\n\r\n") as port:
        assert "mqtt://127.0.0.1" in await why(Broker(air.folder, port, tls=False))
        assert "TLS" in await why(Broker(air.folder, port))
    async with Saying(b"") as port:
        assert "mqtt://127.0.0.1" in await why(Broker(air.folder, port, tls=False))


class Saying:
    """A server that says this and nothing else."""

    def __init__(self, words: bytes) -> None:
        self._words = words

    async def __aenter__(self) -> int:
        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.read(1)
            writer.write(self._words)
            await writer.drain()
            if not self._words.startswith(b" "):
                writer.close()

        self._server = await asyncio.start_server(serve, "127.0.0.1", 0)
        return int(self._server.sockets[0].getsockname()[1])

    async def __aexit__(self, *_: object) -> None:
        self._server.close()


async def test_a_broker_that_takes_nothing_is_said_and_nothing_piles_up(air: Broker, tmp_path: Path) -> None:
    async with authority(air, tmp_path / "memory"), app(air, "alice", red=RED) as alice:
        for _ in range(1000):
            alice.link.post("m3r/1/state/881f8edb2bfffff/red", b"x" * 100)
        assert alice.link.dropped > 900
        assert any("takes messages too slowly" in said for said in alice.told)


async def test_more_than_can_be_read_is_dropped_and_said(
    air: Broker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mqtt_connection, "INBOX", 1)
    async with authority(air, tmp_path / "memory"), app(air, "alice", red=RED) as alice:
        await until(lambda: alice.feed_age_s("red") < 0.5)
        async with await intruder(air) as client:
            for _ in range(300):
                await client.publish(str(StateTopic(cell_of(HERE), "blue")), b"x" * 100)
            await until(lambda: alice.link.overflowed > 0)
        assert any("than can be read, and some are dropped" in said for said in alice.told)
        await until(lambda: alice.feed_age_s("red") < 0.5)


# ---------------------------------------------------------------- races from two processes


@pytest.mark.requirement("X3", "X10")
@pytest.mark.parametrize("races", [200 if SOAK else 12])
async def test_of_two_at_the_same_moment_exactly_one_wins(air: Broker, tmp_path: Path, races: int) -> None:
    """One claim and one volume are wanted by two processes at once: 12 times here, 200 with M3R_SOAK=1."""
    async with authority(air, tmp_path / "memory"):
        racers = [
            await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "tests.air_racer", air.url, str(air.credentials(f"operator.{who}")), own),
                cwd=ROOT,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            for who, own in (("alice", "green"), ("bob", "blue"))
        ]
        try:
            for racer in racers:
                assert json.loads(await asyncio.wait_for(racer.stdout.readline(), 20.0)) == {"ready": True}
            claims, volumes = [0, 0], [0, 0]
            for n in range(races):
                # Sometimes one is a few milliseconds early.
                when_s = time.monotonic() + 0.05
                for i, racer in enumerate(racers):
                    racer.stdin.write(f"go {when_s + 0.001 * i * (n % 3)} {n}\n".encode())
                told = [json.loads(await asyncio.wait_for(racer.stdout.readline(), 10.0)) for racer in racers]
                for racer in racers:
                    racer.stdin.write(b"both told\n")
                assert sum(t["claim"] for t in told) == 1, told
                assert sum(t["volume"] for t in told) == 1, told
                for i, t in enumerate(told):
                    claims[i] += t["claim"]
                    volumes[i] += t["volume"]
                # Whoever lost comes first next, so that the wish is over before the next race.
        finally:
            for racer in racers:
                racer.stdin.close()
            for racer in racers:
                await asyncio.wait_for(racer.wait(), 10.0)
