"""`m3r replay`: whether a flight record decides the same again, and what other limits would have decided."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from typing import TYPE_CHECKING

from m3r_app.exit_status import ExitStatus

if TYPE_CHECKING:
    from pathlib import Path

    from m3r_app.replay import Fate, Replay


def run(options: argparse.Namespace) -> int:
    """Replay each file. Raises RecordError or SettingsError, one sentence."""
    if options.config:
        return _under_other_limits(options.file, options.config, as_json=options.json)
    from m3r_app.replay import replay
    from m3r_app.step_record import source_sha256

    source, status = source_sha256(), ExitStatus.ENDED
    for path in options.file:
        found = replay(path, source)
        print(json.dumps(_plain(found)) if options.json else told(found))
        if found.difference is not None or found.missing:
            status = ExitStatus.VIOLATED
    return status


def told(found: Replay) -> str:
    """One sentence for a person."""
    code = {True: "", False: ", by other code than this", None: ", by code that is not named"}[found.same_source]
    head = f"{found.path}: {found.steps} steps in {found.length_s:.1f} s{code}"
    if found.difference is not None:
        one = found.difference
        return f"{head}: it differs at step {one.number} ({one.event}, {one.t_s:.3f} s): {one.what}"
    if found.missing:
        return f"{head}: the same bit for bit up to there, then {found.missing} steps are missing"
    cut = "" if found.whole else "; the record breaks off there, as that of an app that was killed does"
    return f"{head}: every effect and every state is the same, bit for bit{cut}"


def _plain(found: Replay) -> dict[str, object]:
    return {**asdict(found), "path": str(found.path)}


def _under_other_limits(paths: list[Path], config: list[Path], *, as_json: bool) -> int:
    from config.settings import load_settings
    from m3r_app.replay import fates

    limits = load_settings(config).limits()
    for path in paths:
        was, would_be = fates(path), {fate.request: fate for fate in fates(path, limits)}
        pairs = [(one, would_be.get(one.request)) for one in was]
        if as_json:
            rows = [{"was": asdict(a), "would_be": asdict(b) if b else None} for a, b in pairs]
            print(json.dumps({"path": str(path), "config": [str(one) for one in config], "requests": rows}))
        else:
            _print_table(path, pairs)
    return ExitStatus.ENDED


def _print_table(path: Path, pairs: list[tuple[Fate, Fate | None]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("request", "asked for", "was", "would have been", title=str(path))
    for was, would_be in pairs:
        table.add_row(was.request, was.command, _verdict(was), _verdict(would_be) if would_be else "no request")
    console = Console()
    console.print(table)
    console.print("Each is judged where the drone really was: what was flown is not flown anew.")


def _verdict(fate: Fate) -> str:
    granted = f" {fate.granted_m:.2f}" if fate.granted_m is not None else ""
    why = f" ({', '.join(fate.failed)})" if fate.failed else ""
    return f"{fate.verdict}{granted}{why}" or "no decision"
