"""Reserved path volumes (air leases): the capsule a plan needs, and whether two capsules meet. Source: R5, X10, X11."""

from __future__ import annotations

import math

from safety.limits import Limits
from safety.vocabulary import Ned, Plan, ReservedVolume

ROUNDING_M = 1e-6


def swept_volume(plan: Plan, holder: str, sigma_m: float, now_s: float, limits: Limits) -> ReservedVolume:
    """The capsule to reserve for a plan: everywhere the drone may be while it flies it, and half the separation about it."""
    end = plan.goal
    beyond = Ned(*(e + d * plan.stop_m for e, d in zip(end, plan.direction, strict=True)))
    radius_m = limits.tracking_m + limits.sigma_k * sigma_m + 0.5 * limits.separation_m
    return ReservedVolume(holder, plan.start, beyond, radius_m, now_s, now_s + plan.max_duration_s)


def volumes_meet(a: ReservedVolume, b: ReservedVolume) -> bool:
    """Whether two capsules overlap in space and time; touching is no overlap. What is not finite meets everything (X6)."""
    if a.until_s < b.from_s or b.until_s < a.from_s:
        return False
    return not segment_distance_m(a.start, a.end, b.start, b.end) >= a.radius_m + b.radius_m - ROUNDING_M


def segment_distance_m(p1: Ned, q1: Ned, p2: Ned, q2: Ned) -> float:
    """Least distance between two segments in space; NaN if any coordinate is.

    Closest points by clamping the solution of the two lines (C. Ericson, Real-Time Collision Detection, 5.1.9).
    """
    d1, d2, r = q1.minus(p1), q2.minus(p2), p1.minus(p2)
    a, e, f = _dot(d1, d1), _dot(d2, d2), _dot(d2, r)
    c, b = _dot(d1, r), _dot(d1, d2)
    if not all(map(math.isfinite, (a, e, f, c, b))):
        return math.nan
    s = 0.0
    if a > 0.0 and e > 0.0:
        across = a * e - b * b
        s = _clamp((b * f - c * e) / across) if across > 0.0 else 0.0
        t = (b * s + f) / e
        if not 0.0 <= t <= 1.0:
            t = _clamp(t)
            s = _clamp((b * t - c) / a)
    elif a > 0.0:
        s, t = _clamp(-c / a), 0.0
    else:
        t = _clamp(f / e) if e > 0.0 else 0.0
    return Ned(*(x + s * dx - t * dy for x, dx, dy in zip(r, d1, d2, strict=True))).norm


def _dot(a: Ned, b: Ned) -> float:
    return a.north * b.north + a.east * b.east + a.down * b.down


def _clamp(x: float) -> float:
    return min(1.0, max(0.0, x))
