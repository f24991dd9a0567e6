"""The former name of `m3r_app.arbiter.events`, for scripts outside the project that still use it. Goes when they do."""

from m3r_app.arbiter.events import *  # noqa: F403
