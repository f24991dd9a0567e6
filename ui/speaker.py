"""Speaks cues: espeak-ng where it is, else a bell for the urgent ones. The newest replaces what waits.

One thread does all of it. The control loop only queues events, so a failure of the sound never reaches it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Self

from m3r_app.queue_thread import QueueThread
from ui.cues import Cue, Cues

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from m3r_app.options import RunOptions
    from m3r_app.output import Told
from modalities.voice.self_speech import SelfSpeech

PROGRAM = "espeak-ng"
WORDS = ("--stdin", "-v", "en", "-s", "165")
"""An English voice at 165 words per minute; the text comes by standard input."""
LONGEST_S = 10.0
"""No cue takes longer, so a program that still runs then hangs; while it runs, moves by voice do not count."""
SHORTEST_S = 0.2
"""... and none takes less: without a sound device espeak-ng ends at once, with status 0."""
LOOK_S = 0.05
CLOSE_S = 2.0


class Speaker:
    """Speaks what `cue_of` makes of the events of a run."""

    def __init__(
        self,
        cue_of: Callable[[Told], Cue | None],
        self_speech: SelfSpeech,
        say: Callable[[str], None],
        *,
        clock: Callable[[], float] = time.monotonic,
        ring: Callable[[], None] | None = None,
    ) -> None:
        """self_speech: told when something is spoken. say: told once, in a sentence, what keeps cues from being spoken.

        ring: instead of the terminal's bell. All but `hear` happens in the speaker's own thread.
        """
        self._cue_of = cue_of
        self._self_speech = self_speech
        self._say = say
        self._clock = clock
        self._ring = ring or bell
        self._program = shutil.which(PROGRAM)
        self._told = False
        self._speaking: tuple[Cue, subprocess.Popen[bytes], float] | None = None
        self._waiting: Cue | None = None
        self._events: QueueThread[Told] = QueueThread("m3r-speaker", self._run)

    def __enter__(self) -> Self:
        self._events.start()
        return self

    def __exit__(self, *_: object) -> None:
        """What is being spoken is cut off."""
        self._events.close(CLOSE_S)

    def hear(self, told: Told) -> None:
        """Queue one event. Never blocks."""
        self._events.put(told)

    def _run(self) -> None:
        try:
            if self._program is None:
                self._tell(f"{PROGRAM} is not here: install it")
            for event in self._events.or_after(lambda: LOOK_S if self._speaking is not None else None):
                if event is not None:
                    self._take(self._cue_of(event))
                self._look()
        except Exception as error:  # noqa: BLE001  a flight goes on without cues
            self._tell(f"unexpected {type(error).__name__}: {error} (a fault in m3r)")
        finally:
            self._cut_off()

    def _take(self, cue: Cue | None) -> None:
        """The newest replaces what waits; only an urgent one cuts off another."""
        if cue is None:
            return
        if self._speaking is not None and self._speaking[0].text == cue.text:
            self._waiting = None  # what it would tell is older
            return
        self._waiting = cue
        if cue.urgent:
            self._cut_off()

    def _look(self) -> None:
        """If the current cue has ended, speak the one that waits."""
        if self._speaking is not None:
            cue, process, since_s = self._speaking
            took_s, status = self._clock() - since_s, process.poll()
            if status is None and took_s < LONGEST_S:
                return
            self._cut_off()
            if status is None:
                self._program = None
                self._fail(cue, f"{PROGRAM} had not ended after {LONGEST_S:.0f} s: see whether sound works")
            elif status != 0:
                self._fail(cue, f"{PROGRAM} ended with status {status}: see whether sound works")
            elif took_s < SHORTEST_S:
                self._fail(cue, f"{PROGRAM} ended without having spoken: see whether there is a sound device")
        if self._waiting is not None:
            cue, self._waiting = self._waiting, None
            self._speak(cue)

    def _speak(self, cue: Cue) -> None:
        if self._program is None:
            self._fail(cue, "")
            return
        since_s = self._clock()
        self._self_speech.begins(since_s)
        try:
            process = subprocess.Popen(
                [self._program, *WORDS],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C is ours to answer
            )
        except OSError as error:
            self._self_speech.ends(self._clock())
            self._fail(cue, f"{PROGRAM} cannot be started ({error.strerror}): install it anew")
            return
        self._speaking = (cue, process, since_s)
        assert process.stdin is not None
        try:
            process.stdin.write(cue.text.encode())  # far less than a pipe holds: it never waits
            process.stdin.close()
        except OSError:
            pass  # it has ended already, and its status tells

    def _cut_off(self) -> None:
        """Nothing is spoken any more."""
        if self._speaking is None:
            return
        _, process, _ = self._speaking
        self._speaking = None
        try:
            process.kill()
            process.wait(CLOSE_S)
        except (OSError, subprocess.TimeoutExpired):
            pass  # a process that cannot be killed is the system's
        self._self_speech.ends(self._clock())

    def _fail(self, cue: Cue, why: str) -> None:
        """It could not be spoken."""
        if why:
            self._tell(why)
        if cue.urgent:
            self._ring()

    def _tell(self, why: str) -> None:
        if not self._told:
            self._told = True
            self._say(
                f"cues are not spoken, {why}, or give --quiet; until then the terminal's bell rings for urgent ones"
            )


@contextmanager
def speaking(
    options: RunOptions, self_speech: SelfSpeech, say: Callable[[str], None], emit: Callable[[Told], None]
) -> Iterator[Callable[[Told], None]]:
    """An `emit` that also speaks, where these options want cues. say: told once what keeps them from being spoken."""
    if not options.aloud:
        yield emit
        return
    with Speaker(Cues(dry_run=options.dry_run).of, self_speech, say) as speaker:

        def both(told: Told) -> None:
            emit(told)
            speaker.hear(told)

        yield both


def bell() -> None:
    """Ring the terminal that standard error, or else this process, belongs to; nothing where there is none."""
    try:
        if sys.stderr is not None and sys.stderr.isatty():
            os.write(sys.stderr.fileno(), b"\a")
            return
        terminal = os.open("/dev/tty", os.O_WRONLY | os.O_NOCTTY)
    except (OSError, ValueError):
        return
    try:
        os.write(terminal, b"\a")
    except OSError:
        pass  # it has gone
    finally:
        os.close(terminal)
