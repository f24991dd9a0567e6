"""What is forged, replayed, reordered or cut off is dropped, and the memory of it is bounded."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from m3r_app.airspace import signatures
from m3r_app.airspace.signatures import WINDOW_S, Dropped, Signer, Verifier

KEY, OTHER = bytes(range(32)), bytes(32)
NOW_S = 1_800_000_000.0


class Clock:
    def __init__(self) -> None:
        self.now_s = NOW_S

    def __call__(self) -> float:
        return self.now_s


def pair(clock: Clock | None = None) -> tuple[Signer, Verifier]:
    clock = clock or Clock()
    return Signer("drone.red", KEY, clock), Verifier({"drone.red": KEY, "drone.blue": OTHER}, clock)


def reason(verifier: Verifier, topic: str, payload: bytes, signer: str = "drone.red") -> str:
    with pytest.raises(Dropped) as drop:
        verifier.open(topic, payload, signer)
    assert verifier.dropped[drop.value.reason] >= 1
    return drop.value.reason


@given(st.binary(max_size=300))
def test_what_was_sealed_is_opened_once(body: bytes) -> None:
    signer, verifier = pair()
    payload = signer.seal("t", body)
    envelope = verifier.open("t", payload, "drone.red")
    assert envelope.body == body and envelope.signer == "drone.red" and envelope.life == signer.life
    assert envelope.early_s == pytest.approx(0.0, abs=0.001)
    assert reason(verifier, "t", payload) == "replayed"


def test_every_bit_counts() -> None:
    signer, verifier = pair()
    payload = signer.seal("t", b'{"a": 1}')
    for at in range(len(payload)):
        changed = bytearray(payload)
        changed[at] ^= 1
        assert reason(verifier, "t", bytes(changed)) in ("forged", "unreadable", "wrong signer")
    for end in range(len(payload)):
        assert reason(verifier, "t", payload[:end]) in ("forged", "unreadable")
    verifier.open("t", payload, "drone.red")


def test_another_topic_signer_or_key_is_not_taken() -> None:
    signer, verifier = pair()
    payload = signer.seal("t", b"x")
    assert reason(verifier, "u", payload) == "forged"
    assert reason(verifier, "t", payload, "drone.blue") == "wrong signer"
    assert reason(verifier, "t", Signer("drone.blue", KEY, Clock()).seal("t", b"x"), "drone.blue") == "forged"
    assert reason(verifier, "t", Signer("drone.green", KEY, Clock()).seal("t", b"x"), "drone.green") == "wrong signer"


def test_what_was_overtaken_is_dropped_per_topic() -> None:
    signer, verifier = pair()
    first, second, elsewhere = signer.seal("t", b"1"), signer.seal("t", b"2"), signer.seal("u", b"3")
    verifier.open("u", elsewhere, "drone.red")
    verifier.open("t", second, "drone.red")
    assert reason(verifier, "t", first) == "replayed"


@pytest.mark.parametrize(
    ("ahead_s", "taken"),
    [
        (WINDOW_S - 0.01, True),
        (-WINDOW_S + 0.01, True),
        (WINDOW_S + 0.01, False),
        (-WINDOW_S - 0.01, False),
        (1e9, False),
    ],
)
def test_a_time_that_is_far_off_is_dropped_but_known_to_be_real(ahead_s: float, taken: bool) -> None:
    here, there = Clock(), Clock()
    there.now_s += ahead_s
    signer, verifier = Signer("drone.red", KEY, there), Verifier({"drone.red": KEY}, here)
    payload = signer.seal("t", b"x")
    if taken:
        assert verifier.open("t", payload, "drone.red").early_s == pytest.approx(ahead_s, abs=0.001)
    else:
        with pytest.raises(Dropped) as drop:
            verifier.open("t", payload, "drone.red")
        assert (drop.value.reason, drop.value.signer) == ("clock", "drone.red")


def test_memory_is_bounded_and_forgetting_lets_no_replay_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(signatures, "LIVES_MAX", 8)
    clock = Clock()
    verifier = Verifier({"drone.red": KEY}, clock)
    old = Signer("drone.red", KEY, clock).seal("t", b"old")
    verifier.open("t", old, "drone.red")
    for _ in range(7):
        verifier.open("t", Signer("drone.red", KEY, clock).seal("t", b"x"), "drone.red")
    assert reason(verifier, "t", Signer("drone.red", KEY, clock).seal("t", b"x")) == "too many lives"
    clock.now_s += WINDOW_S + 1.0
    verifier.open("t", Signer("drone.red", KEY, clock).seal("t", b"x"), "drone.red")
    assert len(verifier._last) == 1
    assert reason(verifier, "t", old) == "clock"
