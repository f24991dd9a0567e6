"""Hands as a modality of the running app: a thread of its own that turns pictures into maneuver requests as time passes.

Source: R1, X4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing

from modalities.hands.dwell import DwellFilter, Held
from modalities.hands.finder import Detector
from modalities.hands.gestures import Hand, Region, read_hands
from modalities.hands.video import Clock, VideoSource
from modalities.threaded_stream import ThreadedStream
from safety.vocabulary import ManeuverRequest, Modality


class HandStream(ThreadedStream):
    """Watches a video source and hands over requests, from its own thread.

    Losing the hand, the picture or the camera is never a request. The callbacks run in this thread, so an asyncio app passes
    ones that use `call_soon_threadsafe`.
    """

    def __init__(
        self,
        source: VideoSource,
        detector: Detector,
        *,
        clock: Clock,
        on_request: Callable[[ManeuverRequest], None],
        on_seen: Callable[[str], None] = lambda _text: None,
        on_hands: Callable[[Sequence[Hand]], None] = lambda _hands: None,
        on_warning: Callable[[str], None] = lambda _sentence: None,
        on_end: Callable[[Exception | None], None] = lambda _error: None,
        hold: DwellFilter | None = None,
        mirrored: bool = False,
        region: Region = Region.ALL,
    ) -> None:
        """clock: the app's monotonic seconds, which the source stamps its pictures with. on_seen: what is seen now, whenever
        it changes. on_hands: the hands in every picture. on_warning: why nothing can be recognised, whenever
        that begins. on_end: called last, once, with the error that ended the stream, or None where the video was played or
        `stop` was called. mirrored: the camera shows the operator as a mirror would. region: where the operator's own hands are. The detector stays the caller's to close.
        """
        super().__init__("hands", on_end)
        self._source = source
        self._detector = detector
        self._clock = clock
        self._on_request = on_request
        self._on_seen = on_seen
        self._on_hands = on_hands
        self._on_warning = on_warning
        self._slow = False
        self._hold = DwellFilter() if hold is None else hold
        self._mirrored = mirrored
        self._region = region
        self._made = 0

    @property
    def dropped(self) -> int:
        """How many pictures came too late to be looked at."""
        return self._source.dropped

    def _recognise(self) -> None:
        seen = ""
        with closing(self._source.frames(self._stopping)) as frames:  # a camera is let go at once
            for frame in frames:
                hands = self._detector.detect(frame.picture, frame.captured_at_s)
                if hands is None:
                    continue
                reading = read_hands(hands, mirrored=self._mirrored, region=self._region)
                held = self._hold.accept(reading, frame.captured_at_s)
                if self._stopping.is_set():
                    return
                self._on_hands(hands)
                self._watch_rate()
                if held is not None:
                    self._hand_over(held)
                if reading.text != seen:
                    seen = reading.text
                    self._on_seen(seen)

    def _watch_rate(self) -> None:
        rate_hz, slowest_hz = self._hold.rate_hz, self._hold.slowest_hz
        slow = rate_hz is not None and rate_hz < slowest_hz
        if slow and not self._slow:
            self._on_warning(
                f"only {rate_hz:.1f} pictures a second are seen and no gesture counts below {slowest_hz:.1f}: give the camera more "
                "light, or close what keeps this computer busy"
            )
        self._slow = slow

    def _hand_over(self, held: Held) -> None:
        self._made += 1
        self._on_request(
            ManeuverRequest(
                id=f"hand-{self._made}",
                command=held.command,
                modality=Modality.GESTURE,
                confidence=held.confidence,
                captured_at_s=held.captured_at_s,
                made_at_s=self._clock(),
                evidence=f"{held.text}, held {held.held_s:g} s",
            )
        )
