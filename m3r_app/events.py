"""The former name of the arbiter's events, effects and state, for scripts outside the project. Goes when they do."""

from m3r_app.arbiter.effects import *  # noqa: F403
from m3r_app.arbiter.events import *  # noqa: F403
from m3r_app.arbiter.state import *  # noqa: F403
