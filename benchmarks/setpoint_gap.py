"""Whether listening and watching disturb the 50 Hz stream of setpoints: its gaps beside those of the app that only flies.

    python benchmarks/setpoint_gap.py

The whole app flies the demonstration's first half minute twice on the simulated fleet, in this run: with voice and hands
recognised from the recordings (the video shown at a camera's 30 pictures per second), and from the script alone. The gaps are
those between setpoints handed to MAVSDK, from the flight record.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import soundfile
from rich.console import Console
from rich.table import Table

from m3r_app.record.recorder import read_record
from modalities.models.catalogue import ModelError, find_hand_model, find_model

ROOT = Path(__file__).resolve().parent.parent
DEMO = ROOT / "config" / "demo"
LENGTH_S = 32.0
CAMERA_RATE_HZ = 30.0
BAR_MS = 40.0
LEFT_S = 1.0
"""A longer pause is no gap: the drone was let go, or not yet taken."""


def voice(out: Path) -> Path:
    """The first LENGTH_S of the operator's voice."""
    samples, rate_hz = soundfile.read(DEMO / "operator.ogg")
    soundfile.write(out, samples[: round(LENGTH_S * rate_hz)], rate_hz)
    return out


def hands(out: Path) -> Path:
    """The first LENGTH_S of the operator's hand, as often as a camera shows it."""
    video = cv2.VideoCapture(str(DEMO / "operator.mp4"))
    rate_hz = video.get(cv2.CAP_PROP_FPS)
    writer, shown = None, 0
    for count in range(round(LENGTH_S * rate_hz)):
        readable, picture = video.read()
        if not readable:
            break
        if writer is None:
            height_px, width_px = picture.shape[:2]
            writer = cv2.VideoWriter(str(out), cv2.VideoWriter.fourcc(*"mp4v"), CAMERA_RATE_HZ, (width_px, height_px))
        while shown < (count + 1) * CAMERA_RATE_HZ / rate_hz:
            writer.write(picture)
            shown += 1
    assert writer is not None
    writer.release()
    video.release()
    return out


def script(out: Path) -> Path:
    """What is asked in the first LENGTH_S."""
    lines = [line for line in (DEMO / "operator.script").read_text().splitlines() if line[:1].isdigit()]
    out.write_text("\n".join(line for line in lines if float(line.split()[0]) < LENGTH_S) + "\n")
    return out


def gaps_ms(record: Path, *inputs: str) -> np.ndarray:
    """(n,) gaps between setpoints while the app flew with these inputs, ms."""
    words = [
        sys.executable,
        "-m",
        "ui.entry",
        "run",
        "--headless",
        "--timeout",
        "120",
        "--record",
        str(record),
        *inputs,
    ]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"the run failed: {done.stderr.strip().splitlines()[-1]}")
    sent_s = np.array([t_s for topic, t_s, _ in read_record(record) if topic == "setpoint"])
    gaps_s = np.diff(sent_s)
    return np.asarray(1000.0 * gaps_s[gaps_s < LEFT_S])


def main() -> int:
    try:
        find_model(), find_hand_model()
    except ModelError as error:
        print(error, file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        inputs = ("--audio", str(voice(folder / "voice.wav")), "--video", str(hands(folder / "hands.mp4")))
        runs = {
            "flying alone": gaps_ms(folder / "alone.mcap", "--script", str(script(folder / "story.script"))),
            "with voice and hands": gaps_ms(folder / "both.mcap", *inputs),
        }
    table = Table(title=f"gaps between setpoints at 50 Hz, ms (bar: p99 under {BAR_MS:g})")
    for column in ("", "setpoints", "p50", "p99", "longest"):
        table.add_column(column, justify="right")
    for what, gaps in runs.items():
        p50, p99 = np.percentile(gaps, (50, 99))
        table.add_row(what, str(len(gaps)), f"{p50:.1f}", f"{p99:.1f}", f"{gaps.max():.1f}")
    p99 = [float(np.percentile(gaps, 99)) for gaps in runs.values()]
    table.add_row("p99 beside flying alone", "", "", f"{p99[1] / p99[0]:.2f} x", "")
    Console(width=100).print(table)
    return 0 if p99[1] < BAR_MS else 1


if __name__ == "__main__":
    sys.exit(main())
