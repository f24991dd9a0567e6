"""`m3r report`: one page about one flight, from its record. Self-contained: it fetches nothing, and opens anywhere.

Drawn by plotly, filled in by jinja2, which escapes whatever was said or named in flight.
"""

from __future__ import annotations

import html
import json
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2
import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from m3r_app.output import ModeEvent, MotionEvent, OutputEvent, PairEvent
from m3r_app.record.flight_summary import Asked, Story, number, place_of, story_of
from m3r_app.record.overwriting import is_other_file
from m3r_app.record.prism_mesh import prism_mesh
from m3r_app.record.recorder import RecordError, read_header, read_record
from ui.narrator import every_sentence, sentence

if TYPE_CHECKING:
    from m3r_app.record.recorder import RecordHeader

MARK = "<!-- m3r flight report -->"
"""A page with this in its first line is ours, and may be replaced."""
MARK_WITHIN_BYTES = 200
INKS = {"approved": "#2a9d4a", "reduced": "#d79b00", "delayed": "#d79b00", "replaced": "#d79b00", "rejected": "#d62828"}
SIGNS = {"approved": "circle", "reduced": "diamond", "delayed": "diamond", "replaced": "diamond", "rejected": "x"}
SCENE_M = 20.0
"""So far about the middle of the path the scene shows ground and neighbours."""
BALL = 13
"""Lines of the workspace's ball."""
COLOURS = {"red": "#d62828", "green": "#2a9d4a", "blue": "#2b6cb0"}


class ReportError(ValueError):
    """A report that cannot be written; one sentence that names the file."""


def write_report(record: Path, out: Path | None = None) -> tuple[Path, str | None]:
    """Write the page; returns where, and what is to be said of the record (that it breaks off). Raises RecordError, ReportError."""
    if record.exists() and not record.is_file():
        raise RecordError(f"{record} is no file: name a flight record")
    header = read_header(record)
    page = out or record.with_suffix(".html")
    if page.is_dir():
        raise ReportError(f"report {page} is a folder: name a file with --out")
    if is_other_file(page, MARK.encode(), MARK_WITHIN_BYTES):
        raise ReportError(f"report {page} would overwrite a file that is no report: name another with --out")
    try:
        story = story_of(read_record(record))
        text = render(story, header, record.name) if story.events else ""
    except RecordError:
        raise
    except (AttributeError, LookupError, TypeError, ValueError, jinja2.UndefinedError) as error:
        raise RecordError(f"{record} holds a message that no m3r writes ({error!r}): is it a flight record?") from None
    if not story.events:
        raise RecordError(f"{record} holds no event: there is no story to tell")
    try:
        page.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ReportError(f"report {page} cannot be written: {error.strerror}") from None
    broken = None
    if not header.complete:
        broken = f"{record} breaks off after {story.length_s:.1f} s: the report tells it up to there"
    return page, broken


def render(story: Story, header: RecordHeader, name: str) -> str:
    """The whole page."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(Path(__file__).with_name("report.html.j2").read_text(encoding="utf-8"))
    scenario = header.metadata.get("scenario") or {}
    return template.render(
        mark=Markup(MARK),  # noqa: S704  (ours)
        name=name,
        app=header.metadata.get("app"),
        scenario=scenario.get("name") if isinstance(scenario, dict) else None,
        models=header.metadata.get("models") or [],
        complete=header.complete,
        story=story,
        end=story.end,
        told=[(f"{told.t_s:.2f}", text) for told in story.events if (text := _told(told.event))],
        requests=story.requests,
        latencies=[
            (modality, len(values), np.percentile(values, 50), np.percentile(values, 95))
            for modality, values in story.latencies_ms().items()
        ],
        shown=shown,
        plotly=Markup(get_plotlyjs()),  # noqa: S704  (plotly.js itself)
        scene=_safe_json(scene(story)),
        lines=_safe_json(time_lines(story)),
    )


def shown(value: object, places: int = 2, unit: str = "") -> str:
    """A number for a reader; a dash where there is none."""
    found = number(value)
    return "–" if found is None else f"{round(found, places) + 0.0:.{places}f}{unit}"  # no -0.00


def _told(event: OutputEvent) -> str | None:
    return every_sentence(event) if isinstance(event, PairEvent | MotionEvent | ModeEvent) else sentence(event)


def _safe_json(figure: go.Figure) -> Any:
    """A figure as JSON that cannot end the script that it stands in."""
    text = re.sub(
        r"[<>&\u2028\u2029]", lambda m: f"\\u{ord(m[0]):04x}", json.dumps(_rounded(json.loads(figure.to_json())))
    )
    return Markup(text)  # noqa: S704  (what could end a script has just been escaped)


def _rounded(value: Any) -> Any:
    """To a millimetre or millisecond: a page about ten minutes stays small."""
    if isinstance(value, float):
        return round(value, 3)
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return {key: _rounded(one) for key, one in value.items()} if isinstance(value, dict) else value


# ---------------------------------------------------------------- the scene


def scene(story: Story) -> go.Figure:
    """Ground, obstacles, path, plans, anchors, requests, neighbours: east, north, up in metres about the operator's origin."""
    figure = go.Figure()
    middle = np.mean(story.track.places, axis=0) if story.track.places else np.zeros(3)
    ups = [-down for _, _, down in story.track.places]
    ground = story.static_scene.get("ground")
    if isinstance(ground, dict):
        norths, easts, heights = (np.array(ground[key], dtype=float) for key in ("norths_m", "easts_m", "heights_m"))
        rows, columns = _near(norths, middle[0]), _near(easts, middle[1])
        ups += [up for up in heights[np.ix_(rows, columns)].ravel().tolist() if math.isfinite(up)]
        figure.add_surface(
            x=easts[columns],
            y=norths[rows],
            z=heights[np.ix_(rows, columns)],
            colorscale="Earth",
            showscale=False,
            opacity=0.9,
            name="ground",
            hovertemplate="ground %{z:.1f} m<extra></extra>",
        )
    for one in story.static_scene.get("obstacles") or []:
        figure.add_trace(_prism(one["name"], one["corners_ne_m"], one["base_m"], one["top_m"]))
    for edge in story.static_scene.get("fence_ne_m") or []:
        ends = [(north, east, middle[2]) for north, east in (edge[:2], edge[2:4])]
        _line(figure, ends, "geofence at the height flown", "#c2185b", 3, group="geofence at the height flown")
    if story.track.places:
        _line(figure, story.track.places, "flown", "#1f77b4", 6)
    for number_, (t_s, points) in enumerate(story.plans, start=1):
        _line(figure, points, f"plan {number_} at {t_s:.1f} s", "#2a9d4a", 3, group="plans")
    for name, track in story.neighbours.items():
        near = [place for place in track.places if math.dist(place[:2], middle[:2]) <= SCENE_M]
        _line(figure, near, name, COLOURS.get(name, "#7b5ea7"), 2)
    if story.anchors:
        places = [place for _, place, _ in story.anchors]
        _marks(figure, places, [f"anchor at {t:.1f} s" for t, _, _ in story.anchors], "anchors", "cross", "#00a5cf")
        _, place, radius_m = story.anchors[-1]
        figure.add_trace(_ball(place, radius_m))
    for verdict, ink in INKS.items():
        asked = [r for r in story.requests if r.verdict == verdict and r.place is not None]
        texts = [f"{r.t_s:.1f} s {r.command.replace('_', ' ')}: {verdict} {_metres(r)}" for r in asked]
        _marks(figure, [r.place for r in asked], texts, f"{verdict} requests", SIGNS[verdict], ink)
    where = place_of(story.static_scene.get("operator"))
    if where is not None:
        _marks(figure, [where], ["operator"], "operator", "circle", "#e91e8c")
    low_m, high_m = min(ups, default=0.0) - 1.0, max(ups, default=0.0) + 6.0  # the workspace's ball has 5 m
    figure.update_layout(
        scene={
            "aspectmode": "manual",  # one scale for all three axes
            "aspectratio": {"x": 1.0, "y": 1.0, "z": (high_m - low_m) / (2.0 * SCENE_M)},
            "xaxis": {"title": "east, m", "range": [middle[1] - SCENE_M, middle[1] + SCENE_M]},
            "yaxis": {"title": "north, m", "range": [middle[0] - SCENE_M, middle[0] + SCENE_M]},
            "zaxis": {"title": "up, m", "range": [low_m, high_m]},
            "camera": {"eye": {"x": 0.5, "y": -1.0, "z": 0.5}},
        },
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        legend={"itemsizing": "constant"},
        height=560,
        template="none",
    )
    return figure


def _near(along: np.ndarray[Any, Any], middle: float) -> np.ndarray[Any, Any]:
    """Indices of what is in the scene."""
    return np.flatnonzero(np.abs(along - middle) <= SCENE_M)


def _xyz(places: list[Any]) -> dict[str, list[float]]:
    return {"x": [p[1] for p in places], "y": [p[0] for p in places], "z": [-p[2] for p in places]}


def _line(figure: go.Figure, places: list[Any], name: str, ink: str, width: int, group: str | None = None) -> None:
    if places:
        figure.add_scatter3d(
            **_xyz(places),
            mode="lines",
            name=html.escape(name if group is None else group),
            hovertext=html.escape(name),
            legendgroup=group or name,
            showlegend=group is None or not any(trace.legendgroup == group for trace in figure.data),
            line={"color": ink, "width": width},
        )


def _marks(figure: go.Figure, places: list[Any], texts: list[str], name: str, sign: str, ink: str) -> None:
    if places:
        figure.add_scatter3d(
            **_xyz(places),
            mode="markers",
            name=html.escape(name),
            hovertext=[html.escape(text) for text in texts],
            hoverinfo="text",
            marker={"symbol": sign, "size": 5, "color": ink},
        )


def _prism(name: str, corners_ne_m: Any, base_m: float, top_m: float) -> go.Mesh3d:
    """The walls and the roof of one obstacle."""
    points, triangles = prism_mesh(corners_ne_m, base_m, top_m)
    return go.Mesh3d(
        **dict(zip("xyz", zip(*points, strict=True), strict=True)),
        **dict(zip("ijk", zip(*triangles, strict=True), strict=True)),
        name=html.escape(name),
        color="#b5651d",
        opacity=0.6,
        showlegend=True,
        hoverinfo="name",
    )


def _ball(place: Any, radius_m: float) -> go.Scatter3d:
    """The workspace as lines of longitude and latitude."""
    turn = np.linspace(0.0, 2.0 * math.pi, 37)
    x: list[float] = []
    y: list[float] = []
    z: list[float] = []
    for tilt in np.linspace(0.0, math.pi, BALL)[:-1]:
        x += [*(place[1] + radius_m * np.cos(turn) * math.cos(tilt)), math.nan]
        y += [*(place[0] + radius_m * np.cos(turn) * math.sin(tilt)), math.nan]
        z += [*(-place[2] + radius_m * np.sin(turn)), math.nan]
    line = {"color": "#00a5cf", "width": 1}
    return go.Scatter3d(
        x=x, y=y, z=z, mode="lines", name="last workspace", line=line, hoverinfo="name", connectgaps=False
    )


def _metres(asked: Asked) -> str:
    granted, requested = asked.decisions[-1].granted_m, asked.decisions[-1].requested_m
    if granted is None:
        return "" if requested is None else f"of {requested:.2f} m"
    return f"{granted:.2f} m" if requested is None else f"{granted:.2f} m of {requested:.2f} m"


# ---------------------------------------------------------------- time lines


def time_lines(story: Story) -> go.Figure:
    """Mode, margins in flight and at each decision, confidence and speed over the same seconds."""
    figure = make_subplots(
        rows=5,
        cols=1,
        shared_xaxes=True,
        vertical_spacing=0.05,
        row_heights=[0.16, 0.28, 0.28, 0.14, 0.14],
        subplot_titles=("mode", "margins in flight, m", "margins of decisions, m", "confidence", "speed, m/s"),
    )
    if story.modes:
        times = [t for t, _, _ in story.modes] + [story.length_s]
        modes = [html.escape(mode).replace("Response", "Response<br>") for _, mode, _ in story.modes]
        states = [html.escape(state) for _, _, state in story.modes]
        figure.add_scatter(
            x=times,
            y=[*modes, modes[-1]],
            text=[*states, states[-1]],
            mode="lines",
            line_shape="hv",
            name="mode",
            row=1,
            col=1,
        )
    for name, values in story.margins.items():
        if name not in ("battery", "link age"):
            figure.add_scatter(
                x=[t for t, _ in values], y=[v for _, v in values], mode="lines", name=html.escape(name), row=2, col=1
            )
    for name, found in story.decided_m().items():
        figure.add_scatter(
            x=[t for t, _, _ in found],
            y=[margin for _, margin, _ in found],
            mode="markers",
            marker={"symbol": ["circle" if passed else "x" for _, _, passed in found], "size": 8},
            name=html.escape(f"{name}, decided"),
            row=3,
            col=1,
        )
    for row in (2, 3):
        figure.add_hline(y=0.0, line_dash="dot", line_color="#d62828", row=row, col=1)
    for modality in sorted({r.modality for r in story.requests}):
        asked = [r for r in story.requests if r.modality == modality]
        figure.add_scatter(
            x=[r.t_s for r in asked],
            y=[r.confidence for r in asked],
            text=[html.escape(r.command.replace("_", " ")) for r in asked],
            mode="markers",
            name=html.escape(modality),
            row=4,
            col=1,
        )
    figure.add_scatter(x=story.track.times_s, y=story.track.speeds_m_s, mode="lines", name="speed", row=5, col=1)
    figure.update_xaxes(title_text="s since the start", row=5, col=1)
    figure.update_yaxes(range=[-0.05, 1.05], row=4, col=1)
    figure.update_yaxes(automargin=True)
    figure.update_layout(
        height=1040, margin={"l": 60, "r": 10, "t": 30, "b": 40}, template="none", hovermode="x unified"
    )
    return figure
