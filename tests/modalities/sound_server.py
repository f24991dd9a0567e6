"""A sound server of the test's own, whose null sink is the microphone that PortAudio opens. Nothing of the machine is touched.

PulseAudio runs in a temporary home behind its own socket; ALSA, through which PortAudio reaches it, is told of it by a
configuration of its own. What is played into the sink is what the microphone `m3r-test-mic` hears.
"""

from __future__ import annotations

import ctypes.util
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import soundfile

from modalities.voice.audio import SAMPLE_RATE_HZ, Samples

MICROPHONE = "m3r-test-mic"
SINK = "m3r_sink"
PACKAGES = "pulseaudio pulseaudio-utils libasound2-plugins libportaudio2"
PLUGINS = ("/usr/lib/*/alsa-lib/libasound_module_pcm_pulse.so", "/usr/lib*/alsa-lib/libasound_module_pcm_pulse.so")
DEADLINE_S = 15.0


def missing() -> str:
    """What the virtual microphone needs and this machine lacks; empty: nothing."""
    lacking = [program for program in ("pulseaudio", "pactl", "paplay") if shutil.which(program) is None]
    if ctypes.util.find_library("portaudio") is None:
        lacking.append("libportaudio2")
    if not any(list(Path("/").glob(pattern.lstrip("/"))) for pattern in PLUGINS):
        lacking.append("libasound2-plugins")
    return ", ".join(lacking)


class SoundServer:
    """PulseAudio with one null sink. `environment` is what a process needs to see it."""

    def __init__(self, home: Path, *, rate_hz: int = SAMPLE_RATE_HZ, channels: int = 1) -> None:
        self._home = home
        self._socket = home / "native"
        self._sink = [
            "module-null-sink", f"sink_name={SINK}", f"rate={rate_hz}", f"channels={channels}", "format=s16le"
        ]  # fmt: skip
        asound = home / "asound.conf"
        asound.write_text(
            "</usr/share/alsa/alsa.conf>\n"
            f'pcm.{MICROPHONE} {{ type pulse server "unix:{self._socket}" device "{SINK}.monitor" '
            f'hint {{ show on description "{MICROPHONE}" }} }}\n'
            f'pcm.!default {{ type pulse server "unix:{self._socket}" device "{SINK}.monitor" }}\n'
        )
        client = home / "client.conf"
        client.write_text("autospawn = no\n")
        self.environment = {
            "PULSE_RUNTIME_PATH": str(home),
            "PULSE_STATE_PATH": str(home),
            "PULSE_COOKIE": str(home / "cookie"),
            "PULSE_SERVER": f"unix:{self._socket}",
            "PULSE_CLIENTCONFIG": str(client),
            "ALSA_CONFIG_PATH": str(asound),
        }
        self._own = {**os.environ, **self.environment, "HOME": str(home), "XDG_RUNTIME_DIR": str(home)}
        self._process: subprocess.Popen[bytes] | None = None
        self._players: list[subprocess.Popen[bytes]] = []

    def start(self) -> None:
        command = [
            "pulseaudio", "-n", "--daemonize=no", "--exit-idle-time=-1", "--use-pid-file=no", "--disable-shm=yes",
            "--high-priority=no", "--realtime=no", "--log-level=error",
            "-L", f"module-native-protocol-unix socket={self._socket} auth-anonymous=1",
            "-L", " ".join(self._sink),
        ]  # fmt: skip
        with (self._home / "server.log").open("ab") as log:
            self._process = subprocess.Popen(command, env=self._own, stderr=log)
        self._until(lambda: self._control("info").returncode == 0, "the sound server does not start")

    def kill(self) -> None:
        """As when the whole sound system dies."""
        self._end(signal.SIGKILL)

    def stop(self) -> None:
        for player in self._players:
            player.kill()
            player.wait()
        self._players.clear()
        self._end(signal.SIGTERM)

    def unplug(self) -> None:
        """The device alone goes away."""
        modules = self._control("list", "short", "modules").stdout.decode()
        (number,) = (line.split()[0] for line in modules.splitlines() if f"sink_name={SINK}" in line)
        assert self._control("unload-module", number).returncode == 0

    def plug(self) -> None:
        assert self._control("load-module", *self._sink).returncode == 0

    def play(self, samples: Samples) -> subprocess.Popen[bytes]:
        """Begin to play into the sink; returns at once. Other rates and channels are made by the sound server."""
        file = self._home / f"played-{len(self._players)}.wav"
        soundfile.write(file, samples, SAMPLE_RATE_HZ)
        player = subprocess.Popen(["paplay", f"--device={SINK}", "--latency-msec=100", str(file)], env=self._own)
        self._players.append(player)
        return player

    def _end(self, how: signal.Signals) -> None:
        if self._process is not None:
            self._process.send_signal(how)
            self._process.wait(DEADLINE_S)
            self._process = None

    def _control(self, *words: str) -> subprocess.CompletedProcess[bytes]:
        return subprocess.run(
            ["pactl", *words],
            env=self._own,
            capture_output=True,
            check=False,
            timeout=DEADLINE_S,
        )

    def _until(self, condition, sentence: str) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline, f"{sentence}: {(self._home / 'server.log').read_text()[-500:]}"
            time.sleep(0.02)
