"""The command line, from `m3r` alone (the console) to `m3r modes`. Composes; decides nothing.

Exit status: 0 ended normally, 1 a fault of ours, 2 bad input, 3 no vehicle or lost, 4 a violation, 130 interrupted.
Whatever goes wrong is one sentence on standard error; `M3R_DEBUG=1` shows tracebacks.
"""

from __future__ import annotations

import argparse
import difflib
import logging
import os
import re
import sys
import threading
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from m3r_app.options import (
    LiveMicrophone,
    OptionError,
    RunOptions,
    parse_audio,
    parse_colour,
    parse_file,
    parse_place,
    parse_port,
    parse_takeoff,
    parse_timeout,
    parse_vehicles,
    parse_video,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

FAULT, BAD_INPUT, NO_VEHICLE, INTERRUPTED = 1, 2, 3, 130
OUR_PACKAGES = ("safety", "config", "modalities", "m3r_app", "ui")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    debug = os.environ.get("M3R_DEBUG") == "1"
    if not debug:
        _no_tracebacks()
    try:
        options = _parse(list(sys.argv[1:] if arguments is None else arguments))
        status: int = options.run(options)
        sys.stdout.flush()
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # whoever read our output has seen enough
        return 0
    except Exception as error:
        if debug:
            raise
        _say(_told(error))
        return _status(error)
    return status


def _told(error: Exception) -> str:
    """An exception class of ours carries one sentence for a person; any other is a fault."""
    if _is_ours(error):
        return str(error)
    return f"unexpected {type(error).__name__}: {error} (a fault in m3r; M3R_DEBUG=1 shows where)"


def _status(error: Exception) -> int:
    if not _is_ours(error):
        return FAULT
    return NO_VEHICLE if type(error).__name__ == "VehicleError" else BAD_INPUT


def _is_ours(error: Exception) -> bool:
    return type(error).__module__.partition(".")[0] in OUR_PACKAGES


def _say(text: str) -> None:
    print(f"m3r: {' '.join(text.split())}", file=sys.stderr, flush=True)


def _no_tracebacks() -> None:
    """Faults in threads, callbacks and destructors are told in one line too."""

    class OneLine(logging.Formatter):
        def format(self, record: logging.LogRecord) -> str:
            error = record.exc_info[1] if record.exc_info else None
            cause = f" ({type(error).__name__}: {error})" if error else ""
            return " ".join(f"m3r: {record.getMessage()}{cause}".split())

    handler = logging.StreamHandler()
    handler.setFormatter(OneLine())
    handler.setLevel(logging.WARNING)
    logging.basicConfig(handlers=[handler], level=logging.WARNING, force=True)

    def told(fault: Any) -> None:
        if fault.exc_value is not None and not isinstance(fault.exc_value, SystemExit):
            _say(_told(fault.exc_value))

    threading.excepthook = told
    sys.unraisablehook = told


class _Parser(argparse.ArgumentParser):
    """Errors in one sentence with a did-you-mean; no abbreviated options."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        choice = re.search(r"invalid choice: '?([^' ]*)'? \(choose from (.*)\)", message)
        if choice:
            known = re.findall(r"[\w-]+", choice[2])
            message = f"there is no {self.prog} {choice[1]}{_guess(choice[1], known)}"
        self.exit(BAD_INPUT, f"m3r: {' '.join(message.split())}\n")


def _guess(word: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean {close[0]}?" if close else f": choose from {', '.join(known)}"


def _parse(arguments: list[str]) -> argparse.Namespace:
    parser = _parser()
    options, unknown = parser.parse_known_args(_joined(arguments))
    if unknown:
        chosen: _Parser = options.parser
        known = [option for action in chosen._actions for option in action.option_strings]
        word = unknown[0].partition("=")[0]
        close = difflib.get_close_matches(word, known, n=1)
        hint = f"; did you mean {close[0]}?" if close else f"; {chosen.prog} --help lists what there is"
        kind = "option" if word.startswith("-") else "argument"
        chosen.error(f"{chosen.prog} has no {kind} {word}{hint}")
    options.words = _joined(arguments)
    return options


def _joined(arguments: list[str]) -> list[str]:
    """`--operator -33.9,…` as one word: argparse would take a southern latitude for an option."""
    joined: list[str] = []
    for word in arguments:
        if joined and joined[-1] == "--operator" and re.match(r"-[\d.]", word):
            joined[-1] = f"--operator={word}"
        else:
            joined.append(word)
    return joined


def _parser() -> _Parser:
    parser = _Parser(
        prog="m3r", description="Ask a drone for small moves by voice, hands or script; only the safe part is flown."
    )
    parser.add_argument("--version", action="version", version=f"m3r {version('m3r')}")
    parser.set_defaults(parser=parser, run=_run_nothing)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    _add_console(commands)
    _add_serve(commands)
    _add_run(commands)
    _add_sim(commands)
    _add_airspace(commands)
    _add_beacon(commands)
    _add_check(commands)
    _add_models(commands)
    _add_evaluate(commands)
    _add_report(commands)
    _add(commands, "modes", "print the mode machine as a Mermaid diagram", _run_modes)
    return parser


def _add(commands: Any, name: str, about: str, run: Callable[[argparse.Namespace], int]) -> _Parser:
    parser: _Parser = commands.add_parser(name, help=about, description=f"{about[0].upper()}{about[1:]}.")
    parser.set_defaults(parser=parser, run=run)
    return parser


def _typed(parse: Callable[[str], object]) -> Callable[[str], object]:
    """`parse` as argparse takes it: its sentence is kept."""

    def convert(text: str) -> object:
        try:
            return parse(text)
        except OptionError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return convert


def _add_run(commands: Any) -> None:
    run = _add(commands, "run", "pair with a drone and fly what is asked for, as far as it is safe", _run_run)
    style = run.add_mutually_exclusive_group()
    style.add_argument("--headless", action="store_true", help="print one JSON object per line instead of sentences")
    style.add_argument("--plain", action="store_true", help="every event is one sentence, for screen readers and logs")
    _add_flight(run)


def _add_console(commands: Any) -> None:
    console = _add(
        commands, "console", "ask by keys, voice and hands, and see it all (m3r alone does this)", _run_console
    )
    _add_flight(console)
    console.add_argument("--seat", type=_typed(parse_file), help=argparse.SUPPRESS)  # of `m3r serve`


def _add_serve(commands: Any) -> None:
    served = _add(
        commands, "serve", "show the console in a browser on this computer, to one operator at a time", _run_serve
    )
    served.add_argument(
        "--port", type=_typed(parse_port), default=8000, metavar="PORT", help="TCP port on loopback (8000)"
    )
    _add_flight(served)


def _add_flight(run: _Parser) -> None:
    file = _typed(parse_file)
    run.add_argument(
        "--audio",
        type=_typed(parse_audio),
        metavar="mic|mic:NAME|FILE|none",
        help="a microphone, or a recording of the operator",
    )
    run.add_argument(
        "--video",
        type=_typed(parse_video),
        metavar="camera:N|FILE|URL|none",
        help="a camera, or a video of the operator's hands",
    )
    run.add_argument("--script", type=file, metavar="FILE|-", help="timed commands, such as: 2.0 panel go left")
    run.add_argument("--pair", type=_typed(parse_colour), metavar="COLOUR", help="pair with this drone at the start")
    run.add_argument(
        "--vehicle",
        nargs="+",
        action="extend",
        default=[],
        metavar="COLOUR=MAVLINK-URL",
        help="real drones instead of the simulated fleet, such as red=udpin://0.0.0.0:14540",
    )
    run.add_argument("--scenario", type=file, metavar="FILE", help="terrain, obstacles, fence, traffic (TOML)")
    _add_settings(run)
    run.add_argument("--operator", type=_typed(parse_place), metavar="LAT,LON,AMSL", help="where the operator stands")
    run.add_argument("--takeoff", type=_typed(parse_takeoff), metavar="METRES", help="take off to this height first")
    run.add_argument("--apply-failsafe", action="store_true", help="set the required failsafe parameters first")
    run.add_argument(
        "--dry-run",
        action="store_true",
        help="say what each request would become, and fly none (pairing still turns the drone to you)",
    )
    sound = run.add_mutually_exclusive_group()
    sound.add_argument("--quiet", dest="spoken", action="store_false", default=None, help="no spoken cues, no bell")
    sound.add_argument(
        "--speak",
        dest="spoken",
        action="store_true",
        help="spoken cues with --headless and --plain too, quiet otherwise",
    )
    run.add_argument(
        "--view",
        type=_typed(parse_port),
        nargs="?",
        const=8765,
        metavar="PORT",
        help="show the flight live in 3D to Foxglove on this computer (8765)",
    )
    _add_air(run)
    run.add_argument("--record", type=file, metavar="FILE", help="write a flight record (MCAP)")
    run.add_argument("--timeout", type=_typed(parse_timeout), metavar="S", help="end after this long")


def _add_air(command: _Parser, *, required: bool = False) -> None:
    command.add_argument(
        "--broker", required=required, metavar="URL", help="share the air over this MQTT broker: mqtts://HOST:8883"
    )
    command.add_argument(
        "--credentials", type=_typed(parse_file), required=required, metavar="FILE", help="who you are there"
    )


def _add_airspace(commands: Any) -> None:
    airspace = _add(commands, "airspace", "be the one authority for claims and volumes of an area", _run_airspace)
    _add_air(airspace, required=True)
    airspace.add_argument(
        "--memory", type=_typed(parse_file), metavar="FILE", help="what it must not forget (in the user's state folder)"
    )


def _add_beacon(commands: Any) -> None:
    beacon = _add(commands, "beacon", "tell others where drones are that nobody is paired with", _run_beacon)
    beacon.add_argument(
        "--vehicle",
        nargs="+",
        action="extend",
        required=True,
        metavar="COLOUR=MAVLINK-URL",
        help="the drones, such as red=udpin://0.0.0.0:14540",
    )
    _add_air(beacon, required=True)


def _add_settings(command: _Parser) -> None:
    file = _typed(parse_file)
    command.add_argument("--config", type=file, action="append", default=[], metavar="FILE", help="settings (TOML)")
    command.add_argument(
        "--set", nargs="+", action="extend", default=[], metavar="KEY=VALUE", help="one setting: envelope.speed_m_s=0.3"
    )


def _add_sim(commands: Any) -> None:
    sim = _add(commands, "sim", "fly only the simulated fleet, for other tools", _run_sim)
    sim.add_argument("--scenario", type=_typed(parse_file), metavar="FILE", help="scenario file (TOML)")
    sim.add_argument("--port-base", metavar="PORT", help="UDP port of the first drone's ground station (14540)")
    _add_air(sim)
    sim.add_argument("--truth", type=_typed(parse_file), metavar="FILE", help="write the true states there, JSON lines")


def _add_check(commands: Any) -> None:
    check = _add(commands, "check", "look at what is here for flying by voice and hands", _run_check)
    check.add_argument(
        "--vehicle",
        nargs="+",
        action="extend",
        default=[],
        metavar="COLOUR=MAVLINK-URL",
        help="does this drone answer?",
    )
    check.add_argument("--audio", type=_typed(parse_audio), metavar="mic:NAME", help="listen to this microphone")
    check.add_argument("--video", type=_typed(parse_video), metavar="camera:N|URL", help="watch this camera")
    _add_air(check)
    check.add_argument("--mirror", action="store_true", help="do the mirror test, although this is no terminal")


def _add_models(commands: Any) -> None:
    models = _add(commands, "models", "list or fetch the models for voice and hands", _run_models)
    models.add_argument("action", choices=("list", "fetch"))
    models.add_argument("kind", nargs="?", choices=("voice", "hands"), help="only this one")


def _add_evaluate(commands: Any) -> None:
    evaluate = _add(commands, "evaluate", "measure recognition on a folder of recordings; prints JSON", _run_evaluate)
    evaluate.add_argument("what", choices=("voice", "hands"))
    evaluate.add_argument("folder", type=Path, metavar="DIR", help="one sub-folder per expected command")
    _add_settings(evaluate)


def _add_report(commands: Any) -> None:
    report = _add(commands, "report", "tell a recorded flight on one page (HTML)", _run_report)
    report.add_argument("record", type=_typed(parse_file), metavar="FILE", help="flight record (MCAP)")
    report.add_argument("--out", type=_typed(parse_file), metavar="PAGE", help="the page (FILE with .html)")


def _run_nothing(_options: argparse.Namespace) -> int:
    from ui.console.start import show

    return show(RunOptions())


def _run_console(options: argparse.Namespace) -> int:
    from ui.console.start import show

    return show(_asked(options), options.seat)


def _run_serve(options: argparse.Namespace) -> int:
    from m3r_app.preparation import prepare
    from ui.serve import serve

    prepare(_asked(options))  # what is wrong with them is told here, not in the browser
    return serve(_without(options.words, "--port"), options.port)


def _without(words: Sequence[str], option: str) -> list[str]:
    """The words after the command's name, without an option and its value."""
    kept = list(words[1:])
    while option in kept:
        at = kept.index(option)
        del kept[at : at + 2]
    return [word for word in kept if not word.startswith(f"{option}=")]


def _run_run(options: argparse.Namespace) -> int:
    asked = replace(_asked(options), headless=options.headless, plain=options.plain)
    import asyncio

    from m3r_app.app import run
    from modalities.own_voice import OwnVoice
    from ui.output import Output
    from ui.speaker import speaking

    own_voice = OwnVoice()
    with (
        Output(headless=asked.headless, plain=asked.plain) as output,
        speaking(asked, own_voice, _say, output.emit) as emit,
    ):
        return asyncio.run(run(asked, emit, own_voice))


def _asked(options: argparse.Namespace) -> RunOptions:
    return RunOptions(
        audio=options.audio,
        video=options.video,
        script=options.script,
        pair=options.pair,
        vehicles=parse_vehicles(options.vehicle),
        scenario=options.scenario,
        config=tuple(options.config),
        overrides=tuple(options.set),
        operator=options.operator,
        takeoff_m=options.takeoff,
        apply_failsafe=options.apply_failsafe,
        dry_run=options.dry_run,
        spoken=options.spoken,
        view_port=options.view,
        broker=options.broker,
        credentials=options.credentials,
        record=options.record,
        timeout_s=options.timeout,
    )


def _run_sim(options: argparse.Namespace) -> int:
    from m3r_app.sim.__main__ import main as simulate

    given = {
        "--scenario": options.scenario,
        "--port-base": options.port_base,
        "--truth": options.truth,
        "--broker": options.broker,
        "--credentials": options.credentials,
    }
    return simulate([word for name, value in given.items() if value is not None for word in (name, str(value))])


def _run_airspace(options: argparse.Namespace) -> int:
    from ui.air import be_authority

    return be_authority(options.broker, options.credentials, options.memory, _say)


def _run_beacon(options: argparse.Namespace) -> int:
    from ui.air import be_beacon

    return be_beacon(parse_vehicles(options.vehicle), options.broker, options.credentials, _say)


def _run_check(options: argparse.Namespace) -> int:
    from ui.check import show
    from ui.findings import Wanted

    if options.audio is not None and not isinstance(options.audio, LiveMicrophone):
        raise OptionError(f"--audio {options.audio}: check listens to a microphone, give mic or mic:NAME")
    if isinstance(options.video, Path):
        raise OptionError(f"--video {options.video}: check watches a camera, give camera:N or its address")
    name = options.audio.name if options.audio is not None else None
    wanted = Wanted(
        parse_vehicles(options.vehicle), name, options.video, options.mirror, options.broker, options.credentials
    )
    return show(wanted)


def _run_models(options: argparse.Namespace) -> int:
    from ui.models import fetch, show_models

    missing = (fetch if options.action == "fetch" else show_models)(options.kind)
    for error in missing:
        _say(str(error))
    return BAD_INPUT if missing else 0


def _run_evaluate(options: argparse.Namespace) -> int:
    from config.settings import load_settings
    from ui.models import evaluate

    evaluate(options.what, options.folder, load_settings(options.config, options.set).gesture)
    return 0


def _run_report(options: argparse.Namespace) -> int:
    from ui.report import write_report

    page, broken = write_report(options.record, options.out)
    if broken is not None:
        _say(broken)
    print(page)
    return 0


def _run_modes(_options: argparse.Namespace) -> int:
    from m3r_app.modes import mermaid

    print(mermaid())
    return 0


if __name__ == "__main__":
    sys.exit(main())
