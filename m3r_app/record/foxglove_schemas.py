"""JSON schemas of Foxglove's well-known messages, as far as we write them.

Source: Foxglove's message schema reference.
"""

from __future__ import annotations

from typing import Any


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _array(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_NUMBER = {"type": "number"}
_INTEGER = {"type": "integer"}
_STRING = {"type": "string"}
_BOOLEAN = {"type": "boolean"}
_TIME = {"title": "time", **_object(sec=_INTEGER, nsec=_INTEGER)}
_DURATION = {"title": "duration", **_object(sec=_INTEGER, nsec=_INTEGER)}
_VECTOR = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE = _object(position=_VECTOR, orientation=_QUATERNION)
_COLOUR = _object(r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_LINE = _object(
    type=_INTEGER,
    pose=_POSE,
    thickness=_NUMBER,
    scale_invariant=_BOOLEAN,
    points=_array(_VECTOR),
    color=_COLOUR,
    colors=_array(_COLOUR),
    indices=_array(_INTEGER),
)
_SIZED = _object(pose=_POSE, size=_VECTOR, color=_COLOUR)
_TRIANGLES = _object(
    pose=_POSE, points=_array(_VECTOR), color=_COLOUR, colors=_array(_COLOUR), indices=_array(_INTEGER)
)
_ARROW = _object(
    pose=_POSE,
    shaft_length=_NUMBER,
    shaft_diameter=_NUMBER,
    head_length=_NUMBER,
    head_diameter=_NUMBER,
    color=_COLOUR,
)
_TEXT = _object(
    pose=_POSE, billboard=_BOOLEAN, font_size=_NUMBER, scale_invariant=_BOOLEAN, color=_COLOUR, text=_STRING
)
_ENTITY = _object(
    timestamp=_TIME,
    frame_id=_STRING,
    id=_STRING,
    lifetime=_DURATION,
    frame_locked=_BOOLEAN,
    metadata=_array(_object(key=_STRING, value=_STRING)),
    arrows=_array(_ARROW),
    cubes=_array(_SIZED),
    spheres=_array(_SIZED),
    cylinders=_array(_object()),
    lines=_array(_LINE),
    triangles=_array(_TRIANGLES),
    texts=_array(_TEXT),
    models=_array(_object()),
)

SCHEMAS: dict[str, dict[str, Any]] = {
    "foxglove.LocationFix": _object(
        timestamp=_TIME,
        frame_id=_STRING,
        latitude=_NUMBER,
        longitude=_NUMBER,
        altitude=_NUMBER,
        position_covariance=_array(_NUMBER),
        position_covariance_type=_INTEGER,
    ),
    "foxglove.FrameTransform": _object(
        timestamp=_TIME,
        parent_frame_id=_STRING,
        child_frame_id=_STRING,
        translation=_VECTOR,
        rotation=_QUATERNION,
    ),
    "foxglove.PoseInFrame": _object(timestamp=_TIME, frame_id=_STRING, pose=_POSE),
    "foxglove.SceneUpdate": _object(
        deletions=_array(_object(timestamp=_TIME, type=_INTEGER, id=_STRING)),
        entities=_array(_ENTITY),
    ),
    "foxglove.Log": _object(
        timestamp=_TIME, level=_INTEGER, message=_STRING, name=_STRING, file=_STRING, line=_INTEGER
    ),
}
"""JSON schemas by Foxglove's names; what this module writes of them."""
