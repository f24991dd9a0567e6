"""`m3r models` and `m3r evaluate`: what they print. Progress and sentences go to standard error."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, MofNCompleteColumn, Progress, TextColumn, TransferSpeedColumn

from modalities.models import find_model, list_models

if TYPE_CHECKING:
    from pathlib import Path


def show_models() -> None:
    """One line per voice model, the one in use first. Raises ModelError if there is none."""
    find_model()
    for model in list_models():
        print(model.sentence)


def fetch() -> None:
    """Have a voice model, fetched unless there is one already, and say which. Raises ModelError if none can be had."""
    from modalities.model_sources import fetch_model

    present = list_models()
    if present:
        print(f"{present[0].sentence} (nothing to fetch)")
        return
    console = Console(stderr=True)
    with Progress(BarColumn(), DownloadColumn(), TransferSpeedColumn(), console=console, transient=True) as progress:
        task = progress.add_task("", start=False, visible=False)

        def show(done_bytes: int, total_bytes: int | None) -> None:
            progress.start_task(task)
            progress.update(task, completed=done_bytes, total=total_bytes, visible=True)

        model = fetch_model(
            progress=show, say=lambda text: console.print(text, markup=False, highlight=False, soft_wrap=True)
        )
    print(model.sentence)


def evaluate(folder: Path) -> None:
    """Recognition on a folder of recordings, as one JSON object on standard output."""
    from modalities.evaluate import evaluate_voice

    model = find_model()
    console = Console(stderr=True)
    console.print(model.sentence, markup=False, highlight=False, soft_wrap=True)
    columns = TextColumn("recordings"), BarColumn(), MofNCompleteColumn()
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("")
        result = evaluate_voice(
            folder, model, progress=lambda done, total: progress.update(task, completed=done, total=total)
        )
    print(json.dumps(result, allow_nan=False, indent=2 if sys.stdout.isatty() else None))
