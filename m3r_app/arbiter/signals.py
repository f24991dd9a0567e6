"""What a step of the arbiter says in the signals of `safety.properties`: from its event and its effects alone. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from m3r_app.arbiter.effects import Effect, FaceOperator, Fly, Hold, Report
from m3r_app.arbiter.events import (
    Event,
    PairingAnswered,
    Requested,
    ReservationAnswered,
    Stalled,
    TelemetryArrived,
)
from m3r_app.arbiter.margins import approved, margins, of_granted
from m3r_app.output import (
    RETURN,
    Action,
    DecisionEvent,
    ModeEvent,
    MotionEvent,
    MotionStatus,
    PairEvent,
    PairStatus,
    RequestEvent,
    ViolationEvent,
)
from safety.declarations import CONTRADICTION
from safety.limits import Limits
from safety.vocabulary import Command, State, Verdict

_SESSION = frozenset(State) - {State.IDLE, State.PAIRING, State.FACING}
_FLYING = (State.EXECUTING, State.RETURN_TO_ANCHOR)
_NO_MOVE = (Command.STOP, Command.ACTIVATE, Command.DISCONNECT)


class SignalReader:
    """Follows one flight. limits: the session's."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._state = State.IDLE
        self._paired = False
        self._authority = False
        self._started: set[str] = set()
        """Requests that were flown."""

    def read(self, event: Event, effects: tuple[Effect, ...]) -> dict[str, float]:
        """The signals of one step: truths as +1 and -1, numbers in the unit of their name."""
        was_ours = self._authority
        told = [effect.told for effect in effects if isinstance(effect, Report)]
        self._follow(told)
        started = [
            one.request
            for one in told
            if isinstance(one, MotionEvent) and one.status is MotionStatus.STARTED and one.request != RETURN
        ]
        again = not self._started.isdisjoint(started)
        self._started.update(started)
        decisions = [one for one in told if isinstance(one, DecisionEvent)]
        granting = approved(decisions)
        shorter = [one for one in decisions if one.verdict is Verdict.REDUCED and one.granted_m is not None]
        plans = [effect.plan for effect in effects if isinstance(effect, Fly)]
        starts_return = any(isinstance(one, ModeEvent) and one.state is State.RETURN_TO_ANCHOR for one in told)
        stop = isinstance(event, Requested) and event.request.command is Command.STOP
        truths = {
            "armed": self._state in _SESSION,
            "paired": self._paired,
            "start": bool(plans) and not starts_return,
            "start_any": bool(plans),
            "cleared": any(_cleared(one) for one in granting),
            "granting": bool(granting),
            "again": again,
            "scan": any(plan.primitive.is_scan for plan in plans),
            "heard": isinstance(event, TelemetryArrived),
            "idle": self._state is State.IDLE,
            "accepted": isinstance(event, PairingAnswered) and not event.reasons and event.world is not None,
            "confirmed": any(isinstance(one, PairEvent) and one.status is PairStatus.CONFIRMED for one in told),
            "stalled": isinstance(event, Stalled),
            "contradicted": any(_contradicted(one) for one in decisions),
            "reduced": bool(shorter),
            "stop": stop,
            "request": any(isinstance(one, RequestEvent) and one.command not in _NO_MOVE for one in told),
            "hold": any(isinstance(effect, Hold) for effect in effects),
            "commanded": any(isinstance(effect, Hold | Fly | FaceOperator) for effect in effects),
            "authority": was_ours or self._authority,
            "granted": isinstance(event, ReservationAnswered) and event.answer == "granted",
            "flying": self._state in _FLYING,
            "aborting": any(isinstance(one, ViolationEvent) and one.action is Action.ABORT for one in told),
            "emergency": self._state is State.EMERGENCY_HOLD,
            "blocked": self._state is State.BLOCKED,
            "low": any(_for_want_of_confidence(one) for one in decisions),
        }
        numbers = {
            "asked_m": max((one.requested_m or 0.0 for one in shorter), default=0.0),
            "granted_m": max((one.granted_m or 0.0 for one in shorter), default=0.0),
            "peak_m_s": max((plan.peak_speed_m_s for plan in plans), default=0.0),
            "length_m": max((plan.length_m for plan in plans), default=0.0),
            "duration_s": max((plan.duration_s for plan in plans), default=0.0),
            "peak_deg_s": max((plan.peak_yaw_rate_deg_s for plan in plans), default=0.0),
            "yaw_limit_deg_s": self._limits.yaw_rate_deg_s + _ROUNDING,
            "speed_limit_m_s": self._limits.speed_m_s + _ROUNDING,
            "length_limit_m": max(self._limits.lateral_step_m, self._limits.vertical_step_m) + _ROUNDING,
            "duration_limit_s": max((plan.max_duration_s for plan in plans), default=0.0),
        }
        return {**{name: 1.0 if truth else -1.0 for name, truth in truths.items()}, **numbers, **margins(granting)}

    def _follow(self, told: Sequence[object]) -> None:
        for one in told:
            match one:
                case ModeEvent():
                    self._state = one.state
                case PairEvent() if one.status is PairStatus.CONFIRMED:
                    self._paired = True
                case PairEvent() if one.status is PairStatus.RELEASED:  # refused is another drone, or was not paired
                    self._paired = False
        self._authority = self._state not in (State.IDLE, State.PAIRING)


_ROUNDING = 1e-9


def _cleared(decision: DecisionEvent) -> bool:
    """What is granted passes every constraint."""
    return all(one.passed for one in of_granted(decision))


def _contradicted(decision: DecisionEvent) -> bool:
    """Refused because two modalities ask for different things. Source: X5."""
    return any(one.constraint == CONTRADICTION.name and "X5" in one.requirements for one in decision.failing)


def _for_want_of_confidence(decision: DecisionEvent) -> bool:
    failed = [one.constraint for one in decision.failing]
    return decision.verdict is Verdict.REJECTED and failed == ["input_confidence"]
