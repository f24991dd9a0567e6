"""The demonstration's recordings say and show what its script says: no more, no less, and when."""

from __future__ import annotations

from pathlib import Path

import pytest

from modalities.hands.dwell import DwellFilter
from modalities.hands.evaluation import watch
from modalities.hands.landmarker import HandDetector
from modalities.hands.video import VideoFile
from modalities.models.catalogue import ModelError, find_hand_model
from modalities.script import read_script
from safety.vocabulary import Modality

pytestmark = pytest.mark.xdist_group("busy")  # it keeps a core busy: one of them at a time

DEMO = Path(__file__).parents[2] / "config" / "demo"


def test_the_hand_shows_what_the_script_says() -> None:
    try:
        model = find_hand_model()
    except ModelError as error:
        pytest.skip(f"no hand model: {error}")
    story = [r for r in read_script(DEMO / "operator.script", ("red",)) if r.modality is Modality.GESTURE]
    with HandDetector(model) as detector:
        answers, hand_seen = watch(VideoFile(DEMO / "operator.mp4").frames(), detector, DwellFilter())
    assert hand_seen
    assert [a.heard.command for a in answers] == [r.command for r in story]
    assert [a.heard.captured_at_s for a in answers] == pytest.approx([r.at_s for r in story], abs=0.4)
