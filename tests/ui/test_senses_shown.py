"""What the console shows of what the modalities take in."""

from __future__ import annotations

from dataclasses import replace

from m3r_app.snapshot import Taken
from tests.ui.console_stage import flying_snapshot, hillside
from ui.console import panels


def test_the_voices_distance_from_the_noise_is_shown_and_marked_where_it_is_small() -> None:
    def shown(snr_db: float | None) -> str:
        taken = Taken(level_dbfs=-20.0, snr_db=snr_db, level_at_s=1.0)
        return panels.senses(replace(flying_snapshot(hillside()), taken=taken), {}, 80).plain

    assert " 24 dB" in shown(24.2)
    assert " ~8 dB" in shown(8.0)
    assert "dB" not in shown(None)
