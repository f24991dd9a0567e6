"""Make docs/output.md and docs/output.schema.json from the types of m3r_app/output.py. A test holds them together."""

from __future__ import annotations

import json
from pathlib import Path

from m3r_app.output_schema import documentation, schema

DOCS = Path(__file__).resolve().parent.parent / "docs"


def files() -> dict[Path, str]:
    """What should stand where."""
    return {
        DOCS / "output.md": documentation(),
        DOCS / "output.schema.json": json.dumps(schema(), indent=2) + "\n",
    }


if __name__ == "__main__":
    for path, text in files().items():
        path.write_text(text, encoding="utf-8")
