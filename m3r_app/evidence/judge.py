"""The judge: a flight in, a judgement out. Pure, and of the code that flew it nothing is known here."""

from __future__ import annotations

from dataclasses import replace

from m3r_app.evidence.account import account
from m3r_app.evidence.flight import Flight
from m3r_app.evidence.plans import Moment, judge_plan
from m3r_app.evidence.samples import judge_samples
from m3r_app.evidence.verdict import Judgement, Line


def judge(flight: Flight) -> Judgement:
    """Every plan, every sample, and whether the account is whole."""
    samples, count = judge_samples(flight)
    lines = (*account(flight), *_plans(flight), *samples)
    return Judgement(lines, len(flight.plans), count, len(flight.requests))


def _plans(flight: Flight) -> list[Line]:
    lines: list[Line] = []
    for number, ((t_s, plan), started) in enumerate(flight.flown()):
        subject = started.request if started is not None else f"plan {number + 1}"
        states = [vehicle for told_s, vehicle in flight.telemetry if told_s <= t_s]
        if plan is None or not states:
            why = "the plan cannot be read" if plan is None else "nothing had been heard from the drone"
            lines.append(Line("plan", "envelope", subject, None, "m", passed=False, at_s=t_s, note=why))
            continue
        moment = Moment(
            t_s,
            states[-1],
            next((sky for told_s, sky in reversed(flight.neighbours) if told_s <= t_s), None),
            next((volumes for told_s, volumes in reversed(flight.reservations) if told_s <= t_s), ()),
            next((anchor for anchor in reversed(flight.anchors) if anchor[0] <= t_s), None),
            next((stretch for stretch in flight.ours if stretch.from_s <= t_s <= stretch.until_s), None),
            next((asked for asked in flight.requests if asked.id == subject and asked.t_s <= t_s), None),
        )
        wider_m = moment.stretch.wider_m if moment.stretch is not None else 0.0
        limits = replace(flight.limits, tracking_m=flight.limits.tracking_m + wider_m)
        lines += judge_plan(plan, subject, moment, replace(flight, limits=limits))
    return lines
