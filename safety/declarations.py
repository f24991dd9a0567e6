"""Every constraint, once: its name, the requirements it serves, and whatever else anybody must know of it.

The rules (`constraints`) judge by these, and findings, monitor, wording and spoken cues take from here what they need.
"""

from __future__ import annotations

from dataclasses import dataclass

from safety.vocabulary import Finding


@dataclass(frozen=True, slots=True)
class Spoken:
    """What is spoken of a failure: where a number says so, and where nothing is known.

    What is in braces gives way to the name of what the finding is about. ahead: what lies in the direction of a move that
    was shortened for it; empty: the words of a failure.
    """

    broken: str
    unknown: str
    ahead: str = ""


@dataclass(frozen=True, slots=True)
class Constraint:
    """One constraint. Source: paper III-F, III-G; ids: `safety.requirements`."""

    name: str
    requirements: tuple[str, ...]
    spoken: Spoken
    hard: bool = False
    """Violating it in flight is a violation of safety, not only a reason not to start."""
    watched: bool = False
    """Not hard, but without it what is hard cannot be judged: the monitor looks at it too."""
    clears: bool = False
    """It may clear by itself: somebody flies on, a lease ends, a state gets fresh. Source: design 7 (delayed)."""
    located: bool = False
    """It is computed from the drone's position: where that is not known, it says nothing of its own."""

    def finding(
        self,
        margin: float | None,
        unit: str,
        passed: bool,
        text: str,
        below: tuple[tuple[str, float], ...] = (),
        subject: str = "",
    ) -> Finding:
        """What is found of it."""
        return Finding(self.name, self.requirements, margin, unit, passed, text, below, subject)

    def refused(self, unit: str, text: str, subject: str = "") -> Finding:
        """A failure without a number: something is unknown (X6)."""
        return Finding(self.name, self.requirements, None, unit, False, text, subject=subject)

    def unmet(self, text: str, *because: str) -> Finding:
        """A refusal that is a fact, not a distance. because: requirements that this refusal serves besides."""
        requirements = (*self.requirements, *(r for r in because if r not in self.requirements))
        return Finding(self.name, requirements, None, "", False, text)


AUTHORITY = Constraint("authority", ("X3", "X8"), Spoken("not yours", "not yours"))
INPUT_CONFIDENCE = Constraint("input_confidence", ("R11", "G1", "P2"), Spoken("not sure what you asked", "ask again"))
LOCALIZATION = Constraint("localization", ("R11", "X6"), Spoken("position uncertain", "position unknown"), watched=True)
TERRAIN_CONFIDENCE = Constraint(
    "terrain_confidence", ("R11", "X6"), Spoken("ground uncertain", "ground unknown"), located=True
)
NEIGHBOUR_AGE = Constraint(
    "neighbour_age", ("R11", "X6"), Spoken("{others} silent", "others silent"), watched=True, clears=True
)
ENVELOPE = Constraint("envelope", ("R8", "G6"), Spoken("over its limits", "limits unknown"), hard=True, located=True)
WORKSPACE = Constraint(
    "workspace", ("R7",), Spoken("edge of the workspace", "position unknown"), hard=True, located=True
)
SESSION = Constraint("session", ("X1",), Spoken("too far away", "position unknown"), hard=True, located=True)
GEOFENCE = Constraint(
    "geofence", ("G4",), Spoken("border too near", "position unknown", "border"), hard=True, located=True
)
STANDOFF = Constraint("standoff", ("X2",), Spoken("too near you", "your position unknown"), hard=True, located=True)
TERRAIN_CLEARANCE = Constraint(
    "terrain_clearance",
    ("R3", "R4", "G2"),
    Spoken("ground too near", "ground unknown", "ground"),
    hard=True,
    located=True,
)
AGL = Constraint("agl", ("R3", "G5"), Spoken("too low", "ground unknown"), hard=True, located=True)
OBSTACLE_CLEARANCE = Constraint(
    "obstacle_clearance",
    ("R3", "R4", "G2"),
    Spoken("{something} too near", "surroundings unknown", "{something}"),
    hard=True,
    located=True,
)
SEPARATION = Constraint(
    "separation",
    ("R5", "R6", "G3"),
    Spoken("{others} too near", "others unknown"),
    hard=True,
    clears=True,
    located=True,
)
RESERVATION = Constraint(
    "reservation", ("R5", "X10"), Spoken("held by others", "not free"), watched=True, clears=True, located=True
)
# What refuses a request before any rule is asked.
PAIRED = Constraint("paired", ("P1", "R1"), Spoken("not paired", "not paired"))
PROPERTY = Constraint("property", (), Spoken("a check of mine failed", "a check of mine failed"))
"""A temporal property (`safety.properties`) that does not hold. Its requirement is the property's."""
CONTRADICTION = Constraint("contradiction", (), Spoken("withdrawn", "withdrawn"))
