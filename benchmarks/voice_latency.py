"""From the end of the voice to the request: this project beside the paper's own configuration, same clips, same run.

    python benchmarks/voice_latency.py [FOLDER]

FOLDER holds one sub-folder of recordings per command; without it, that of the variable M3R_SPEECH, else
`../shared/data/speech` where it exists, else the project's own synthetic recordings. The paper's configuration: chunks of
4000 samples, final results only, a grammar of every legal phrase and [unk], the first matching pattern wins. Each clip is
followed by 2 s of quiet for both; processing time counts for both; the end of the voice is the same figure for both.
"""

from __future__ import annotations

import json
import math
import os
import resource
import sys
import time
from pathlib import Path

import numpy as np
import vosk
from rich.console import Console
from rich.table import Table

from modalities.models.catalogue import ModelError, find_model
from modalities.outcomes import percentile_ms
from modalities.voice.audio import SAMPLE_RATE_HZ, AudioError, Samples, chunks, quiet, read_audio
from modalities.voice.decoder import UNKNOWN_WORD, Heard, Recognizer, load_model
from modalities.voice.evaluation import PADDING_S, hear
from modalities.voice.phrases import PhraseTable
from modalities.voice.vad import VoiceActivityDetector
from safety.vocabulary import Command

PAPER_CHUNK_SAMPLES = 4000
ROOT = Path(__file__).resolve().parent.parent
STOP_BAR, OTHER_BAR = 0.25, 0.5


def paper_match(text: str, table: PhraseTable) -> Command | None:
    """The paper's three checks on a final result: substrings, first match wins."""
    for phrase in table.phrases:
        if phrase.split()[0] in ("activate", "disconnect") and phrase in text:
            return table.interpret(phrase).command  # type: ignore[union-attr]
    for word in ("stop", "continue"):
        if word in text:
            return Command(word)
    for phrase in sorted(table.phrases, key=len, reverse=True):
        if phrase in text:
            found = table.interpret(phrase)
            return found.command if found else None
    return None


def paper_request(samples: Samples, model: vosk.Model, table: PhraseTable) -> tuple[Command, float] | None:
    """The first request of the paper's configuration and when it was made, in the recording's time."""
    unknown = (
        [UNKNOWN_WORD] if model.vosk_model_find_word(UNKNOWN_WORD) >= 0 else []
    )  # VOSK ignores it where it is missing
    grammar = [*table.phrases, *unknown]
    recognizer = vosk.KaldiRecognizer(model, float(SAMPLE_RATE_HZ), json.dumps(grammar))
    done_s = 0.0
    for chunk in chunks(samples, PAPER_CHUNK_SAMPLES):
        began = time.perf_counter()
        final = recognizer.AcceptWaveform(chunk.samples.tobytes())
        text = json.loads(recognizer.Result())["text"] if final else ""
        done_s = max(done_s, chunk.captured_at_s) + time.perf_counter() - began
        command = paper_match(text, table) if text else None
        if command is not None:
            return command, done_s
    return None


def our_request(
    samples: Samples, model: vosk.Model, table: PhraseTable, threshold: float
) -> tuple[Command, float] | None:
    """The first request that counts, likewise."""
    for answer in hear(samples, Recognizer(model, table)):
        if answer.heard.command is Command.STOP or answer.heard.confidence >= threshold:
            assert isinstance(answer.heard, Heard)
            return answer.heard.command, answer.heard.captured_at_s + answer.latency_s
    return None


def voice_end_s(samples: Samples) -> float:
    """When the last voice in a clip ended."""
    ear = VoiceActivityDetector()
    ear.accept(samples, len(samples) / SAMPLE_RATE_HZ)
    return ear.last_voice_s


def measure(folder: Path) -> dict[str, dict[str, list[float]]]:
    """Latencies (s) of right requests per configuration ("ours", "paper") and kind ("stop", "other"); "n" beside."""
    model_in_use = find_model()
    model = load_model(model_in_use.folder)
    table = PhraseTable(("red", "green", "blue"))
    found: dict[str, dict[str, list[float]]] = {name: {"stop": [], "other": []} for name in ("ours", "paper")}
    clips = [(sub.name, path) for sub in sorted(folder.iterdir()) if sub.is_dir() for path in sorted(sub.iterdir())]
    counts = {"stop": 0, "other": 0}
    for name, path in clips:
        if name not in set(Command):
            continue
        expected = Command(name)
        kind = "stop" if expected is Command.STOP else "other"
        samples = np.concatenate([read_audio(path), quiet(PADDING_S)])
        end_s = voice_end_s(samples)
        if not math.isfinite(end_s):
            continue
        counts[kind] += 1
        for configuration, request in (
            ("ours", our_request(samples, model, table, 0.7)),
            ("paper", paper_request(samples, model, table)),
        ):
            if request is not None and request[0] is expected:
                found[configuration][kind].append(request[1] - end_s)
    print(f"{model_in_use.sentence}; clips: {counts['stop']} stop, {counts['other']} other, from {folder}")
    return found


def report(found: dict[str, dict[str, list[float]]]) -> bool:
    """Print the table; whether both bars hold."""
    table = Table(title="end of the voice to request, ms (right requests; negative: before the voice ended)")
    for column in ("", "n", "ours p50", "ours p95", "n", "paper p50", "paper p95", "p95 / p95", "bar"):
        table.add_column(column, justify="right")
    good = True
    for kind, bar in (("stop", STOP_BAR), ("other", OTHER_BAR)):
        ours, paper = found["ours"][kind], found["paper"][kind]
        row = [percentile_ms(part, percent) for part in (ours, paper) for percent in (50, 95)]
        ratio = row[1] / row[3] if row[1] is not None and row[3] else math.nan
        good = good and ratio <= bar
        figures = [f"{value:.0f}" if value is not None else "-" for value in row]
        table.add_row(kind, str(len(ours)), *figures[:2], str(len(paper)), *figures[2:], f"{ratio:.2f}", f"≤ {bar}")
    Console(width=120).print(table)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f"peak memory with the model loaded: {peak_mb:.0f} MB")
    return good


def default_folder() -> Path:
    named = os.environ.get("M3R_SPEECH")
    if named:
        return Path(named)
    shared = ROOT.parent / "shared" / "data" / "speech"
    return shared if shared.is_dir() else ROOT / "tests" / "recordings"


def main(arguments: list[str]) -> int:
    folder = Path(arguments[0]) if arguments else default_folder()
    if not folder.is_dir():
        print(f"{folder} is no folder: name one with a sub-folder of recordings per command", file=sys.stderr)
        return 2
    try:
        found = measure(folder)
    except (AudioError, ModelError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0 if report(found) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
