"""Behavioural contracts of every primitive as data: preconditions, invariants, postconditions.

Each names constraints of `safety.constraints`; the supervisor checks them on the plan, the monitor on the measured state.
Source: paper IV-C (contract-based operationalisation).
"""

from __future__ import annotations

from dataclasses import dataclass

from safety.vocabulary import Primitive


@dataclass(frozen=True, slots=True)
class Contract:
    """What must hold before, throughout and after a primitive, by constraint name."""

    preconditions: tuple[str, ...]
    invariants: tuple[str, ...]
    postconditions: tuple[str, ...]


PRECONDITIONS = ("authority", "input_confidence", "localization", "terrain_confidence", "neighbour_age", "reservation")
"""When execution may begin."""
SPACE = ("terrain_clearance", "agl", "obstacle_clearance", "separation", "workspace", "session", "geofence", "standoff")
"""What the swept path keeps, and the measured state while flying."""
ENVELOPE = ("envelope",)
POSTCONDITIONS = ("at_rest_in_workspace", "or_held")
"""The drone rests at an approved place within the workspace, or was safely aborted to hover."""
FACING = ("facing_operator",)

CONTRACTS: dict[Primitive, Contract] = {
    primitive: Contract(
        # Nobody asks for the way back, so there is no input to be confident of.
        preconditions=tuple(p for p in PRECONDITIONS if primitive is not Primitive.RETURN or p != "input_confidence"),
        invariants=(*SPACE, *ENVELOPE),
        postconditions=(*POSTCONDITIONS, *FACING) if primitive.is_scan else POSTCONDITIONS,
    )
    for primitive in Primitive
}
