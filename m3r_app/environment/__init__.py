"""What stands still about a flight: the scenario, terrain, obstacles and fence."""
