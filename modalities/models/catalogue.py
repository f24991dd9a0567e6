"""Which voice model, hand model and denoiser are in use, where they came from, and under what licence.

Looked for in order: the folder named by the environment variable M3R_MODELS, then the user's cache, which
`modalities.models.fetching` fills.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import platformdirs

from modalities.models.sources import DENOISER_MODEL, HAND_MODEL, LICENCES

MODELS_VARIABLE = "M3R_MODELS"
_PARTS = ("am/final.mdl", "conf/mfcc.conf", "graph/HCLr.fst", "graph/Gr.fst")
"""What every model with runtime grammars holds; one with a fixed graph (HCLG.fst) cannot be given our phrases."""
_ENGLISH = ("en-us", "en-in", "en-gb", "english")

HAND_MODEL_NAME = f"{HAND_MODEL}.task"
DENOISER_NAME = f"{DENOISER_MODEL}.onnx"
_HAND_PARTS = ("hand_detector.tflite", "hand_landmarks_detector.tflite")


class ModelError(ValueError):
    """A model that is missing or cannot be used; one sentence that names it and says what to do."""


@dataclass(frozen=True, slots=True)
class VoiceModel:
    """A voice model on this machine. origin: how it was found, for people."""

    name: str
    folder: Path
    origin: str

    @property
    def licence(self) -> str:
        return LICENCES.get(self.name, "see its README")

    @property
    def sentence(self) -> str:
        """Which model is in use, for the operator."""
        return f"voice model {self.name} ({self.licence}) from {self.origin}, in {self.folder}"


@dataclass(frozen=True, slots=True)
class _OneFile:
    """A model in one file on this machine. origin: how it was found, for people."""

    path: Path
    origin: str
    what: ClassVar[str]
    licence: ClassVar[str]

    @property
    def name(self) -> str:
        return self.path.stem

    @property
    def sentence(self) -> str:
        """Which model is in use, for the operator."""
        return f"{self.what} {self.name} ({self.licence}) from {self.origin}, in {self.path.parent}"


class HandModel(_OneFile):
    """A hand landmark bundle."""

    what, licence = "hand model", LICENCES[HAND_MODEL]


class DenoiserModel(_OneFile):
    """A network that frees a voice of noise."""

    what, licence = "denoiser", LICENCES[DENOISER_MODEL]


def cache_folder() -> Path:
    """Where fetched models are kept."""
    return Path(platformdirs.user_cache_dir("m3r", appauthor=False)) / "models"


def missing_parts(folder: Path) -> tuple[str, ...]:
    """What a folder lacks to be a voice model with runtime grammars; none: it is one."""
    return tuple(part for part in _PARTS if not (folder / part).is_file() or (folder / part).stat().st_size == 0)


def voice_model_in(folder: Path, origin: str) -> VoiceModel:
    """The voice model that a folder is. Raises ModelError that names what it lacks."""
    if not folder.is_dir():
        raise ModelError(f"voice model folder {folder} does not exist: check its name or run `m3r models fetch`")
    missing = missing_parts(folder)
    if missing:
        reason = (
            "it has a fixed graph (HCLG.fst), which takes no grammar: use a small or lgraph model"
            if (folder / "graph/HCLG.fst").exists()
            else f"it lacks {', '.join(missing)}: give another folder or run `m3r models fetch`"
        )
        raise ModelError(f"{folder} is not a usable voice model: {reason}")
    name = folder.resolve().name
    return VoiceModel(name, folder, origin)


def list_models(environ: Mapping[str, str] | None = None) -> list[VoiceModel]:
    """Every voice model found, the one that is used first. Raises ModelError where M3R_MODELS names no model."""
    environ = os.environ if environ is None else environ
    found: list[VoiceModel] = []
    named = environ.get(MODELS_VARIABLE, "")
    if named:
        folder = Path(named).expanduser()
        if not folder.is_dir():
            raise ModelError(f"{MODELS_VARIABLE} names {folder}, which is no folder: correct it or unset it")
        found += _models_under(folder, MODELS_VARIABLE)
        if not found:
            raise ModelError(f"{MODELS_VARIABLE} names {folder}, which holds no voice model: correct it or unset it")
    return found + _models_under(cache_folder(), "the user cache")


def find_model(environ: Mapping[str, str] | None = None) -> VoiceModel:
    """The voice model in use. Raises ModelError if there is none."""
    models = list_models(environ)
    if not models:
        raise ModelError("there is no voice model on this machine: run `m3r models fetch`")
    return models[0]


def _models_under(folder: Path, origin: str) -> list[VoiceModel]:
    """The folder itself if it is a model, else the models directly in it, English ones first."""
    if not folder.is_dir():
        return []
    candidates = [folder] if not missing_parts(folder) else sorted(path for path in folder.iterdir() if path.is_dir())
    models = [voice_model_in(path, origin) for path in candidates if not missing_parts(path)]
    return sorted(models, key=lambda model: not any(word in model.name for word in _ENGLISH))


def hand_model_at(path: Path, origin: str) -> HandModel:
    """The hand model that a file is. Raises ModelError for one that is missing, truncated or something else."""
    if not path.is_file():
        raise ModelError(f"hand model {path} does not exist: run `m3r models fetch`")
    try:
        with zipfile.ZipFile(path) as bundle:  # its table stands at the end: a truncated file has none
            lacking = [part for part in _HAND_PARTS if part not in bundle.namelist()]
    except (zipfile.BadZipFile, OSError) as error:
        raise ModelError(f"{path} is truncated or no hand model: delete it and run `m3r models fetch`") from error
    if lacking:
        raise ModelError(f"{path} is no hand model, it lacks {', '.join(lacking)}: run `m3r models fetch`")
    return HandModel(path, origin)


def find_hand_model(environ: Mapping[str, str] | None = None) -> HandModel:
    """The hand model in use. Raises ModelError if there is none, or if the first one found cannot be used."""
    for folder, origin in _folders(environ):
        if (folder / HAND_MODEL_NAME).exists():
            return hand_model_at(folder / HAND_MODEL_NAME, origin)
    raise ModelError("there is no hand model on this machine: run `m3r models fetch`")


def find_denoiser(environ: Mapping[str, str] | None = None) -> DenoiserModel:
    """The denoiser in use. Raises ModelError if there is none: voice is recognised without it, but less well in noise."""
    for folder, origin in _folders(environ):
        if (folder / DENOISER_NAME).is_file():
            return DenoiserModel(folder / DENOISER_NAME, origin)
    raise ModelError("there is no denoiser on this machine, so voice is hard to hear in noise: run `m3r models fetch`")


def _folders(environ: Mapping[str, str] | None) -> list[tuple[Path, str]]:
    """Where single files are looked for, and how that is called."""
    environ = os.environ if environ is None else environ
    named = environ.get(MODELS_VARIABLE, "")
    folders = [(Path(named).expanduser(), MODELS_VARIABLE)] if named else []
    return [*folders, (cache_folder(), "the user cache")]
