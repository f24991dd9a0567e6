"""Every requirement once more in FRETish, NASA FRET's structured English: scope, condition, component, timing, response.

FRET gives each sentence a past-time and a future-time formula. A scope is a mode of the mode machine or a state of a request;
names with a unit are numbers, the others are true or false. A name without one is an observation: `docs/design.md` has its
meaning in the glossary. Source: Giannakopoulou et al., "Formal requirements elicitation with FRET" (2020).
"""

from __future__ import annotations

FRETISH: dict[str, str] = {
    "R1": "upon input_recognised the arbiter shall immediately satisfy request_is_a_bounded_primitive",
    "R2": "upon request_interpreted the planner shall immediately satisfy candidate_plan_is_bounded | request_refused",
    "R3": "upon maneuver_started the supervisor shall always satisfy terrain_clearance_was_judged_before",
    "R4": "upon terrain_clearance_predicted_m < terrain_clearance_required_m the supervisor shall immediately satisfy "
    "plan_rejected | plan_shortened",
    "R5": "upon maneuver_started the supervisor shall always satisfy separation_was_judged_before",
    "R6": "upon separation_predicted_m < separation_required_m the supervisor shall immediately satisfy "
    "plan_rejected | plan_shortened",
    "R7": "the supervisor shall always satisfy plan_granted => plan_farthest_from_anchor_m <= workspace_m",
    "R8": "the supervisor shall always satisfy plan_granted => (plan_speed_m_s <= speed_max_m_s & "
    "plan_length_m <= displacement_max_m & plan_duration_s <= duration_max_s)",
    "R9": "in Executing mode the monitor shall always satisfy "
    "terrain_clearance_is_judged & separation_is_judged & workspace_is_judged",
    "R10": "in Executing mode upon hard_constraint_violated the arbiter shall at the next timepoint satisfy emergency_hold",
    "R11": "when localisation_unsure | input_unsure | terrain_unsure | neighbours_stale the supervisor shall always satisfy "
    "request_made => (plan_rejected | plan_shortened | request_delayed)",
    "P1": "the arbiter shall always satisfy armed => paired",
    "P2": "upon maneuver_started the arbiter shall immediately satisfy "
    "input_confidence >= input_confidence_required & every_constraint_satisfied",
    "P3": "upon plan_shortened the supervisor shall immediately satisfy "
    "plan_on_the_asked_line & plan_length_m < asked_length_m & every_constraint_satisfied",
    "G1": "the supervisor shall always satisfy plan_granted => input_confidence >= input_confidence_required",
    "G2": "the supervisor shall always satisfy plan_granted => terrain_clearance_predicted_m >= terrain_clearance_required_m",
    "G3": "the supervisor shall always satisfy plan_granted => separation_predicted_m >= separation_required_m",
    "G4": "the supervisor shall always satisfy plan_granted => geofence_margin_m >= 0",
    "G5": "the supervisor shall always satisfy plan_granted => altitude_above_ground_m >= altitude_above_ground_required_m",
    "G6": "the supervisor shall always satisfy plan_granted => plan_length_m <= displacement_max_m",
    "X1": "the supervisor shall always satisfy plan_granted => plan_farthest_from_place_of_pairing_m <= session_m",
    "X2": "the supervisor shall always satisfy plan_granted => distance_to_operator_m >= standoff_m",
    "X3": "when !authority the arbiter shall always satisfy !vehicle_commanded",
    "X4": "upon stop_asked the arbiter shall immediately satisfy hold_commanded",
    "X5": "upon duplicate_request | contradicting_request the arbiter shall immediately satisfy request_refused",
    "X6": "when input_missing | input_stale | input_unreadable the supervisor shall always satisfy !plan_granted",
    "X7": "upon app_silent_s > app_silent_max_s the guard shall immediately satisfy hold_commanded",
    "X8": "upon pairing_confirmed the arbiter shall immediately satisfy "
    "drone_healthy & drone_airborne & operator_known & failsafe_parameters_set",
    "X9": "upon scan_completed the arbiter shall immediately satisfy "
    "turned_deg >= 360 - yaw_tolerance_deg & faces_the_operator",
    "X10": "upon maneuver_started the arbiter shall immediately satisfy airspace_granted & plan_judged_since_the_grant",
    "X11": "the supervisor shall always satisfy distance_judged_m <= "
    "distance_predicted_m - sigma_k * sigma_m - lag_m - stopping_distance_m",
    "X12": "upon continue_asked the arbiter shall immediately satisfy request_made | request_refused",
    "X13": "when limit_broken the monitor shall always satisfy maneuver_flying => margin_m >= margin_best_so_far_m - tolerance_m",
    "X14": "in Executing mode upon request_made the arbiter shall immediately satisfy hold_commanded",
}
"""By the ids of `safety.requirements`."""
