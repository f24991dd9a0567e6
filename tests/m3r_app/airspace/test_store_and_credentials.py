"""What an authority must not forget, and who somebody is: each thing that is wrong is one sentence. X10."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from m3r_app.airspace import authority
from m3r_app.airspace.authority import CLAIM_S, App, Authority
from m3r_app.airspace.credentials import AirError, Broker, load_credentials, parse_broker, tls_context
from m3r_app.airspace.service import EARTH
from m3r_app.airspace.store import Store
from safety.vocabulary import Ned, ReservedVolume
from tests.air import LACKING, MOSQUITTO, ROOT

VOLUME = ReservedVolume("red", Ned(0, 0, -10), Ned(1, 0, -10), 2.0, 0.0, 4.0)
ALICE, BOB = App("alice", "a" * 16), App("bob", "b" * 16)


def granted() -> Authority:
    a, _ = authority.claim(Authority(), "red", ALICE, None, 0.0)
    a, _ = authority.claim(a, "red", BOB, None, 0.0)
    a, verdict = authority.reserve(a, "red", ALICE, 1, "r1", VOLUME, 0.0)
    assert verdict.granted
    return a


@pytest.mark.requirement("X3", "X10")
def test_after_a_start_everything_holds_for_its_full_time(tmp_path: Path) -> None:
    store = Store(tmp_path / "memory", "field")
    store.save(granted(), EARTH)
    store.close()
    again = Store(tmp_path / "memory", "field").load(EARTH, 1000.0)
    assert again.fence == 2
    assert again.claims["red"].until_s == 1000.0 + CLAIM_S and again.claims["red"].operator == "alice"
    assert again.waiting["red"].operator == "bob"
    (volume,) = again.volumes.values()
    assert volume.volume.until_s == pytest.approx(1004.0) and volume.volume.start == pytest.approx(
        VOLUME.start, abs=1e-5
    )
    assert not authority.claim(again, "red", BOB, None, 1000.0 + CLAIM_S - 0.1)[1].granted
    assert authority.claim(again, "red", ALICE, 1, 1000.0 + CLAIM_S - 0.1)[1].granted


def test_renewals_are_not_written(tmp_path: Path) -> None:
    store = Store(tmp_path / "memory", "field")
    a = granted()
    store.save(a, EARTH)
    before = (tmp_path / "memory").stat().st_mtime_ns
    a, _ = authority.claim(a, "red", ALICE, 1, 3.0)
    store.save(a, EARTH)
    assert (tmp_path / "memory").stat().st_mtime_ns == before


def test_what_was_prolonged_while_the_authority_was_away_is_kept_too(tmp_path: Path) -> None:
    """A volume of 60 s that was prolonged by a long absence still is one of 60 s."""
    a, _ = authority.claim(Authority(), "red", ALICE, None, 0.0)
    long = ReservedVolume("red", Ned(0, 0, -10), Ned(1, 0, -10), 2.0, 0.0, 60.0)
    a, _ = authority.reserve(a, "red", ALICE, 1, "x", long, 0.0)
    store = Store(tmp_path / "memory", "field")
    store.save(authority.resumed(a, 1000.0), EARTH)
    store.close()
    (volume,) = Store(tmp_path / "memory", "field").load(EARTH, 5.0).volumes.values()
    assert volume.volume.until_s == pytest.approx(65.0)


def test_what_is_wrong_with_a_memory_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "memory"
    store = Store(path, "field")
    with pytest.raises(AirError, match="another airspace authority uses"):
        Store(path, "field")
    assert store.load(EARTH, 0.0) == Authority()
    for text in ("", "{", "[]", '{"fence": 1}', "\xff"):
        path.write_text(text, encoding="latin-1")
        with pytest.raises(AirError, match="is damaged: if no drone is flown in field, delete it"):
            store.load(EARTH, 0.0)
    store.save(granted(), EARTH)
    store.close()
    with pytest.raises(AirError, match="is the memory of another area"):
        Store(path, "hill").load(EARTH, 0.0)
    with pytest.raises(AirError, match="cannot be written: File exists"):
        Store(path / "below", "field")


@pytest.mark.requirement("X10")
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_grant_that_cannot_be_kept_is_none(tmp_path: Path) -> None:
    path = tmp_path / "memory"
    store = Store(path, "field")
    (tmp_path / "memory.new").symlink_to("/dev/full")
    with pytest.raises(AirError, match="cannot be written: No space left"):
        store.save(granted(), EARTH)


# ---------------------------------------------------------------- credentials


@pytest.fixture(scope="module")
def air(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if MOSQUITTO is None:
        pytest.skip(LACKING)
    folder = tmp_path_factory.mktemp("made") / "air"
    done = make(folder, "--operator", "alice=red,green", "--drone", "yellow")
    assert done.returncode == 0, done.stderr
    return folder


def make(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    script = str(ROOT / "scripts/make_airspace.py")
    return subprocess.run([sys.executable, script, str(folder), *words], capture_output=True, text=True, check=False)


def test_everybody_gets_what_they_need_and_no_more(air: Path) -> None:
    alice = load_credentials(air / "operator.alice.json", "operator")
    assert alice.flies == ["red", "green"] and (alice.name, alice.role) == ("alice", "operator")
    assert set(alice.keys) == {"operator.alice", "airspace.field", "drone.red", "drone.green", "drone.yellow"}
    yellow = load_credentials(air / "drone.yellow.json", "drone", "operator")
    assert set(yellow.keys) == {"drone.yellow"} and yellow.flies == ["yellow"]
    field = load_credentials(air / "airspace.field.json", "airspace")
    assert set(field.keys) == {"airspace.field", "operator.alice"} and field.flies == []
    assert tls_context(alice, Broker("localhost", 1, tls=True)) is not None
    assert tls_context(alice, Broker("localhost", 1, tls=False)) is None
    secrets = [p for p in air.rglob("*") if p.is_file() and p.suffix != ".crt"]
    assert secrets and all(stat.S_IMODE(p.stat().st_mode) == 0o600 for p in secrets)
    assert alice.password not in (air / "broker/passwords").read_text()


@pytest.mark.parametrize(("change", "told"), [
    ({"user": "alice"}, "user"), ({"password": ""}, "password"), ({"more": 1}, "more"), ({"keys": {}}, "lack the key of"),
    ({"keys": {"operator.alice": "00"}}, "keys"), ({"flies": ["Red"]}, "flies"), ({"area": None}, "area"),
])  # fmt: skip
def test_credentials_that_are_not_whole(air: Path, tmp_path: Path, change: dict[str, object], told: str) -> None:
    path = tmp_path / "alice.json"
    path.write_text(json.dumps(json.loads((air / "operator.alice.json").read_text()) | change))
    path.chmod(0o600)
    with pytest.raises(AirError) as error:
        load_credentials(path, "operator")
    assert told in str(error.value) and str(path) in str(error.value) and "\n" not in str(error.value)


def test_credentials_of_somebody_else_or_for_all_to_read(air: Path, tmp_path: Path) -> None:
    with pytest.raises(AirError, match="are a drone's, and an operator's are needed here"):
        load_credentials(air / "drone.red.json", "operator")
    open_to_all = tmp_path / "open.json"
    open_to_all.write_text((air / "operator.alice.json").read_text())
    open_to_all.chmod(0o644)
    with pytest.raises(AirError, match="can be read by others on this computer: chmod 600"):
        load_credentials(open_to_all, "operator")
    for wrong in (tmp_path, tmp_path / "none"):
        with pytest.raises(AirError, match="cannot be read"):
            load_credentials(wrong, "operator")
    binary = tmp_path / "binary.json"
    binary.write_bytes(os.urandom(64))
    binary.chmod(0o600)
    with pytest.raises(AirError):
        load_credentials(binary, "operator")


@pytest.mark.parametrize(("text", "broker"), [
    ("mqtts://broker.local", Broker("broker.local", 8883, tls=True)),
    ("mqtts://broker.local:1234/", Broker("broker.local", 1234, tls=True)),
    ("mqtt://127.0.0.1", Broker("127.0.0.1", 1883, tls=False)),
    ("mqtt://[::1]:1884", Broker("::1", 1884, tls=False)),
])  # fmt: skip
def test_a_broker_address(text: str, broker: Broker) -> None:
    assert parse_broker(text) == broker


@pytest.mark.parametrize("text", [
    "", "broker", "mqtts://", "http://x", "mqtts://x:0x10", "mqtts://x:99999", "mqtts://x/topic", "mqtts://x?y", "mqtt://x",
    "mqtts://a:b@x", "mqtts://a@x", "mqtts://[::1", "mqtts:// x",
])  # fmt: skip
def test_anything_else_is_told(text: str) -> None:
    with pytest.raises(AirError) as error:
        parse_broker(text)
    assert "\n" not in str(error.value)


@pytest.mark.skipif(MOSQUITTO is None, reason=LACKING)
@pytest.mark.parametrize(("words", "told"), [
    (["--operator", "alice"], "is not NAME=DRONE"), (["--operator", "Alice=red"], "small letters"),
    (["--operator", "alice=red,"], "small letters"), (["--operator", "a=red", "--operator", "a=blue"], "twice"),
    (["--operator", "a=red", "--port", "70000"], "no port"), (["--operator", "a=red", "--host", "a b"], "no name of a computer"),
    (["--operator", "a=red", "--no-tls", "--host", "far"], "in clear"), (["--operator", "a=red", "--days", "0"], "between 1 and"),
    (["--operator", "a=red", "--area", "../x"], "small letters"),
])  # fmt: skip
def test_what_the_script_cannot_make_it_says(tmp_path: Path, words: list[str], told: str) -> None:
    done = make(tmp_path / "air", *words)
    assert done.returncode == 2 and told in done.stderr and "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_made_over_what_is_there(air: Path) -> None:
    done = make(air, "--operator", "alice=red")
    assert done.returncode == 2 and "is there already" in done.stderr
