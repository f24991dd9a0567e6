"""Fusion of modalities: duplicates confirm each other, contradictions are refused. Pure. Source: X5, design 6."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

from safety.vocabulary import ManeuverRequest, Modality


class Relation(StrEnum):
    """What a request is to those shortly before it."""

    NEW = "new"
    CONFIRMS = "confirms"
    CONTRADICTS = "contradicts"


@dataclass(frozen=True, slots=True)
class Remembered:
    """A move, turn or continue of the last moments, and whether it was refused."""

    request: ManeuverRequest
    refused: bool = False


def relate(
    request: ManeuverRequest,
    recent: tuple[Remembered, ...],
    window_s: float,
    sure: Callable[[ManeuverRequest], bool] = lambda _request: True,
) -> tuple[Relation, Remembered | None]:
    """How `request` relates to those of other modalities within window_s by capture time.

    One that says otherwise outweighs any that agree; but what its own modality was not `sure` of contradicts nobody.
    """
    latest: dict[Modality, Remembered] = {}  # who changes their mind has said only the last of it
    for r in sorted(recent, key=lambda r: r.request.captured_at_s):
        if r.request.modality is not request.modality:
            latest[r.request.modality] = r
    near = [r for r in latest.values() if abs(request.captured_at_s - r.request.captured_at_s) <= window_s]
    agreeing = [r for r in near if r.request.command is request.command]
    others = [r for r in near if r.request.command is not request.command and sure(r.request)]
    if others and sure(request):
        return Relation.CONTRADICTS, max(others, key=lambda r: r.request.captured_at_s)
    if agreeing:
        return Relation.CONFIRMS, max(agreeing, key=lambda r: r.request.captured_at_s)
    return Relation.NEW, None


def fused(request: ManeuverRequest, first: ManeuverRequest, request_id: str, *, lifted: bool = True) -> ManeuverRequest:
    """Both as one: independent evidence for the same command leaves only the chance that both are wrong.

    lifted: False where one of them would be refused alone: then the first counts by itself. A confidence outside [0, 1] is
    none, and nor is what is made of it: NaN.
    """
    known = 0.0 <= request.confidence <= 1.0 and 0.0 <= first.confidence <= 1.0
    confidence = 1.0 - (1.0 - request.confidence) * (1.0 - first.confidence) if known else math.nan
    if not lifted:
        confidence = first.confidence
    return replace(
        request,
        id=request_id,
        modality=Modality.FUSED,
        confidence=confidence,
        evidence=f"{first.modality}: {first.evidence}; {request.modality}: {request.evidence}",
    )


def remember(
    recent: tuple[Remembered, ...], request: ManeuverRequest, since_s: float, *, refused: bool = False
) -> tuple[Remembered, ...]:
    """`recent` with this request in place of its older self, and without what was captured before since_s.

    What is too old is told by the clock, never by what the new request says of itself (X6).
    """
    kept = (r for r in recent if r.request.id != request.id and r.request.captured_at_s >= since_s)
    return (*kept, Remembered(request, refused))
