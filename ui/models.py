"""`m3r models`: what it prints. Progress and sentences go to standard error."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TransferSpeedColumn

from modalities.models.catalogue import (
    DenoiserModel,
    HandModel,
    ModelError,
    VoiceModel,
    find_denoiser,
    find_hand_model,
    find_model,
    list_models,
)
from modalities.models.sources import ModelKind

if TYPE_CHECKING:
    from collections.abc import Callable

    Model = VoiceModel | HandModel
    Look = Callable[[], list[VoiceModel] | list[HandModel] | list[DenoiserModel]]


OPTIONAL = frozenset({ModelKind.DENOISER})
"""Without it everything works, some of it less well: told, and no error unless it was asked for by name."""


def show_models(kind: str | None = None) -> list[ModelError]:
    """One line per model, of each kind the one in use first. kind: only these. Returns what is missing."""
    missing: list[ModelError] = []
    for name, look in _looks(kind).items():
        try:
            for model in look():
                print(model.sentence)
        except ModelError as error:
            if kind is None and name in OPTIONAL:
                print(error)
            else:
                missing.append(error)
    return missing


def fetch(kind: str | None = None) -> list[ModelError]:
    """Have the models, each fetched unless there is one already, and say which. kind: only this one. Returns why one cannot
    be had.
    """
    console = Console(stderr=True)
    missing: list[ModelError] = []
    for one in ModelKind:
        if kind not in {None, one}:
            continue
        errors = _had(one, console)
        if kind is None and one in OPTIONAL:
            for error in errors:
                print(error)
        else:
            missing += errors
    return missing


def _looks(kind: str | None) -> dict[ModelKind, Look]:
    looks: dict[ModelKind, Look] = {
        ModelKind.VOICE: lambda: [find_model(), *list_models()[1:]],
        ModelKind.HANDS: lambda: [find_hand_model()],
        ModelKind.DENOISER: lambda: [find_denoiser()],
    }
    return {name: look for name, look in looks.items() if kind in {None, name}}


def _had(kind: ModelKind, console: Console) -> list[ModelError]:
    from modalities.models.fetching import have_model

    with ExitStack() as stack:
        progress = Progress(BarColumn(), DownloadColumn(), TransferSpeedColumn(), console=console, transient=True)
        task = progress.add_task("")

        def show(done_bytes: int, total_bytes: int | None) -> None:
            if not progress.live.is_started:
                stack.enter_context(progress)
            progress.update(task, completed=done_bytes, total=total_bytes)

        try:
            model, fetched = have_model(
                kind, show, lambda text: console.print(text, markup=False, highlight=False, soft_wrap=True)
            )
        except ModelError as error:
            return [error]
    print(model.sentence if fetched else f"{model.sentence} (nothing to fetch)")
    return []
