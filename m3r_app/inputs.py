"""The recorded and scripted inputs of one run: opened before anything flies, played in their own time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field

from m3r_app.options import RunOptions
from safety.vocabulary import ManeuverRequest
