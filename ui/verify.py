"""`m3r verify`: flights judged from their records, without the code that flew them, as a table or as JSON."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from m3r_app.evidence.judge import judge
from m3r_app.evidence.reading import EvidenceError, Message, flight_of
from m3r_app.evidence.steps import steps_of
from m3r_app.evidence.verdict import Judgement, Line
from m3r_app.exit_status import ExitStatus
from m3r_app.record.chain import check, public_key
from m3r_app.record.recorder import (
    RecordError,
    read_attachments,
    read_header,
    read_lines,
    read_parts,
    read_record,
)

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

STEP = "step"
"""The topic of the arbiter's steps; older records have none."""
COLUMNS = ("judged", "limit", "lines", "worst", "about", "at", "")
DECIMALS = 4


class VerifyError(ValueError):
    """What was asked for cannot be done; one sentence."""


def verify(records: Sequence[Path], ulog: Path | None, key: Path | None = None, *, as_json: bool) -> int:
    """Judge them all and print what is found; returns the exit status: 0, or 4 where something does not hold.

    ulog: the autopilot's log of the one flight. Raises RecordError where a file is no flight record, ULogError where that is
    no log, VerifyError where it is given for several flights.
    """
    if ulog is not None and len(records) > 1:
        raise VerifyError(f"--ulog is the log of one flight, and {len(records)} records are named: name one")
    judged = [(record, judge_record(record, ulog, key)) for record in records]
    if as_json:
        print(json.dumps([_object(record, judgement) for record, judgement in judged], allow_nan=False, indent=1))
    else:
        for record, judgement in judged:
            print("\n".join(table(record.name, judgement)))
    return ExitStatus.ENDED if all(judgement.passed for _, judgement in judged) else ExitStatus.VIOLATED


def judge_record(record: Path, ulog: Path | None = None, key: Path | None = None) -> Judgement:
    """One flight's judgement. key: the public one that it must be signed with. Raises RecordError, ULogError, KeyFileError."""
    if not record.is_file():
        raise RecordError(f"{record} is no file: name a flight record")
    header = read_header(record)
    metadata = header.metadata
    messages: list[Message] = list(read_record(record))
    steps = [line for _, line in read_lines(record, (STEP,))]
    try:
        if steps:
            attached = read_attachments(record)
            texts = {name.partition(".")[0]: content.decode(errors="replace") for name, content in attached}
            metadata = {**metadata, "started_s": steps[0]["now_s"] - steps[0]["t"]}
            messages = steps_of(messages, steps, metadata["shapes"], texts)
        flight = flight_of(metadata, messages, closed=header.complete)
        judgement = judge(flight)
    except EvidenceError as error:
        raise RecordError(f"{record} cannot be judged: {error}") from None
    except Exception as error:  # noqa: BLE001  (what somebody has changed may be anything)
        raise RecordError(f"{record} cannot be judged: it holds what no m3r writes ({error!r})") from None
    held = property_lines(record) if steps else ()
    judgement = replace(judgement, lines=(*judgement.lines, *held, chain_line(record, key)))
    if ulog is None:
        return judgement
    from m3r_app.evidence.ulog import read_tracks  # loads pyulog
    from m3r_app.evidence.witness import witnessed

    if flight.origin is None:
        raise RecordError(f"{record} does not tell where its frame lies, so no log can be compared with it")
    return replace(judgement, lines=(*judgement.lines, *witnessed(flight, read_tracks(ulog, flight.origin))))


def property_lines(record: Path) -> tuple[Line, ...]:
    """Every temporal property over the arbiter's steps, by what they were told and did.

    One failing line where this m3r cannot take those steps apart: another version's, or changed.
    """
    try:
        return _property_lines(record)
    except RecordError as error:
        why = str(error)
    except Exception as error:  # noqa: BLE001  (what somebody has changed may be anything)
        why = f"the steps hold what no m3r writes ({error!r})"
    return (Line("property", "all", "", None, "", False, None, f"cannot be judged: {why}"),)


def _property_lines(record: Path) -> tuple[Line, ...]:
    from m3r_app.arbiter.signals import SignalReader
    from m3r_app.step_record import read_flight
    from safety.properties import Watch

    flight = read_flight(record)
    reader, watch = SignalReader(flight.start.limits), Watch()
    for step in flight.steps():
        effects = flight.text.value(json.loads(step.effects))
        watch.update(step.t_s, reader.read(step.event, effects))
    return tuple(
        Line(
            "property",
            found.of.requirement,
            found.of.formula,
            found.robustness if math.isfinite(found.robustness) else None,
            "",
            found.holds,
            found.at_s,
            "never asked about in this flight" if found.vacuous else found.of.says,
        )
        for found in watch.results()
    )


def chain_line(record: Path, key: Path | None) -> Line:
    """Whether the record is as it was written. Raises RecordError, KeyFileError."""
    found = check(read_parts(record), public_key(key) if key is not None else None)
    if not found.links and not found.broken:
        note = "it has no chain, so nobody can tell whether it was changed: an older m3r made it"
    elif found.broken:
        note = found.broken
    elif found.signed is False:
        note = "it is not signed with the key that was given"
    elif not found.ended or found.uncovered:
        note = f"it has no last link: it was cut, or its app was killed; {found.uncovered} messages are covered by none"
    else:
        signed = "signed with the key that was given" if found.signed else "no signature was asked about"
        note = f"{found.links} links hold, {signed}"
    return Line("record", "chain of hashes", "", None, "", found.intact, None, note)


def table(name: str, judgement: Judgement) -> list[str]:
    """The lines of a terminal: of each limit the worst, then every one that fails."""
    rows = [COLUMNS]
    for worst, count, failing in judgement.worst():
        verdict = f"FAILS {failing}x" if failing else "holds"
        rows.append((worst.part, worst.limit, str(count), _margin(worst), str(worst.subject), _time(worst), verdict))
    widths = [max(len(row[i]) for row in rows) for i in range(len(COLUMNS))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    lines += [
        f"FAILS: {line.part} {line.limit}{f' of {line.subject}' if line.subject else ''}"
        f"{f' at {_time(line)}' if line.at_s is not None else ''}: {' '.join(filter(None, (_margin(line), line.note)))}"
        for line in judgement.failing
    ]
    verdict = "everything holds" if judgement.passed else f"{len(judgement.failing)} do not hold"
    counts = f"{judgement.plans} plans, {judgement.samples} samples, {judgement.requests} requests"
    return [f"{name}: {counts}: {verdict}", *lines]


def _margin(line: Line) -> str:
    return f"{line.margin:+.2f} {line.unit}".rstrip() if line.margin is not None else ""


def _time(line: Line) -> str:
    return f"{line.at_s:.2f} s" if line.at_s is not None else ""


def _object(record: Path, judgement: Judgement) -> dict[str, Any]:
    return {
        "file": record.name,
        "passed": judgement.passed,
        "plans": judgement.plans,
        "samples": judgement.samples,
        "requests": judgement.requests,
        "lines": [
            {
                "part": line.part,
                "limit": line.limit,
                "subject": line.subject,
                "margin": _number(line.margin),
                "unit": line.unit,
                "passed": line.passed,
                "at_s": _number(line.at_s),
                "note": line.note,
            }
            for line in judgement.lines
        ],
    }


def _number(value: float | None) -> float | None:
    return round(value, DECIMALS) + 0.0 if value is not None and math.isfinite(value) else None
