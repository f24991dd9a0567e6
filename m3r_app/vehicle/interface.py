"""What every kind of vehicle has in common: where it is linked to, and how it says that something cannot be done."""

from __future__ import annotations

from dataclasses import dataclass


class VehicleError(Exception):
    """What the vehicle or its link would not do: one sentence that names the vehicle and what to do."""


@dataclass(frozen=True, slots=True)
class Links:
    """Where the vehicles are. others: aircraft that are heard but cannot be paired with. complete: nobody else flies."""

    vehicles: dict[str, str]
    others: dict[str, str]
    complete: bool
