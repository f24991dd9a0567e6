"""The former name of `m3r_app.record.recorder`, for scripts outside the project that still use it. Goes when they do."""

from m3r_app.record.recorder import *  # noqa: F403
