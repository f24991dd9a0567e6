"""Claims and volumes: one holder, rising numbers, everything runs out. P1, X8, X10, R5."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from m3r_app.airspace import authority
from m3r_app.airspace.authority import CLAIM_S, CLAIMS_MAX, LEASES_MAX, WANTED_S, App, Authority, HeldBy, Volume
from m3r_app.airspace.service import told
from safety.vocabulary import Ned, ReservedVolume
from safety.volumes import volumes_meet

NEW = Authority()


def volume(north_m: float = 0.0, now_s: float = 0.0, lasts_s: float = 10.0) -> ReservedVolume:
    return ReservedVolume("", Ned(north_m, 0, -10), Ned(north_m + 1, 0, -10), 2.0, now_s, now_s + lasts_s)


def claimed(drone: str = "red", operator: str = "alice", inbox: str = "a", now_s: float = 0.0) -> Authority:
    a, verdict = authority.claim(NEW, drone, App(operator, inbox), None, now_s)
    assert verdict.granted and verdict.lasts_s == CLAIM_S
    return a


@pytest.mark.requirement("X3")
def test_a_claim_is_over_exactly_when_it_is_not_renewed() -> None:
    a = claimed()
    assert not authority.claim(a, "red", App("bob", "b"), None, CLAIM_S - 1e-6)[1].granted
    assert authority.claim(a, "red", App("alice", "a"), 1, CLAIM_S - 1e-6)[1].granted
    late = authority.claim(a, "red", App("alice", "a"), 1, CLAIM_S)[1]
    assert not late.granted and late.reason == "the claim was not renewed in time and has run out"
    b, verdict = authority.claim(a, "red", App("bob", "b"), None, CLAIM_S)
    assert verdict.granted and verdict.fence == 2
    assert b.claims["red"].operator == "bob"


@pytest.mark.requirement("X3")
def test_the_same_operator_in_another_app_is_somebody_else() -> None:
    assert authority.claim(claimed(), "red", App("alice", "b"), None, 1.0)[1].reason == "another app of alice holds it"


@pytest.mark.requirement("X3")
def test_who_was_refused_first_comes_first_for_a_while() -> None:
    a, _ = authority.claim(claimed(), "red", App("bob", "b"), None, 1.0)
    a, _ = authority.claim(a, "red", App("carol", "c"), None, 2.0)
    a, verdict = authority.give_up(a, "red", App("alice", "a"), 3.0)
    assert verdict.granted
    assert (
        authority.claim(a, "red", App("carol", "c"), None, 4.0)[1].reason
        == "bob has asked for it before and comes first"
    )
    assert authority.claim(a, "red", App("bob", "b"), None, 4.0)[1].granted
    assert authority.claim(a, "red", App("carol", "c"), None, 1.0 + WANTED_S)[1].granted


@pytest.mark.requirement("X3", "X10")
def test_only_the_holder_has_a_say() -> None:
    a = claimed()
    assert not authority.give_up(a, "red", App("bob", "b"), 1.0)[1].granted
    assert authority.reserve(a, "red", App("bob", "b"), 1, "x", volume(), 1.0)[1].reason == "alice holds red"
    assert authority.reserve(a, "red", App("alice", "a"), 2, "x", volume(), 1.0)[1].reason == "alice holds red"
    assert (
        authority.reserve(a, "blue", App("alice", "a"), 1, "x", volume(), 1.0)[1].reason
        == "blue is not claimed by this app"
    )
    a, verdict = authority.reserve(a, "red", App("alice", "a"), 1, "x", volume(), 1.0)
    assert verdict.granted and verdict.fence == 2 and verdict.lasts_s == 9.0
    assert not authority.free(a, "red", App("bob", "b"), "x", 1.0)[1].granted
    assert not authority.free(a, "blue", App("alice", "a"), "x", 1.0)[1].granted
    a, verdict = authority.free(a, "red", App("alice", "a"), "x", 1.0)
    assert verdict.granted and not a.volumes
    assert authority.free(a, "red", App("alice", "a"), "x", 1.0)[1].granted, "given back already"


@pytest.mark.requirement("X3", "X10")
def test_to_know_the_inbox_of_a_holder_proves_nothing() -> None:
    """Who asks is the verified signer: an insider who has learnt another's inbox may neither give up, reserve nor free."""
    a, _ = authority.reserve(claimed(), "red", App("alice", "a"), 1, "x", volume(), 0.0)
    thief = App("mallory", "a")
    assert authority.claim(a, "red", thief, 1, 1.0)[1].reason == "alice holds it"
    assert authority.give_up(a, "red", thief, 1.0) == (a, authority.no("it is not held by this app"))
    assert authority.reserve(a, "red", thief, 1, "x", volume(), 1.0)[1].reason == "alice holds red"
    assert authority.free(a, "red", thief, "x", 1.0) == (a, authority.no("it is held by another app"))


@pytest.mark.requirement("X10")
def test_a_volume_outlives_the_claim_that_ran_out_but_not_the_one_given_up() -> None:
    a, _ = authority.reserve(claimed(), "red", App("alice", "a"), 1, "x", volume(lasts_s=30.0), 0.0)
    assert authority.current(a, CLAIM_S + 1.0).volumes, "the drone may still be in it"
    assert not authority.give_up(a, "red", App("alice", "a"), 1.0)[0].volumes


@pytest.mark.requirement("X3")
def test_nobody_else_gets_in_while_the_authority_was_away() -> None:
    a = authority.resumed(claimed(), 100.0)
    assert not authority.claim(a, "red", App("bob", "b"), None, 100.0 + CLAIM_S - 1e-6)[1].granted
    assert authority.claim(a, "red", App("alice", "a"), 1, 100.0 + CLAIM_S - 1e-6)[1].granted


@pytest.mark.requirement("X8", "X10")
def test_what_was_prolonged_can_be_told() -> None:
    """A volume of a minute that was prolonged while the authority could not be heard lasts longer than a message can say."""
    a, _ = authority.reserve(claimed(), "red", App("alice", "a"), 1, "x", volume(lasts_s=60.0), 0.0)
    held = told(authority.resumed(a, 1.3), "0" * 16, 0.5)
    assert [v.volume.lasts_s for v in held.volumes] == [60.0]
    assert [c.lasts_s for c in held.claims] == [CLAIM_S]
    later = told(authority.resumed(a, 1.3), "0" * 16, 31.3)
    assert later.volumes[0].volume.lasts_s == pytest.approx(30.0)


@pytest.mark.requirement("X10")
@pytest.mark.parametrize("bad", [
    {"start": Ned(math.nan, 0, 0)}, {"radius_m": math.inf}, {"until_s": math.inf}, {"until_s": math.nan}, {"from_s": math.nan},
])  # fmt: skip
def test_what_is_no_volume_is_not_granted(bad: dict[str, object]) -> None:
    verdict = authority.reserve(claimed(), "red", App("alice", "a"), 1, "x", replace(volume(), **bad), 0.0)[1]  # type: ignore[arg-type]
    assert not verdict.granted


def test_it_is_bounded() -> None:
    many = {f"d{i}": HeldBy(App("o", "i"), i, 9.0) for i in range(CLAIMS_MAX)}
    assert "takes no more" in authority.claim(Authority(claims=many), "red", App("alice", "a"), None, 0.0)[1].reason
    held = {f"x{i}": Volume("green", App("g", "g"), volume(100.0), i) for i in range(LEASES_MAX)}
    full = replace(claimed(), volumes=held)
    assert "takes no more" in authority.reserve(full, "red", App("alice", "a"), 1, "y", volume(), 0.0)[1].reason


APPS = (("alice", "a1"), ("alice", "a2"), ("bob", "b1"), ("carol", "c1"))
DRONES = ("red", "green")


class Anybody(RuleBasedStateMachine):
    """Any order of asking, with any pauses and interruptions, by apps that believe whatever they were told."""

    def __init__(self) -> None:
        super().__init__()
        self.a = NEW
        self.now_s = 0.0
        self.fence: dict[tuple[str, str], int] = {}
        self.highest = 0

    app = st.sampled_from(APPS)
    drone = st.sampled_from(DRONES)

    def grown(self, verdict: authority.Verdict) -> None:
        assert verdict.fence > self.highest
        self.highest = verdict.fence

    @rule(by=app, drone=drone, renew=st.booleans())
    def claim(self, by: tuple[str, str], drone: str, renew: bool) -> None:
        before = authority.current(self.a, self.now_s).claims.get(drone)
        fence = self.fence.get((by[1], drone)) if renew else None
        self.a, verdict = authority.claim(self.a, drone, App(*by), fence, self.now_s)
        if verdict.granted:
            if before is None:
                self.grown(verdict)
            else:
                assert (*before.app, before.fence) == (*by, verdict.fence)
            self.fence[(by[1], drone)] = verdict.fence

    @rule(by=app, drone=drone)
    def give_up(self, by: tuple[str, str], drone: str) -> None:
        self.a, _ = authority.give_up(self.a, drone, App(*by), self.now_s)

    @rule(by=app, drone=drone, north_m=st.floats(0, 20), lasts_s=st.floats(0.1, 20), lease=st.sampled_from("xyz"))
    def reserve(self, by: tuple[str, str], drone: str, north_m: float, lasts_s: float, lease: str) -> None:
        fence = self.fence.get((by[1], drone), 0)
        holder = authority.current(self.a, self.now_s).claims.get(drone)
        wanted = volume(north_m, self.now_s, lasts_s)
        self.a, verdict = authority.reserve(self.a, drone, App(*by), fence, f"{by[1]}{lease}", wanted, self.now_s)
        if verdict.granted:
            assert holder is not None and (holder.app, holder.fence) == (App(*by), fence)
            self.grown(verdict)

    @rule(by=app, drone=drone, lease=st.sampled_from("xyz"))
    def free(self, by: tuple[str, str], drone: str, lease: str) -> None:
        self.a, _ = authority.free(self.a, drone, App(*by), f"{by[1]}{lease}", self.now_s)

    @rule(later_s=st.floats(0, 8))
    def wait(self, later_s: float) -> None:
        self.now_s += later_s

    @rule(away_s=st.floats(0, 100))
    def away(self, away_s: float) -> None:
        holders = authority.current(self.a, self.now_s).claims.keys()
        self.now_s += away_s
        self.a = authority.resumed(self.a, away_s)
        assert holders <= authority.current(self.a, self.now_s).claims.keys()

    @invariant()
    def no_two_in_one_place(self) -> None:
        live = authority.current(self.a, self.now_s).volumes.values()
        for one, other in itertools.combinations(live, 2):
            assert one.drone == other.drone or not volumes_meet(one.volume, other.volume)


TestAnybody = Anybody.TestCase
