"""Hand gestures to maneuver requests."""
