"""The voice model and the hand model that the tests use, where there are any."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import vosk

from modalities.models.catalogue import (
    HAND_MODEL_NAME,
    HandModel,
    ModelError,
    VoiceModel,
    find_hand_model,
    find_model,
    hand_model_at,
    voice_model_in,
)
from modalities.voice.decoder import load_model

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared" / "models"
SHARED_MODEL = SHARED / "vosk-model-small-en-us-zamia-0.5"


def _found() -> VoiceModel | None:
    if not os.environ.get("M3R_MODELS") and SHARED_MODEL.is_dir():
        return voice_model_in(SHARED_MODEL, "the shared folder")
    try:
        return find_model()
    except ModelError:
        return None


@pytest.fixture(scope="session")
def voice_model() -> VoiceModel:
    """Skips by name where no model is found."""
    model = _found()
    if model is None:
        pytest.skip("no voice model here: run `m3r models fetch` to test recognition")
    return model


@pytest.fixture(scope="session")
def loaded(voice_model: VoiceModel) -> vosk.Model:
    return load_model(voice_model.folder)


@pytest.fixture(scope="session")
def hand_model() -> HandModel:
    """Skips by name where no model is found."""
    if not os.environ.get("M3R_MODELS") and (SHARED / HAND_MODEL_NAME).is_file():
        return hand_model_at(SHARED / HAND_MODEL_NAME, "the shared folder")
    try:
        return find_hand_model()
    except ModelError:
        pytest.skip("no hand model here: run `m3r models fetch` to test gestures")
