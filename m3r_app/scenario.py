"""The former name of `m3r_app.environment.scenario`, for scripts outside the project that still use it. Goes when they do."""

from m3r_app.environment.scenario import *  # noqa: F403
