"""Vehicles: what a drone reports, what is asked of it, and who watches over the link. MAVSDK stays in `mavsdk_*`."""
