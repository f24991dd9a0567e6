"""The options of every command, and what is said of those that are not understood. What they start is `cli`'s."""

from __future__ import annotations

import argparse
import difflib
import re
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from m3r_app.exit_status import ExitStatus
from m3r_app.options import (
    OptionError,
    parse_audio,
    parse_colour,
    parse_file,
    parse_place,
    parse_port,
    parse_takeoff,
    parse_timeout,
    parse_video,
)
from modalities.rooms import LIVE

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    Run = Callable[[argparse.Namespace], int]


class Parser(argparse.ArgumentParser):
    """Errors in one sentence with a did-you-mean; no abbreviated options."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        choice = re.search(r"invalid choice: '?([^' ]*)'? \(choose from (.*)\)", message)
        if choice:
            known = re.findall(r"[\w-]+", choice[2])
            message = f"there is no {self.prog} {choice[1]}{_guess(choice[1], known)}"
        self.exit(ExitStatus.BAD_INPUT, f"m3r: {' '.join(message.split())}\n")


def _guess(word: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean {close[0]}?" if close else f": choose from {', '.join(known)}"


def parse(arguments: list[str], runs: Mapping[str, Run]) -> argparse.Namespace:
    """The options, and in `run` what they start. runs: by command; the empty one for none.

    Bad options end the program with status 2 and one sentence.
    """
    parser = _parser(runs)
    options, unknown = parser.parse_known_args(_joined(arguments))
    if unknown:
        chosen: Parser = options.parser
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


def _parser(runs: Mapping[str, Run]) -> Parser:
    parser = Parser(
        prog="m3r", description="Ask a drone for small moves by voice, hands or script; only the safe part is flown."
    )
    parser.add_argument("--version", action="version", version=f"m3r {version('m3r')}")
    parser.set_defaults(parser=parser, run=runs[""])
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
    _add_verify(commands)
    _add_replay(commands)
    _add(commands, "modes", "print the mode machine as a Mermaid diagram")
    _add_requirements(commands)
    for name, command in commands.choices.items():
        command.set_defaults(run=runs[name])
    return parser


def _add(commands: Any, name: str, about: str) -> Parser:
    parser: Parser = commands.add_parser(name, help=about, description=f"{about[0].upper()}{about[1:]}.")
    parser.set_defaults(parser=parser)
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
    run = _add(commands, "run", "pair with a drone and fly what is asked for, as far as it is safe")
    style = run.add_mutually_exclusive_group()
    style.add_argument("--headless", action="store_true", help="print one JSON object per line instead of sentences")
    style.add_argument("--plain", action="store_true", help="every event is one sentence, for screen readers and logs")
    _add_flight(run)


def _add_console(commands: Any) -> None:
    console = _add(commands, "console", "ask by keys, voice and hands, and see it all (m3r alone does this)")
    _add_flight(console)
    console.add_argument("--seat", type=_typed(parse_file), help=argparse.SUPPRESS)  # of `m3r serve`


def _add_serve(commands: Any) -> None:
    served = _add(commands, "serve", "show the console in a browser on this computer, to one operator at a time")
    served.add_argument(
        "--port", type=_typed(parse_port), default=8000, metavar="PORT", help="TCP port on loopback (8000)"
    )
    _add_flight(served)


def _add_flight(run: Parser) -> None:
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
    for modality in LIVE:
        run.add_argument(f"--{modality.name}", nargs="?", const="", metavar=modality.metavar, help=modality.about)
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
    run.add_argument("--record-key", type=file, metavar="PEM", help="sign the record with this Ed25519 key")
    run.add_argument("--timeout", type=_typed(parse_timeout), metavar="S", help="end after this long")


def _add_air(command: Parser, *, required: bool = False) -> None:
    command.add_argument(
        "--broker", required=required, metavar="URL", help="share the air over this MQTT broker: mqtts://HOST:8883"
    )
    command.add_argument(
        "--credentials", type=_typed(parse_file), required=required, metavar="FILE", help="who you are there"
    )


def _add_airspace(commands: Any) -> None:
    airspace = _add(commands, "airspace", "be the one authority for claims and volumes of an area")
    _add_air(airspace, required=True)
    airspace.add_argument(
        "--memory", type=_typed(parse_file), metavar="FILE", help="what it must not forget (in the user's state folder)"
    )


def _add_beacon(commands: Any) -> None:
    beacon = _add(commands, "beacon", "tell others where drones are that nobody is paired with")
    beacon.add_argument(
        "--vehicle",
        nargs="+",
        action="extend",
        required=True,
        metavar="COLOUR=MAVLINK-URL",
        help="the drones, such as red=udpin://0.0.0.0:14540",
    )
    _add_air(beacon, required=True)


def _add_settings(command: Parser) -> None:
    file = _typed(parse_file)
    command.add_argument("--config", type=file, action="append", default=[], metavar="FILE", help="settings (TOML)")
    command.add_argument(
        "--set", nargs="+", action="extend", default=[], metavar="KEY=VALUE", help="one setting: envelope.speed_m_s=0.3"
    )


def _add_sim(commands: Any) -> None:
    sim = _add(commands, "sim", "fly only the simulated fleet, for other tools")
    sim.add_argument("--scenario", type=_typed(parse_file), metavar="FILE", help="scenario file (TOML)")
    sim.add_argument("--port-base", metavar="PORT", help="UDP port of the first drone's ground station (14540)")
    _add_air(sim)
    sim.add_argument("--truth", type=_typed(parse_file), metavar="FILE", help="write the true states there, JSON lines")


def _add_check(commands: Any) -> None:
    check = _add(commands, "check", "look at what is here for flying by voice and hands")
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
    for modality in LIVE:
        check.add_argument(f"--{modality.name}", metavar=modality.metavar, help=modality.about)
    _add_settings(check)
    _add_air(check)
    check.add_argument("--mirror", action="store_true", help="do the mirror test, although this is no terminal")


def _add_models(commands: Any) -> None:
    models = _add(commands, "models", "list or fetch the models for voice and hands")
    models.add_argument("action", choices=("list", "fetch"))
    models.add_argument("kind", nargs="?", choices=("voice", "hands", "denoiser"), help="only this one")


def _add_evaluate(commands: Any) -> None:
    evaluate = _add(commands, "evaluate", "measure recognition on a folder of recordings; prints JSON")
    evaluate.add_argument("what", choices=("voice", "hands"))
    evaluate.add_argument("folder", type=Path, metavar="DIR", help="one sub-folder per expected command")
    evaluate.add_argument(
        "--snr", type=float, metavar="DB", help="voice: with the noise of a drone nearby, this far below the voice"
    )
    evaluate.add_argument(
        "--negative",
        action="append",
        default=[],
        metavar="NAME",
        help="a sub-folder in which nothing is a request, beside none, noise and conversation",
    )
    evaluate.add_argument(
        "--calibrate", action="store_true", help="every recording, and what each threshold of confidence would do"
    )
    evaluate.add_argument("--out", type=Path, metavar="FILE", help="with --calibrate: the settings, for --config")
    evaluate.add_argument("--json", action="store_true", help="JSON on a terminal too")
    _add_settings(evaluate)


def _add_report(commands: Any) -> None:
    report = _add(commands, "report", "tell a recorded flight on one page (HTML)")
    report.add_argument("record", type=_typed(parse_file), metavar="FILE", help="flight record (MCAP)")
    report.add_argument("--out", type=_typed(parse_file), metavar="PAGE", help="the page (FILE with .html)")


def _add_verify(commands: Any) -> None:
    verify = _add(commands, "verify", "judge recorded flights without the code that flew them")
    verify.add_argument("record", nargs="+", type=_typed(parse_file), metavar="FILE", help="flight record (MCAP)")
    verify.add_argument("--json", action="store_true", help="print one JSON array: every limit of every plan")
    verify.add_argument(
        "--key", type=_typed(parse_file), metavar="PEM", help="the public key that the record must be signed with"
    )
    verify.add_argument("--ulog", type=_typed(parse_file), metavar="LOG", help="PX4's log of the same flight (ULog)")


def _add_replay(commands: Any) -> None:
    parser = _add(commands, "replay", "take a recorded flight step by step again and compare every effect and state")
    parser.add_argument("file", type=_typed(parse_file), nargs="+", metavar="FILE", help="flight record (MCAP)")
    parser.add_argument(
        "--config",
        type=_typed(parse_file),
        action="append",
        default=[],
        metavar="TOML",
        help="tell instead what would have become of each request under these settings",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object a file")


def _add_requirements(commands: Any) -> None:
    parser = _add(commands, "requirements", "print the requirements for FRET, StrictDoc or people")
    parser.add_argument(
        "--format", choices=("fretish", "strictdoc", "markdown"), default="markdown", help="default: markdown"
    )
