"""MAVSDK's messages go to logging: what it prints to standard output is not ours to litter."""

from __future__ import annotations

import functools
import logging
import sys

from mavsdk import LogLevel, log_subscribe
from mavsdk.plugins.action import Action
from mavsdk.plugins.mavlink_direct import MavlinkDirect
from mavsdk.plugins.mission_raw import MissionRaw
from mavsdk.plugins.offboard import Offboard
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry

log = logging.getLogger("m3r.mavsdk")

_LEVELS = {
    LogLevel.DEBUG: logging.DEBUG,
    LogLevel.INFO: logging.DEBUG,
    LogLevel.WARN: logging.INFO,
    LogLevel.ERROR: logging.WARNING,
}


@functools.cache
def redirect_log() -> None:
    """From now on MAVSDK prints nothing.

    Once only: replacing the handler would free the old one while another link's thread may be in it.
    """

    def to_logging(level: LogLevel, message: str, file: str | None, line: int) -> bool:
        log.log(_LEVELS[level], "%s (%s:%s)", message, file, line)
        return True

    def printed(*words: object) -> None:
        log.warning("%s", " ".join(map(str, words)))

    log_subscribe(to_logging)
    # Its Python wrappers print what goes wrong in a callback: one status text that is not UTF-8 is enough.
    for wrapper in (log_subscribe, Action, MavlinkDirect, MissionRaw, Offboard, Param, Telemetry):
        vars(sys.modules[wrapper.__module__])["print"] = printed
