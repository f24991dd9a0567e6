"""The arbiter: pure. Events in, the next state and effects out; nothing here knows of clocks, files or networks."""
