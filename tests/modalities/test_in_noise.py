"""Voice beside a drone: our own noise, the denoiser, and who decides while it is loud."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import vosk

from modalities.models.catalogue import DENOISER_NAME, ModelError, find_denoiser
from modalities.voice.audio import SAMPLE_RATE_HZ, Chunk, Gap, Samples, chunks, quiet, read_audio
from modalities.voice.decoder import Heard, Recognizer
from modalities.voice.denoiser import WINDOW_SAMPLES, Denoiser
from modalities.voice.evaluation import hear
from modalities.voice.in_noise import HOLD_S, NoisyListener, listener
from modalities.voice.phrases import PhraseTable
from modalities.voice.rotor_noise import mixed_with, rotor_noise, voice_rms
from safety.vocabulary import Command

RECORDINGS = Path(__file__).resolve().parents[1] / "recordings"
LEAD_S = 1.0


@pytest.fixture(scope="module")
def denoiser() -> Denoiser:
    """Skips by name where there is none."""
    try:
        return Denoiser(find_denoiser().path)
    except ModelError as error:
        pytest.skip(str(error))


def beside_a_drone(samples: Samples, snr_db: float) -> Samples:
    return mixed_with(samples, snr_db, 3, around=(quiet(LEAD_S), quiet(1.0)))


def test_the_noise_is_the_same_for_the_same_seed_and_of_power_one() -> None:
    noise = rotor_noise(SAMPLE_RATE_HZ, 1)
    assert np.array_equal(noise, rotor_noise(SAMPLE_RATE_HZ, 1))
    assert not np.array_equal(noise, rotor_noise(SAMPLE_RATE_HZ, 2))
    assert noise.std() == pytest.approx(1.0, abs=0.01)


def test_rotors_are_tones_and_wind_is_below_them() -> None:
    def shares(*, wind: bool) -> tuple[float, float]:
        power = np.abs(np.fft.rfft(rotor_noise(4 * SAMPLE_RATE_HZ, 5, wind=wind))) ** 2
        hz = np.fft.rfftfreq(4 * SAMPLE_RATE_HZ, 1.0 / SAMPLE_RATE_HZ)
        low = power[hz < 120.0].sum() / power.sum()
        blades = power[(hz > 120.0) & (hz < 1500.0)]
        return float(low), float(np.sort(blades)[-len(blades) // 10 :].sum() / blades.sum())

    calm, blown = shares(wind=False), shares(wind=True)
    assert calm[0] < 0.05
    assert blown[0] > 0.2
    assert calm[1] > 0.55, "most of the power stands in few lines"


@pytest.mark.parametrize("snr_db", [20.0, 5.0])
def test_a_clip_is_mixed_at_the_ratio_that_is_asked_for(snr_db: float) -> None:
    clip = read_audio(RECORDINGS / "go_left" / "go-left_0.ogg")
    mix = beside_a_drone(clip, snr_db)
    lead = mix[: round(LEAD_S * SAMPLE_RATE_HZ)].astype(float)
    assert len(mix) == len(clip) + round(2.0 * SAMPLE_RATE_HZ)
    assert 20.0 * math.log10(voice_rms(clip) / lead.std()) == pytest.approx(snr_db, abs=1.5)


def test_the_denoiser_keeps_the_voice_and_takes_the_noise(denoiser: Denoiser) -> None:
    def denoised(samples: Samples) -> Samples:
        denoiser.forget()
        return np.concatenate([denoiser.accept(chunk.samples) for chunk in chunks(samples)])

    clip = read_audio(RECORDINGS / "go_left" / "go-left_0.ogg")
    clear = denoised(clip)
    assert len(clear) == len(clip)
    early, late = clip[:-WINDOW_SAMPLES].astype(float), clear[WINDOW_SAMPLES:].astype(float)
    assert np.corrcoef(early, late)[0, 1] > 0.95, "as it was, WINDOW_SAMPLES later"
    mix = beside_a_drone(clip, 5.0)
    alone = slice(4000, 15000)
    assert denoised(mix)[alone].astype(float).std() < 0.3 * mix[alone].astype(float).std()


def test_a_file_that_is_no_denoiser_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / DENOISER_NAME).write_bytes(b"nothing")
    with pytest.raises(ModelError, match=f"{DENOISER_NAME} is not a usable denoiser"):
        Denoiser(tmp_path / DENOISER_NAME)


class Says:
    """A recogniser that hears what it is told to, at its time."""

    missing_words = ()
    partial = ""

    def __init__(self, *heard: Heard) -> None:
        self._heard = list(heard)
        self.open: Command | None = None
        self.fed = 0
        self.forgotten = 0

    def contradicts(self, other: Heard) -> bool:
        return self.open is not None and self.open is not other.command

    def accept(self, chunk: Chunk, *, self_speech: bool = False) -> list[Heard]:
        self.fed += 1
        now = [one for one in self._heard if one.made_at_s <= chunk.captured_at_s]
        self._heard = [one for one in self._heard if one not in now]
        return now

    def gap(self, gap: Gap) -> None:
        pass

    def forget(self) -> None:
        self.forgotten += 1

    def finish(self, now_s: float) -> list[Heard]:
        return []


class Passes:
    """A denoiser that does nothing."""

    def accept(self, samples: Samples) -> Samples:
        return samples

    def forget(self) -> None:
        pass


def at(command: Command, made_at_s: float, began_at_s: float) -> Heard:
    return Heard(command, None, 0.9, command.value, made_at_s - 0.1, made_at_s, began_at_s)


def level(dbfs: float, seconds: float) -> Samples:
    noise = np.random.default_rng(0).normal(0.0, 32768.0 * 10 ** (dbfs / 20), round(seconds * SAMPLE_RATE_HZ))
    return noise.astype(np.int16)


def asked(samples: Samples, plain: Says, clear: Says) -> list[Command]:
    both = NoisyListener(plain, clear, Passes())  # type: ignore[arg-type]
    return [one.command for chunk in chunks(samples) for one in both.accept(chunk)]


def test_in_a_quiet_room_only_the_plain_one_listens() -> None:
    plain, clear = Says(at(Command.GO_UP, 1.0, 0.5)), Says(at(Command.GO_LEFT, 1.0, 0.5))
    assert asked(level(-70.0, 2.0), plain, clear) == [Command.GO_UP]
    assert clear.fed == 0


def test_in_noise_the_denoised_voice_decides_and_stop_counts_from_both() -> None:
    plain = Says(at(Command.STOP, 3.0, 2.8))
    clear = Says(at(Command.GO_LEFT, 1.0, 0.5), at(Command.STOP, 3.2, 2.8), at(Command.STOP, 6.0, 5.8))
    assert asked(level(-30.0, 7.0), plain, clear) == [Command.GO_LEFT, Command.STOP, Command.STOP]


def test_what_the_plain_one_is_very_sure_of_counts_where_nobody_was_before_it() -> None:
    def sure(confidence: float, *clear: Heard) -> list[Command]:
        plain = Says(Heard(Command.GO_UP, None, confidence, "go up", 1.4, 1.5, 0.5))
        return asked(level(-30.0, 3.0), plain, Says(*clear))

    assert sure(0.95) == [Command.GO_UP]
    assert sure(0.8) == []
    assert sure(0.95, at(Command.GO_LEFT, 1.0, 0.5)) == [Command.GO_LEFT]
    assert sure(0.95, at(Command.GO_LEFT, 2.0, 0.5)) == [Command.GO_UP]
    assert sure(0.95, at(Command.STOP, 1.0, 0.8)) == [Command.STOP]


def test_two_that_hear_different_requests_at_once_ask_for_nothing() -> None:
    plain = Says()
    plain.open = Command.GO_RIGHT
    assert asked(level(-30.0, 2.0), plain, Says(at(Command.GO_LEFT, 1.0, 0.5))) == []
    plain.open = Command.GO_LEFT
    assert asked(level(-30.0, 2.0), plain, Says(at(Command.GO_LEFT, 1.0, 0.5))) == [Command.GO_LEFT]
    plain.open = Command.GO_RIGHT
    assert asked(level(-30.0, 2.0), plain, Says(at(Command.STOP, 1.0, 0.5))) == [Command.STOP]


def test_what_began_before_the_noise_is_decided_by_who_heard_it_whole() -> None:
    plain, clear = Says(at(Command.GO_UP, 3.0, 1.8)), Says()
    assert asked(np.concatenate([level(-70.0, 2.0), level(-20.0, 2.0)]), plain, clear) == [Command.GO_UP]


def test_the_denoised_one_rests_when_the_noise_is_gone() -> None:
    plain, clear = Says(), Says()
    asked(np.concatenate([level(-30.0, 1.0), level(-75.0, 14.0 + HOLD_S)]), plain, clear)
    assert clear.forgotten == 1
    assert clear.fed < plain.fed


def test_a_request_is_heard_beside_a_drone_that_hides_it_otherwise(loaded: vosk.Model, denoiser: Denoiser) -> None:
    table = PhraseTable(("red", "green", "blue"))
    mixes = [
        beside_a_drone(read_audio(RECORDINGS / name), 5.0)
        for name in ("go_left/go-left_1.ogg", "go_right/go-right_0.ogg", "stop/stop_0.ogg")
    ]
    denoiser.forget()
    heard = [{one.heard.command for one in hear(mix, listener(loaded, table, denoiser))} for mix in mixes]
    assert heard == [{Command.GO_LEFT}, {Command.GO_RIGHT}, {Command.STOP}]
    without = [{one.heard.command for one in hear(mix, Recognizer(loaded, table))} for mix in mixes]
    assert without != heard
