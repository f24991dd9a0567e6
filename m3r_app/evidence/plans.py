"""Every plan that was given to be flown, judged again: everywhere on its line and in the coasting beyond, with all uncertainty.

The line is looked at every centimetre, so a margin is at most half of that too large. What was broken already where a plan
starts may only mend along it. Source: R3-R8, R11, G1-G6, X1, X2, X10, X11, X13, design 2, 8-11; written from these.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from m3r_app.evidence.flight import Asked, Flight, Floats, Stretch
from m3r_app.evidence.geometry import Patch, approach_m, capsule_m, fence_m, height_m, prism_m
from m3r_app.evidence.verdict import Line
from safety.limits import Limits
from safety.vocabulary import Ned, Neighbours, Plan, Primitive, ReservedVolume, VehicleState

STEP_M = 0.01
ROUNDING = 1e-6
DIP_M = 0.06
"""What is broken already may dip by so much on its way to mend: velocities and samples are no better."""
SEEN_M = 3.0
"""The ground is looked for so far beyond what is required; a margin is cut off there."""
MOMENT_S = 0.02
TIMED_M = 0.03
"""No drone is where the time says by less than this: a separation may fall so much short."""
AROUND = np.array(
    [(0.0, 0.0, 0.0)]
    + [
        (share, math.cos(turn), math.sin(turn))
        for share in (0.5, 1.0)
        for turn in np.linspace(0.0, 2.0 * math.pi, 12, endpoint=False)
    ]
)
"""Where the drone may be about where it is said to be: how far out, as a share, and in which direction."""


@dataclass(frozen=True, eq=False)
class Moment:
    """What was known when a plan was given to be flown."""

    now_s: float
    vehicle: VehicleState
    neighbours: Neighbours | None
    reservations: tuple[ReservedVolume, ...]
    anchor: tuple[float, Ned] | None
    stretch: Stretch | None
    asked: Asked | None


@dataclass(frozen=True)
class Swept:
    """A plan's raw numbers as lines: places north, east, down, and north, east, altitude."""

    ned: Floats
    up: Floats
    stop_m: float
    end_s: float


def judge_plan(plan: Plan, subject: str, moment: Moment, flight: Flight) -> tuple[Line, ...]:
    """A line for each limit. Nothing that cannot be judged passes."""
    limits, vehicle = flight.limits, moment.vehicle
    swept = _swept(plan, flight.ground.origin_amsl_m, limits)
    if swept is None:
        return (
            Line("plan", "envelope", subject, None, "m", passed=False, note="the plan holds numbers that are none"),
        )
    level, upright = _sigma(vehicle.sigma_h_m), _sigma(vehicle.sigma_v_m)
    errors = Errors(
        limits.sigma_k * max(level, upright) + limits.tracking_m if level + upright >= 0.0 else math.nan,
        limits.sigma_k * level,
        limits.sigma_k * upright,
        limits.tracking_m,
    )
    judging = _Judging(plan, subject, moment, flight, swept, errors)
    lines: list[Line] = []
    for limit in _LIMITS:
        lines += limit(judging)
    return tuple(lines)


@dataclass(frozen=True)
class Errors:
    """How far the drone may be from where it is said to be (m): in space, the tube included; sideways and in height without."""

    space_m: float
    level_m: float
    upright_m: float
    tube_m: float


def _sigma(sigma_m: float) -> float:
    return sigma_m if 0.0 <= sigma_m < math.inf else math.nan


def duration_s(distance: float, speed: float, acceleration: float) -> float:
    """Of a rest-to-rest trapezoid, from its raw numbers."""
    if distance <= 0.0:
        return 0.0
    peak = min(speed, math.sqrt(distance * acceleration))
    return distance / peak + peak / acceleration


def covered(times_s: Floats, distance: float, speed: float, acceleration: float) -> Floats:
    """Distance along a rest-to-rest trapezoid at each time since its start."""
    if distance <= 0.0:
        return np.zeros_like(times_s)
    peak = min(speed, math.sqrt(distance * acceleration))
    ramp_s = peak / acceleration
    total_s = distance / peak + ramp_s
    at = np.clip(times_s, 0.0, total_s)
    braking = distance - 0.5 * acceleration * (total_s - at) ** 2
    steady = peak * (at - 0.5 * ramp_s)
    return np.where(at < ramp_s, 0.5 * acceleration * at * at, np.where(at <= total_s - ramp_s, steady, braking))


def _peak(plan: Plan) -> float:
    move = plan.move
    return min(move.speed, math.sqrt(move.distance * move.acceleration)) if move.distance > 0.0 else 0.0


def _stop_m(speed_m_s: float, limits: Limits) -> float:
    return speed_m_s * limits.lag_s + speed_m_s**2 / (2.0 * limits.stop_deceleration_m_s2)


def _turn_first_s(plan: Plan) -> float:
    turn = plan.turn
    return duration_s(turn.distance, turn.speed, turn.acceleration) if plan.face_first else 0.0


def _swept(plan: Plan, origin_amsl_m: float, limits: Limits) -> Swept | None:
    move, turn = plan.move, plan.turn
    profiles = (move.distance, move.speed, move.acceleration, turn.distance, turn.speed, turn.acceleration)
    numbers = (*plan.start, *plan.direction, *profiles, plan.max_duration_s)
    positive = move.distance >= 0.0 and turn.distance >= 0.0 and min(move.speed, move.acceleration) > 0.0
    if not (all(map(math.isfinite, numbers)) and positive and min(turn.speed, turn.acceleration) > 0.0):
        return None
    if move.distance > 10.0 * limits.session_m:
        return None
    stop_m = _stop_m(_peak(plan), limits)
    far_m = move.distance + stop_m
    along = np.linspace(0.0, far_m, math.ceil(far_m / STEP_M) + 1) if move.distance > 0.0 else np.zeros(1)
    ned = np.array(plan.start) + along[:, None] * np.array(plan.direction)
    up = np.column_stack((ned[:, :2], origin_amsl_m - ned[:, 2]))
    moving_s = duration_s(move.distance, move.speed, move.acceleration)
    end_s = max(_turn_first_s(plan) + moving_s, duration_s(turn.distance, turn.speed, turn.acceleration))
    return Swept(ned, up, stop_m, end_s)


class _Judging:
    """One plan under judgement."""

    def __init__(self, plan: Plan, subject: str, moment: Moment, flight: Flight, swept: Swept, errors: Errors) -> None:
        self.plan, self.subject, self.moment, self.flight = plan, subject, moment, flight
        self.limits, self.swept, self.errors = flight.limits, swept, errors
        self.patch: Patch | None = None

    def line(self, limit: str, margin: float | None, *, passed: bool, unit: str = "m", note: str = "") -> list[Line]:
        return [Line("plan", limit, self.subject, margin, unit, bool(passed), self.moment.now_s, note)]

    def number(self, limit: str, margin: float, unit: str, note: str = "") -> list[Line]:
        return self.line(limit, float(margin), passed=margin >= -ROUNDING, unit=unit, note=note)

    def along(
        self, limit: str, margins: Floats, *, mends: bool = True, note: str = "", spare_m: float = ROUNDING
    ) -> list[Line]:
        """From margins along the line."""
        if not np.isfinite(margins).all():
            return self.line(limit, None, passed=False, note=f"{note} cannot be judged".strip())
        least = float(margins.min())
        mending = mends and margins[0] < 0.0 and float((np.maximum.accumulate(margins) - margins).max()) <= DIP_M
        told = f"{note} broken already, and mended".strip() if mending and least < -spare_m else note
        return self.line(limit, least, passed=least >= -spare_m or mending, note=told)


def _terrain(j: _Judging) -> list[Line]:
    grid, limits = j.flight.ground.terrain, j.limits
    if grid is None:
        lines: list[Line] = []
        for limit in ("terrain_clearance", "agl", "terrain_confidence"):
            lines += j.line(limit, None, passed=False, note="the record holds no terrain")
        return lines
    terrain_m = limits.sigma_k * _sigma(grid.sigma_m)
    need_m = limits.clearance_m + j.errors.space_m + terrain_m
    reach_m = (need_m if math.isfinite(need_m) else 0.0) + SEEN_M
    patch = Patch(grid, j.swept.up, reach_m)
    lines = j.along("terrain_clearance", patch.surface_m(j.swept.up) - need_m)
    away_m = float(patch.unknown_m(j.swept.up).min()) - need_m
    if not away_m >= -STEP_M and lines[0].passed:
        # Where nothing is known there may be anything, and there is no way out of it.
        lines = j.line("terrain_clearance", away_m, passed=False, note="unknown ground is too near")
    # The height is to be kept above the ground anywhere below where the drone may be.
    lows = []
    for share, north, east in AROUND:
        for tube in (0.0, 1.0) if share else (0.0,):
            out_m = share * (j.errors.level_m + j.errors.tube_m * tube)
            below_m = j.errors.upright_m + j.errors.tube_m * math.sqrt(1.0 - (share * tube) ** 2)
            shifted = j.swept.up + np.array((out_m * north, out_m * east, -below_m))
            lows.append(height_m(shifted, grid) - terrain_m - limits.min_agl_m)
    lines += j.along("agl", np.min(lows, axis=0))
    confidence = 1.0 / (1.0 + (_sigma(grid.sigma_m) / limits.terrain_half_m) ** 2)
    return lines + j.number("terrain_confidence", confidence - limits.terrain_confidence_min, "")


def _obstacles(j: _Judging) -> list[Line]:
    need_m = j.limits.obstacle_clearance_m + j.errors.space_m
    lines: list[Line] = []
    for prism in j.flight.ground.prisms:
        lines += j.along("obstacle_clearance", prism_m(j.swept.up, prism) - need_m, note=prism.name)
    return lines


def _fence(j: _Judging) -> list[Line]:
    fence = j.flight.ground.fence
    if fence is None:
        return []
    level, upright = fence_m(j.swept.up, fence)
    lines = j.along("geofence", level - j.errors.level_m - j.errors.tube_m, note="sides")
    if math.isfinite(fence.floor_amsl_m) or math.isfinite(fence.ceiling_amsl_m):
        lines += j.along("geofence", upright - j.errors.upright_m - j.errors.tube_m, note="floor and ceiling")
    return lines


def _standoff(j: _Judging) -> list[Line]:
    operator = j.flight.operator
    if operator is None:
        return j.line("standoff", None, passed=False, note="the record does not tell where the operator stood")
    need_m = j.limits.standoff_m + j.errors.level_m + j.errors.tube_m + j.limits.sigma_k * _sigma(operator.sigma_m)
    away = np.hypot(j.swept.ned[:, 0] - operator.position.north, j.swept.ned[:, 1] - operator.position.east)
    return j.along("standoff", away - need_m)


def _balls(j: _Judging) -> list[Line]:
    lines: list[Line] = []
    anchor, stretch, limits = j.moment.anchor, j.moment.stretch, j.limits
    session = (stretch.from_s, stretch.centre) if stretch is not None and stretch.centre is not None else None
    for limit, place, radius_m in (("workspace", anchor, limits.workspace_m), ("session", session, limits.session_m)):
        if place is None:
            lines += j.line(limit, None, passed=False, note="the record does not tell its middle")
            continue
        since_s, centre = place
        # Relative to a place that the drone itself recorded, only the drift since then counts.
        wrong_m = min(
            j.errors.space_m - j.errors.tube_m, limits.sigma_k * limits.drift_m_s * abs(j.moment.now_s - since_s)
        )
        away = np.linalg.norm(j.swept.ned - np.array(centre), axis=1)
        lines += j.along(limit, radius_m - wrong_m - j.errors.tube_m - away + 0.0 * j.errors.space_m)
    return lines


def _envelope(j: _Judging) -> list[Line]:
    plan, limits, direction = j.plan, j.limits, np.array(j.plan.direction)
    home = plan.primitive is Primitive.RETURN
    way, peak = direction * plan.move.distance, _peak(plan)
    turning = min(plan.turn.speed, math.sqrt(plan.turn.distance * plan.turn.acceleration))
    longest_s = j.swept.end_s * limits.duration_factor + limits.duration_extra_s
    vehicle = j.moment.vehicle
    checks = (
        ("sideways step", (limits.workspace_m if home else limits.lateral_step_m) - math.hypot(way[0], way[1]), "m"),
        ("vertical step", (limits.workspace_m if home else limits.vertical_step_m) - abs(way[2]), "m"),
        ("speed", limits.speed_m_s - peak * float(np.linalg.norm(direction)), "m/s"),
        ("descent", limits.descend_speed_m_s - peak * max(float(direction[2]), 0.0), "m/s"),
        (
            "acceleration",
            limits.acceleration_m_s2 - (plan.move.acceleration if plan.move.distance > 0.0 else 0.0),
            "m/s2",
        ),
        ("turn rate", limits.yaw_rate_deg_s - turning, "deg/s"),
        ("duration", longest_s - plan.max_duration_s, "s"),
        ("coasting before it starts", limits.tracking_m - _stop_m(vehicle.velocity.norm, limits), "m"),
        ("where it starts", limits.tracking_m - vehicle.position.minus(plan.start).norm, "m"),
        ("stopping distance told", plan.stop_m - j.swept.stop_m, "m"),
    )
    lines: list[Line] = []
    for what, margin, unit in checks:
        lines += j.number("envelope", margin, unit, what)
    return lines


def _separation(j: _Judging) -> list[Line]:
    sky, limits, plan = j.moment.neighbours, j.limits, j.plan
    if sky is None:
        return j.line("separation", None, passed=False, note="the record tells of no neighbours, not even of none")
    horizon_s = max(j.swept.end_s + limits.lag_s, limits.horizon_s)
    times = np.arange(0.0, horizon_s + MOMENT_S, MOMENT_S)
    start, direction = np.array(plan.start), np.array(plan.direction)
    move, first_s = plan.move, _turn_first_s(plan)
    on_time, late = (
        covered(times - first_s - lag_s, move.distance, move.speed, move.acceleration) for lag_s in (0.0, limits.lag_s)
    )
    ahead = np.minimum(on_time + j.swept.stop_m, move.distance + j.swept.stop_m)
    lines: list[Line] = []
    for i, name in enumerate(sky.names):
        age_s = j.moment.now_s - float(sky.at_s[i])
        velocity = sky.velocities_ned_m_s[i]
        travel_m = _travel_m(float(np.linalg.norm(velocity)), abs(age_s), limits)
        need_m = limits.separation_m + j.errors.space_m + limits.sigma_k * _sigma(float(sky.sigmas_m[i])) + travel_m
        place = sky.positions_ned_m[i] + (times[:, None] + age_s) * velocity
        # Wherever it may be on its line: where the time says, behind by its lag, or ahead by what it coasts.
        tracks = [approach_m(start + track[:, None] * direction - place) for track in (on_time, late, ahead)]
        lowest = min(tracks, key=lambda away: float(away.min()))
        lines += j.along("separation", lowest - need_m, note=name, spare_m=TIMED_M)
    return lines + _ages(j, sky)


def _travel_m(speed_m_s: float, age_s: float, limits: Limits) -> float:
    """What a neighbour may have done beside flying straight on."""
    return (limits.neighbour_turn * speed_m_s + 0.5 * limits.neighbour_acceleration_m_s2 * age_s) * age_s


def _ages(j: _Judging, sky: Neighbours) -> list[Line]:
    limits, now_s = j.limits, j.moment.now_s
    lines: list[Line] = []
    if sky.feed_at_s != math.inf:
        lines += j.number("neighbour_age", limits.neighbour_age_s - abs(now_s - sky.feed_at_s), "s", "feed")
    for i, name in enumerate(sky.names):
        age_s = abs(now_s - float(sky.at_s[i]))
        if age_s <= limits.neighbour_age_s:
            continue
        speed_m_s = float(np.linalg.norm(sky.velocities_ned_m_s[i]))
        ball_m = (
            limits.separation_m + j.errors.space_m + limits.sigma_k * _sigma(float(sky.sigmas_m[i])) + j.swept.stop_m
        )
        ball_m += limits.silent_speed_m_s * age_s + _travel_m(speed_m_s, age_s, limits)
        away_m = float(np.linalg.norm(j.swept.ned - sky.positions_ned_m[i], axis=1).min())
        lines += j.number("neighbour_age", away_m - ball_m, "m", f"{name}, silent for {age_s:.1f} s")
    return lines


def _reservations(j: _Judging) -> list[Line]:
    limits, now_s = j.limits, j.moment.now_s
    until_s = now_s + max(j.swept.end_s + limits.lag_s, limits.horizon_s)
    need_m = j.errors.space_m + j.swept.stop_m + 0.5 * limits.separation_m
    lines: list[Line] = []
    for volume in j.moment.reservations:
        if volume.until_s < now_s or volume.from_s > until_s:
            continue
        away = capsule_m(j.swept.ned, np.array(volume.start), np.array(volume.end), volume.radius_m)
        lines += j.along("reservation", away - need_m, mends=False, note=volume.holder)
    return lines


def _confidence(j: _Judging) -> list[Line]:
    limits, asked = j.limits, j.moment.asked
    sigma_m = max(_sigma(j.moment.vehicle.sigma_h_m), _sigma(j.moment.vehicle.sigma_v_m))
    localization = 1.0 / (1.0 + (sigma_m / limits.localization_half_m) ** 2) if j.errors.space_m >= 0.0 else math.nan
    lines = j.number("localization", localization - limits.localization_min, "")
    lines += j.number("telemetry_age", limits.telemetry_age_s - abs(j.moment.now_s - j.moment.vehicle.at_s), "s")
    lines += j.line("authority", None, passed=j.moment.stretch is not None, unit="", note="the drone was ours")
    if j.plan.primitive is Primitive.RETURN:
        return lines
    if asked is None:
        return lines + j.line("input_confidence", None, passed=False, unit="", note="nobody asked for it")
    least = {
        "voice": limits.confidence_voice,
        "gesture": limits.confidence_gesture,
        "panel": limits.confidence_panel,
    }
    needed = least.get(asked.modality, max(least.values()))
    return lines + j.number("input_confidence", asked.confidence - needed if asked.confidence <= 1.0 else math.nan, "")


_LIMITS: tuple[Callable[[_Judging], list[Line]], ...] = (
    _terrain, _obstacles, _fence, _standoff, _balls, _envelope, _separation, _reservations, _confidence,
)  # fmt: skip
