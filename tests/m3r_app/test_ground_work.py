"""Take-off and landing from the console, as the arbiter has it: when they may begin, what ends them, whose the drone is then."""

from __future__ import annotations

import pytest

from m3r_app.arbiter.announcements import Announce
from m3r_app.arbiter.effects import CallOffGroundWork, GiveUp, Hold, Land, TakeOff
from m3r_app.arbiter.events import GroundWorkEnded, LandingAsked, TakeOffAsked
from m3r_app.output import Notice
from safety.vocabulary import Command, State
from tests.m3r_app.tabletop import Tabletop

ASKED = [TakeOffAsked("green", 5.0), LandingAsked("green")]


def notices(table: Tabletop) -> list[Notice]:
    return [e.notice for e in table.log if isinstance(e, Announce)]


@pytest.mark.requirement("X4")
@pytest.mark.parametrize("asked", ASKED)
def test_stop_without_a_session_calls_it_off(asked: TakeOffAsked | LandingAsked) -> None:
    """X4: and says nothing of nothing to hold."""
    table = Tabletop()
    effects = table.put(asked)
    assert effects == (TakeOff("green", 5.0) if isinstance(asked, TakeOffAsked) else Land("green"),)
    table.ask(Command.STOP)
    table.ask(Command.STOP)
    assert table.effects(CallOffGroundWork) == 2 * [CallOffGroundWork("green")], "each STOP commands Hold anew"
    assert Notice.NOTHING_TO_HOLD not in notices(table)
    table.put(GroundWorkEnded("green"))
    table.ask(Command.STOP)
    assert notices(table)[-1] is Notice.NOTHING_TO_HOLD


@pytest.mark.requirement("X4")
@pytest.mark.parametrize("asked", ASKED)
def test_stop_in_a_session_ends_both(asked: TakeOffAsked | LandingAsked) -> None:
    """X4: one door for everything that this app has set in motion."""
    table = Tabletop()
    table.put(asked)
    table.paired()
    table.ask(Command.STOP)
    assert isinstance(table.steps[-1][3][0], Hold)
    assert table.effects(CallOffGroundWork) == [CallOffGroundWork("green")]


@pytest.mark.requirement("P1")
@pytest.mark.parametrize(("colour", "given_up"), [("green", True), ("red", False)])
def test_the_drone_is_given_up_unless_it_has_been_paired_meanwhile(colour: str, given_up: bool) -> None:
    table = Tabletop()
    table.put(LandingAsked(colour))
    table.paired()
    table.put(GroundWorkEnded("blue"))
    assert table.state.ground_work == colour, "it is not blue's"
    table.put(GroundWorkEnded(colour))
    table.put(GroundWorkEnded(colour))
    assert table.effects(GiveUp) == ([GiveUp(colour)] if given_up else [])
    assert table.state.ground_work is None


@pytest.mark.parametrize("asked", ASKED)
def test_only_one_at_a_time_and_only_in_normal_autonomy(asked: TakeOffAsked | LandingAsked) -> None:
    table = Tabletop()
    table.put(LandingAsked("blue"))
    assert not [e for e in table.put(asked) if isinstance(e, TakeOff | Land)]
    table.put(GroundWorkEnded("blue"))
    table.paired()
    assert not [e for e in table.put(asked) if isinstance(e, TakeOff | Land)]
    table.ask(Command.DISCONNECT)
    assert table.state.state is State.IDLE
    assert [e for e in table.put(asked) if isinstance(e, TakeOff | Land)]
