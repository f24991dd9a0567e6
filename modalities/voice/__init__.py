"""Speech to maneuver requests."""
