"""The gamepad: what its controls ask for, what stops, and what is never asked. On written events and on a virtual device."""

from __future__ import annotations

import math
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.settings import load_settings
from m3r_app.inputs import Inputs, Senses, open_inputs
from m3r_app.options import RunOptions
from modalities.gamepad import commands
from modalities.gamepad.device import Pads
from modalities.gamepad.reading import (
    FLOOD,
    Asked,
    AxisMoved,
    ButtonPressed,
    HatTurned,
    Pad,
    PadEvent,
    Plugged,
    Reading,
    Told,
    Unplugged,
)
from modalities.gamepad.stream import GamepadStream
from modalities.live import WAITING, Handover, LiveInputError
from safety.confidence import input_confidence
from safety.limits import Limits
from safety.vocabulary import Command, ManeuverRequest, Modality
from tests.virtual_pad import NAME, VirtualPad
from ui.check.command import PARTS
from ui.check.findings import Finding, State, Wanted

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = load_settings()
STICKS, LEFT_TRIGGER = (0, 1, 2, 3), 4
PAD = Pad("Tested", 11, 1, (0.0, 0.0, 0.0, 0.0, -1.0, 1.0))
AT_REST = Plugged(PAD, PAD.rests, ((0, 0),))
PATIENCE_S = 10.0


def reading(*before: PadEvent) -> Reading:
    """One that has been started with these events behind it."""
    one = Reading(commands(SETTINGS), SETTINGS.gamepad.dead_zone)
    for event in before or (AT_REST,):
        list(one.accept(event, 0.0))
    list(one.start())
    return one


def asked(one: Reading, *events: PadEvent, now_s: float = 100.0, every_s: float = 1.0) -> list[Command]:
    return [
        found.command
        for number, event in enumerate(events)
        for found in one.accept(event, now_s + number * every_s)
        if isinstance(found, Asked)
    ]


# ------------------------------------------------------------ what is asked


@pytest.mark.requirement("R1")
def test_the_shipped_mapping() -> None:
    presses = [ButtonPressed(number) for number in range(20)]
    assert asked(reading(), *presses) == ["go_down", "stop", "continue", "go_up", "turn_left", "turn_right"]
    for place, command in {
        (-1, 0): Command.GO_LEFT, (1, 0): Command.GO_RIGHT, (0, 1): Command.GO_FORWARD, (0, -1): Command.GO_BACK,
    }.items():  # fmt: skip
        assert asked(reading(), HatTurned(0, place)) == [command]


def test_a_mapping_of_ones_own() -> None:
    settings = load_settings([], ["gamepad.button_9=stop", "gamepad.hat_up=go_up", "gamepad.button_0=none"])
    one = Reading(commands(settings), settings.gamepad.dead_zone)
    list(one.accept(AT_REST, 0.0))
    list(one.start())
    assert asked(one, ButtonPressed(9), HatTurned(0, (0, 1)), ButtonPressed(0)) == ["stop", "go_up"]


@pytest.mark.parametrize("command", ["activate", "disconnect"])
def test_pairing_and_letting_go_are_no_single_press(command: str) -> None:
    with pytest.raises(ValueError, match="setting gamepad.button_0 is"):
        load_settings([], [f"gamepad.button_0={command}"])


def test_a_hat_asks_once_each_time_it_leaves_its_middle_and_never_between_two_directions() -> None:
    turned = [HatTurned(0, place) for place in [(1, 0), (1, 1), (0, 1), (0, 0), (1, 1), (1, 0), (0, 0), (0, 1)]]
    assert asked(reading(), *turned) == ["go_right", "go_forward"]


def test_a_hat_held_when_the_gamepad_comes_asks_for_nothing() -> None:
    one = reading(Plugged(PAD, PAD.rests, ((1, 0),)))
    assert asked(one, HatTurned(0, (0, 1)), HatTurned(0, (0, 0)), HatTurned(0, (0, 1))) == ["go_forward"]


def test_before_the_start_nothing_is_asked() -> None:
    one = Reading(commands(SETTINGS), SETTINGS.gamepad.dead_zone)
    assert asked(one, AT_REST, ButtonPressed(3), ButtonPressed(1), HatTurned(0, (1, 0))) == []
    assert list(one.start()) == []


def test_a_flood_of_buttons_is_no_operator_and_stop_is_believed_all_the_same() -> None:
    one = reading()
    found = asked(one, *[ButtonPressed(3)] * 40, ButtonPressed(1), every_s=0.01)
    assert found == ["go_up"] * FLOOD + ["stop"]
    assert asked(one, ButtonPressed(3), now_s=200.0) == ["go_up"]


# ------------------------------------------------------------ what stops


@pytest.mark.requirement("X4")
@pytest.mark.parametrize("axis", range(len(PAD.rests) + 1))
def test_any_axis_beyond_its_dead_zone_is_stop_once_until_it_rests_again(axis: int) -> None:
    rest = PAD.rest(axis)
    travel, away = 1.0 + abs(rest), 1.0 if rest <= 0.0 else -1.0

    def moved(*shares: float) -> list[AxisMoved]:
        return [AxisMoved(axis, rest + away * travel * share) for share in shares]

    one = reading()
    assert asked(one, *moved(0.1, 0.24)) == []
    assert asked(one, *moved(0.1, 0.24, 0.26, 0.9, 1.0, 0.3, 0.23, 0.26)) == ["stop"]
    assert asked(one, *moved(0.1, 0.9, 0.0)) == ["stop"]


@pytest.mark.requirement("X4")
def test_an_axis_that_is_no_number_is_stop() -> None:
    assert asked(reading(), AxisMoved(0, math.nan)) == ["stop"]


@pytest.mark.requirement("X4")
@pytest.mark.parametrize("values", [(0.6, 0, 0, 0, -1, 1), (0, 0, 0, 0, 0.0, 1), (-1, 0, 0, 0, -1, 1)])
@pytest.mark.parametrize("began", [False, True])
def test_what_is_off_its_rest_at_the_start_stops_and_must_come_to_rest(values: tuple[float, ...], began: bool) -> None:
    one = Reading(commands(SETTINGS), SETTINGS.gamepad.dead_zone)
    found: list[Asked | Told] = list(one.start()) if began else []
    found += one.accept(Plugged(PAD, values, ((0, 0),)), 0.0)
    found += [] if began else list(one.start())
    axis = next(axis for axis, value in enumerate(values) if value != PAD.rests[axis])
    assert isinstance(found[0], Asked) and found[0].command is Command.STOP
    assert any(isinstance(one, Told) and f" {axis} is not at rest" in one.sentence for one in found)
    assert asked(one, ButtonPressed(3), HatTurned(0, (1, 0)), HatTurned(0, (0, 0)), ButtonPressed(1)) == ["stop"]
    assert asked(one, AxisMoved(axis, PAD.rests[axis]), ButtonPressed(3)) == ["go_up"]


def test_what_is_refused_is_said_once_and_its_end_too() -> None:
    one = reading()
    list(one.accept(AxisMoved(0, 0.9), 0.0))
    list(one.accept(AxisMoved(LEFT_TRIGGER, 0.0), 0.0))
    said = [*one.accept(ButtonPressed(3), 1.0), *one.accept(ButtonPressed(3), 2.0)]
    assert said == [Told("the gamepad asks for nothing while axis 0, trigger 4 is not at rest: let go of it")]
    assert list(one.accept(AxisMoved(0, 0.0), 3.0)) == []
    assert list(one.accept(AxisMoved(LEFT_TRIGGER, -1.0), 3.0)) == [
        Told("the gamepad is at rest: its buttons ask again")
    ]


@pytest.mark.requirement("X4")
def test_unplugged_is_stop_then_a_sentence_and_it_goes_on_when_it_is_back() -> None:
    one = reading()
    list(one.accept(AxisMoved(0, 0.9), 0.0))
    found = list(one.accept(Unplugged(), 1.0))
    assert found == [
        Asked(Command.STOP, "gamepad unplugged"),
        Told("the gamepad Tested is gone and STOP was asked for: plug it in again, or ask in another way"),
    ]
    assert list(one.accept(AT_REST, 2.0)) == [Told("the gamepad Tested is back")]
    assert asked(one, ButtonPressed(3), AxisMoved(0, 0.9)) == ["go_up", "stop"]


EVENTS = st.one_of(
    st.builds(ButtonPressed, st.integers(0, 20)),
    st.builds(HatTurned, st.integers(0, 1), st.tuples(st.integers(-1, 1), st.integers(-1, 1))),
    st.builds(AxisMoved, st.integers(0, 7), st.floats(-1.0, 1.0) | st.just(math.nan)),
    st.just(Unplugged()),
    st.builds(Plugged, st.just(PAD), st.tuples(*[st.floats(-1.0, 1.0)] * 6), st.just(((0, 0),))),
)


@pytest.mark.requirement("X4")
@given(st.lists(EVENTS, max_size=40))
def test_whatever_happens_no_axis_moves_anything_and_nothing_moves_while_one_is_off(events: Sequence[PadEvent]) -> None:
    one = reading()
    values, pad = list(PAD.rests), True
    for number, event in enumerate(events):
        if isinstance(event, AxisMoved) and event.axis < len(values):
            values[event.axis] = event.value
        if isinstance(event, Plugged):
            values, pad = list(event.axes), True
        pad = pad and not isinstance(event, Unplugged)
        found = [f.command for f in one.accept(event, float(number)) if isinstance(f, Asked)]
        moves = [command for command in found if command is not Command.STOP]
        assert not moves or isinstance(event, ButtonPressed | HatTurned)
        off = pad and any(PAD.is_off(axis, value, one.dead_zone) for axis, value in enumerate(values))
        assert not (moves and off)


# ------------------------------------------------------------ the stream


class Written:
    """A source that gives written events."""

    names = ("Tested",)

    def __init__(self) -> None:
        self.events: queue.SimpleQueue[PadEvent | Exception] = queue.SimpleQueue()
        self.closed = False

    def look(self) -> list[PadEvent]:
        found: list[PadEvent] = []
        while not self.events.empty():
            event = self.events.get()
            if isinstance(event, Exception):
                raise event
            found.append(event)
        return found

    def close(self) -> None:
        self.closed = True


def until(condition: Callable[[], object]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s
        threading.Event().wait(0.005)


@pytest.mark.requirement("X4")
def test_what_breaks_the_reading_is_stop_and_said() -> None:
    source, said, taken = Written(), [], []
    source.events.put(AT_REST)
    one = Reading(commands(SETTINGS), SETTINGS.gamepad.dead_zone)
    stream = GamepadStream(lambda: source, one, "", clock=time.monotonic, say=said.append)
    stream.start(taken.append)
    until(lambda: one._started)
    source.events.put(ButtonPressed(3))
    until(lambda: taken)
    source.events.put(OSError("it broke"))
    until(lambda: source.closed)
    assert [(r.id, r.command) for r in taken] == [("gamepad-1", Command.GO_UP), ("gamepad-2", Command.STOP)]
    assert said == ["gamepad is off (it broke) and STOP was asked for: use another way to say stop"]
    assert all(r.modality is Modality.PANEL and input_confidence(r, Limits()).passed for r in taken)


def test_a_source_that_cannot_be_opened_is_one_sentence_and_no_thread() -> None:
    def broken() -> Written:
        raise LiveInputError("gamepads cannot be read", "run without --gamepad")

    with pytest.raises(LiveInputError, match="^gamepads cannot be read: run without --gamepad$"):
        GamepadStream(broken, reading(), "", clock=time.monotonic, say=print)


# ------------------------------------------------------------ into the event loop


def request(number: int, command: Command = Command.GO_UP) -> ManeuverRequest:
    return ManeuverRequest(str(number), command, Modality.PANEL, 1.0, 0.0, 0.0)


@pytest.mark.requirement("X4")
def test_few_requests_wait_and_stop_is_first_and_never_dropped() -> None:
    woken: list[Callable[[], None]] = []
    taken: list[ManeuverRequest] = []
    handover = Handover(woken.append, taken.append)
    for number in range(WAITING + 5):
        handover.put(request(number))
    handover.put(request(99, Command.STOP))
    assert len(woken) == 1
    assert taken == []
    woken[0]()
    assert [r.id for r in taken] == ["99", *(str(number) for number in range(WAITING))]
    assert handover.dropped == 5
    handover.put(request(100))
    assert len(woken) == 2


def test_a_loop_that_has_closed_is_no_error() -> None:
    def closed(_work: Callable[[], None]) -> None:
        raise RuntimeError("Event loop is closed")

    Handover(closed, print).put(request(1))


async def test_a_live_modality_never_ends_what_is_played_and_is_closed() -> None:
    class Fake:
        sentences = ("here",)
        closed = False

        def start(self, take: Callable[[ManeuverRequest], None]) -> None:
            threading.Thread(target=take, args=(request(7),)).start()

        def close(self) -> None:
            self.closed = True

    import asyncio

    fake, taken = Fake(), asyncio.Event()
    inputs = Inputs(live=(fake,))
    playing = asyncio.create_task(inputs.play(time.monotonic, lambda _request: taken.set(), Senses()))
    await asyncio.wait_for(taken.wait(), PATIENCE_S)
    assert not playing.done()
    playing.cancel()
    inputs.close()
    assert fake.closed


# ------------------------------------------------------------ the device


@pytest.fixture
def pad() -> Iterator[VirtualPad]:
    """Not plugged in yet."""
    pad = VirtualPad()
    yield pad
    pad.unplug()


def seen(pads: Pads, event: type[PadEvent]) -> PadEvent:
    """The next event, which is one of these and comes alone."""
    found: list[PadEvent] = []
    until(lambda: found.extend(pads.look()) or found)
    (one,) = found
    assert isinstance(one, event)
    return one


@pytest.fixture
def pads() -> Iterator[Pads]:
    pads = Pads("", time.monotonic)
    yield pads
    pads.close()


def test_the_device_tells_what_it_has_and_does(pads: Pads, pad: VirtualPad) -> None:
    pad.plug()
    came = seen(pads, Plugged)
    assert came == Plugged(Pad(NAME, 17, 1, (0.0, 0.0, 0.0, 0.0, -1.0, -1.0)), (0, 0, 0, 0, -1, -1), ((0, 0),))
    pad.button(3, True)
    assert seen(pads, ButtonPressed) == ButtonPressed(3)
    pad.hat(0, -1)
    assert seen(pads, HatTurned) == HatTurned(0, (0, -1))
    pad.axis(2, 0.5)
    assert seen(pads, AxisMoved) == AxisMoved(2, pytest.approx(0.5, abs=1e-3))
    pad.unplug()
    assert isinstance(seen(pads, Unplugged), Unplugged)
    pad.plug()
    assert isinstance(seen(pads, Plugged), Plugged)


def test_what_is_held_when_it_comes_is_not_pressed_now(pads: Pads, pad: VirtualPad) -> None:
    pad.plug()
    pad.button(3, True)
    pad.hat(1, 0)
    pad.axis(0, -0.8)
    came = seen(pads, Plugged)
    assert isinstance(came, Plugged)
    assert (came.hats, came.axes[0]) == (((1, 0),), pytest.approx(-0.8, abs=1e-3))
    pad.button(3, False)
    pad.button(1, True)
    assert seen(pads, ButtonPressed) == ButtonPressed(1)


def test_triggers_of_a_device_that_is_no_known_gamepad_are_not_guessed(pads: Pads) -> None:
    wheel = VirtualPad(kind=2)
    wheel.plug()
    came = seen(pads, Plugged)
    assert isinstance(came, Plugged)
    assert (came.pad.known, set(came.pad.rests)) == (False, {0.0})
    wheel.unplug()


def test_another_gamepad_than_the_named_one_is_left_alone(pad: VirtualPad) -> None:
    pads = Pads("somebody's", time.monotonic)
    pad.plug()
    pad.button(3, True)
    for _ in range(40):
        assert pads.look() == []
        threading.Event().wait(0.01)
    assert pads.names == (NAME,)
    pads.close()


def test_opened_read_and_let_go_as_a_run_does(pad: VirtualPad) -> None:
    inputs = open_inputs(RunOptions(live={"gamepad": ""}), ("red",), SETTINGS, time.monotonic, print)
    (stream,) = inputs.live
    assert inputs.sentences == ("no gamepad is here: plug it in, and it is taken",)
    taken: list[ManeuverRequest] = []
    stream.start(taken.append)
    pad.plug()
    until(lambda: stream.sentences[0].startswith(f"gamepad {NAME}: "))
    pad.press(1)
    until(lambda: taken)
    assert [(r.command, r.evidence) for r in taken] == [(Command.STOP, "gamepad button 1")]
    pad.unplug()
    inputs.close()
    assert [t.name for t in threading.enumerate() if t.name == "gamepad"] == []


def test_without_its_library_it_is_off_and_the_rest_flies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    inputs = open_inputs(RunOptions(live={"gamepad": ""}), ("red",), SETTINGS, time.monotonic, print)
    assert inputs.live == ()
    (sentence,) = inputs.sentences
    assert sentence.startswith("gamepad is off: the Python package pygame-ce is missing")
    assert sentence.endswith(": install m3r again with its dependencies")


def test_the_library_is_neither_heard_nor_loaded_before_it_is_needed() -> None:
    code = (
        "import sys, signal, time, modalities.rooms\n"
        "before = signal.getsignal(signal.SIGINT)\n"
        "assert 'pygame' not in sys.modules\n"
        "from modalities.gamepad.device import Pads\n"
        "Pads('', time.monotonic).close()\n"
        "assert signal.getsignal(signal.SIGINT) is before\n"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert (ran.stdout, ran.stderr) == ("", "")


# ------------------------------------------------------------ m3r check


def look(wanted: Wanted) -> list[Finding]:
    (one,) = (look for name, look in PARTS if name == "live modalities")
    return [finding for finding in one(wanted) if finding.part.startswith("gamepad")]


def test_check_tells_of_none() -> None:
    assert look(Wanted()) == [Finding("gamepad", State.MISSING, "no gamepad is here", "plug one in, or do without")]


def test_check_tells_name_buttons_axes_and_mapping(pad: VirtualPad) -> None:
    pad.plug()
    settings = load_settings([], ["gamepad.button_9=stop"])
    (found,) = look(Wanted(settings=settings))
    assert found == Finding(
        "gamepad",
        State.WORKS,
        f"{NAME}: 17 buttons, 1 hat, 6 axes (4, 5 triggers); hat left go_left, hat right go_right, hat up go_forward, "
        "hat down go_back, button 0 go_down, button 1 stop, button 2 continue, button 3 go_up, button 4 turn_left, "
        "button 5 turn_right, button 9 stop; any axis beyond 0.25 of its travel is stop",
    )


def test_check_tells_of_a_stick_that_does_not_rest_and_of_other_gamepads(pad: VirtualPad) -> None:
    pad.plug()
    pad.axis(1, 0.7)
    (found,) = look(Wanted())
    assert (found.state, found.text.rpartition("; ")[2]) == (State.WEAK, "axis 1 is not at rest")
    (found,) = look(Wanted(live={"gamepad": "somebody's"}))
    assert found.text == f"no gamepad named somebody's is here (there is {NAME})"
