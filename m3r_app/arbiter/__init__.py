"""The arbiter: pure. Events in, the next state and effects out; nothing here knows of clocks, files or networks."""

from m3r_app.arbiter.step import step

__all__ = ["step"]
