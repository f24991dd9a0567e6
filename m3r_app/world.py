"""The former name of `m3r_app.environment.loaders`, for scripts outside the project that still use it. Goes when they do."""

from m3r_app.environment.loaders import *  # noqa: F403
