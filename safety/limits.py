"""Every threshold in one frozen struct, units in names, the requirement that needs it beside it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Limits:
    """What the rules compare with. `config` builds it from `default.toml`; the defaults here are the same values."""

    # Flight envelope: R8, G6, paper table I
    lateral_step_m: float = 1.0
    vertical_step_m: float = 0.5
    shortest_m: float = 0.1
    speed_m_s: float = 0.5
    descend_speed_m_s: float = 0.25
    acceleration_m_s2: float = 0.5
    yaw_rate_deg_s: float = 30.0
    yaw_acceleration_deg_s2: float = 30.0
    duration_factor: float = 2.0
    """A plan may take this times its nominal duration, plus duration_extra_s, before it is aborted."""
    duration_extra_s: float = 3.0
    speed_tolerance_m_s: float = 0.3
    """What filtered measured speed may exceed the bound by (gusts)."""
    # Terrain: R3, R4, G2, G5
    min_agl_m: float = 2.0
    clearance_m: float = 1.5
    obstacle_clearance_m: float = 1.5
    # Separation: R5, R6, G3
    separation_m: float = 3.0
    neighbour_age_s: float = 1.0
    """tau_max"""
    neighbour_acceleration_m_s2: float = 2.0
    """What a neighbour may do beside flying straight on in the age of its state."""
    neighbour_turn: float = 1.0
    """Share of its speed that a neighbour may have lost or turned aside in the age of its state; 0: it flew straight on."""
    silent_speed_m_s: float = 2.0
    """A neighbour older than that could be anywhere in a ball that grows this much faster than it last flew."""
    look_ahead_s: float = 2.0
    """How far ahead neighbours are extrapolated against a drone that is told to hold now (R9)."""
    horizon_s: float = 10.0
    """The drone hovers where a plan ends; separation there is checked this far ahead."""
    # Workspace and session: R7, X1
    workspace_m: float = 5.0
    session_m: float = 50.0
    drift_m_s: float = 0.01
    """How fast the position estimate may drift against itself since the anchor, 1 sigma; at most the stated sigma."""
    # Operator: X2
    standoff_m: float = 3.0
    # Confidence: R11, G1
    confidence_voice: float = 0.7
    confidence_gesture: float = 0.7
    confidence_panel: float = 0.5
    localization_min: float = 0.5
    """L_min; localisation confidence = 1 / (1 + (sigma / localization_half_m)^2)."""
    localization_half_m: float = 2.0
    terrain_confidence_min: float = 0.5
    """T_min; terrain confidence = 1 / (1 + (sigma / terrain_half_m)^2)."""
    terrain_half_m: float = 2.0
    disagreement_m: float = 0.5
    """How far the position may lately have moved otherwise than the velocity says (X6)."""
    noisy_disagreement_m: float = 2.0
    """... at least, once a hover has shown noise."""
    disagreement_max_m: float = 4.0
    """... and no noise that is observed in a hover may widen that beyond this."""
    jump_m: float = 0.5
    """A position that moves otherwise than its velocity says by more than this at once has jumped (an estimator's reset)."""
    speed_plausible_m_s: float = 20.0
    """A drone that says it flies faster is not believed: what it says is unknown (X6)."""
    battery_min: float = 0.2
    """Remaining fraction below which no maneuver is flown (X8)."""
    telemetry_age_s: float = 0.5
    """Older telemetry is no telemetry (X6)."""
    # Uncertainty and the vehicle: X11
    sigma_k: float = 2.0
    lag_s: float = 0.8
    stop_deceleration_m_s2: float = 1.5
    tracking_m: float = 0.3
    """Radius of the tube about the path that the vehicle stays in, gusts included."""
    noisy_tracking_m: float = 1.0
    """... and no narrower than this once a hover has shown noise: a few seconds show little of what comes in minutes."""
    tracking_max_m: float = 2.0
    """A drone whose estimate wanders so much that the tube would be wider is not flown."""
    rest_m_s: float = 0.1
    """Slower than this, motion has stopped."""
    hover_s: float = 1.0
    """So long a hover is observed before pairing is confirmed ..."""
    learn_s: float = 8.0
    """... and so long where it shows more noise than the limits are made for."""
    noise_k: float = 3.0
    """How many standard deviations of the observed noise are allowed for."""
    # Decisions
    bisection_m: float = 0.01
    delay_s: float = 3.0
    fusion_window_s: float = 1.0
    continue_within_s: float = 30.0
    return_after_s: float = 2.0
    request_age_s: float = 5.0
    """What was said or shown longer ago than this is asked anew (X6)."""
    request_ahead_s: float = 0.5
    """So far the clocks of what is captured may run ahead; what was asked later than now was not asked (X6)."""
    reservation_timeout_s: float = 1.0
    """So long the authority may take to answer (X10)."""
    # Heights that agree, and links: X6, X8
    operator_height_m: float = 2.0
    """An operator's altitude may be that of the ground or of what they hold in their hand."""
    landed_height_m: float = 0.5
    """How high above the ground a landed drone's own position may be."""
    home_height_m: float = 2.0
    """How much a home position, which is the fix of one moment, may be off beside what is stated."""
    rangefinder_tilt: float = 0.1
    """Share of a rangefinder's distance that a tilted drone may be off."""
    # How the arbiter knows that a motion has begun and ended: R8, design 2
    engaging_s: float = 1.0
    """So long the autopilot may take to enter Offboard and say so."""
    arrived_m: float = 0.1
    linger_s: float = 2.0
    """In wind, and with a noisy estimate, a drone may rest off its goal, within the tube; it has arrived after so much longer."""
    facing_tolerance_deg: float = 5.0
    facing_timeout_s: float = 20.0
    """So long it may take to come to rest facing the operator (P1)."""
    settling_timeout_s: float = 10.0
    """A request that waits for the drone to come to rest is refused after this."""
    position_lost_s: float = 3.0
    """So long a drone may be without a position before it is told to land, where that is chosen (X6)."""
