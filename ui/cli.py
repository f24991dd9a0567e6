"""The command line, from `m3r` alone (the console) to `m3r modes`. Composes; decides nothing.

Exit status: 0 ended normally, 1 a fault of ours, 2 bad input, 3 no vehicle or lost, 4 a violation, 130 interrupted.
Whatever goes wrong is one sentence on standard error; `M3R_DEBUG=1` shows tracebacks.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from m3r_app.exit_status import ExitStatus
from m3r_app.options import LiveMicrophone, OptionError, RunOptions, parse_vehicles
from m3r_app.vehicle.interface import VehicleError
from modalities.rooms import LIVE
from ui.arguments import parse

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

OUR_PACKAGES = ("safety", "config", "modalities", "m3r_app", "ui")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    debug = os.environ.get("M3R_DEBUG") == "1"
    if not debug:
        _no_tracebacks()
    try:
        options = parse(list(sys.argv[1:] if arguments is None else arguments), RUNS)
        status: int = options.run(options)
        sys.stdout.flush()
    except KeyboardInterrupt:
        return ExitStatus.INTERRUPTED
    except BrokenPipeError:
        from ui.output import discard_stdout

        discard_stdout()  # whoever read our output has seen enough
        return ExitStatus.ENDED
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
        return ExitStatus.FAULT
    return ExitStatus.NO_VEHICLE if isinstance(error, VehicleError) else ExitStatus.BAD_INPUT


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


def _run_nothing(_options: argparse.Namespace) -> int:
    from ui.console.start import show

    return show(RunOptions())


def _run_console(options: argparse.Namespace) -> int:
    from ui.console.start import show

    return show(_asked(options), options.seat)


def _run_serve(options: argparse.Namespace) -> int:
    from m3r_app.run_setup import prepare
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

    from m3r_app.run import run
    from modalities.voice.self_speech import SelfSpeech
    from ui.output import Output
    from ui.speaker import speaking

    self_speech = SelfSpeech()
    with (
        Output(headless=asked.headless, plain=asked.plain) as output,
        speaking(asked, self_speech, _say, output.emit) as emit,
    ):
        return asyncio.run(run(asked, emit, self_speech))


def _asked(options: argparse.Namespace) -> RunOptions:
    return RunOptions(
        audio=options.audio,
        video=options.video,
        live=_live(options),
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
        record_key=options.record_key,
        timeout_s=options.timeout,
    )


def _live(options: argparse.Namespace) -> dict[str, str]:
    given = {modality.name: getattr(options, modality.name) for modality in LIVE}
    return {name: value for name, value in given.items() if value is not None}


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
    from config.settings import load_settings
    from ui.check.command import show
    from ui.check.findings import Wanted

    if options.audio is not None and not isinstance(options.audio, LiveMicrophone):
        raise OptionError(f"--audio {options.audio}: check listens to a microphone, give mic or mic:NAME")
    if isinstance(options.video, Path):
        raise OptionError(f"--video {options.video}: check watches a camera, give camera:N or its address")
    name = options.audio.name if options.audio is not None else None
    wanted = Wanted(
        parse_vehicles(options.vehicle),
        name,
        options.video,
        options.mirror,
        options.broker,
        options.credentials,
        _live(options),
        load_settings(options.config, options.set),
    )
    return show(wanted)


def _run_models(options: argparse.Namespace) -> int:
    from ui.models import fetch, show_models

    missing = (fetch if options.action == "fetch" else show_models)(options.kind)
    for error in missing:
        _say(str(error))
    return ExitStatus.BAD_INPUT if missing else ExitStatus.ENDED


def _run_evaluate(options: argparse.Namespace) -> int:
    from config.settings import load_settings
    from ui.evaluate import Wanted, evaluate

    wanted = Wanted(
        options.what,
        options.folder,
        tuple(options.negative),
        options.snr,
        calibrate=options.calibrate,
        out=options.out,
        as_json=options.json,
    )
    evaluate(wanted, load_settings(options.config, options.set).gesture)
    return ExitStatus.ENDED


def _run_report(options: argparse.Namespace) -> int:
    from ui.report import write_report

    page, broken = write_report(options.record, options.out)
    if broken is not None:
        _say(broken)
    print(page)
    return ExitStatus.ENDED


def _run_verify(options: argparse.Namespace) -> int:
    from ui.verify import verify

    return verify(options.record, options.ulog, options.key, as_json=options.json)


def _run_replay(options: argparse.Namespace) -> int:
    from ui.replay import run

    return run(options)


def _run_modes(_options: argparse.Namespace) -> int:
    from m3r_app.arbiter.modes import mermaid

    print(mermaid())
    return ExitStatus.ENDED


def _run_requirements(options: argparse.Namespace) -> int:
    from ui.requirements import FORMATS

    print(FORMATS[options.format]())
    return ExitStatus.ENDED


RUNS: dict[str, Callable[[argparse.Namespace], int]] = {
    "": _run_nothing,
    "console": _run_console,
    "serve": _run_serve,
    "run": _run_run,
    "sim": _run_sim,
    "airspace": _run_airspace,
    "beacon": _run_beacon,
    "check": _run_check,
    "models": _run_models,
    "evaluate": _run_evaluate,
    "report": _run_report,
    "verify": _run_verify,
    "replay": _run_replay,
    "modes": _run_modes,
    "requirements": _run_requirements,
}
"""What each command starts; the empty one is `m3r` alone."""

if __name__ == "__main__":
    sys.exit(main())
