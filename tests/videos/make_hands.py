"""Makes the video beside this file: `python tests/videos/make_hands.py`.

All nine gestures, and hands that ask for nothing, shown by the drawn hand of the demonstration. `all_nine.json` beside the video
says what is shown when.
"""

from __future__ import annotations

import json
from pathlib import Path

from config.demo.drawn_hand import GESTURES, NO_GESTURES, Film

HERE = Path(__file__).resolve().parent

RATE_HZ = 12.0
SHOWN_S, AWAY_S = 0.8, 0.4

# What it asks for, or which hand that asks for nothing.
SHOWN = (
    "go_up",
    "fist",
    "go_down",
    "go_left",
    "three fingers",
    "go_right",
    "go_forward",
    "four fingers",
    "go_back",
    "turn_left",
    "thumb and two fingers",
    "turn_right",
    "stop",
    "between two directions",
)


def main() -> None:
    shown = []
    with Film(HERE / "all_nine.mp4", RATE_HZ) as film:
        for what in SHOWN:
            film.nothing(AWAY_S)
            from_s, to_s = film.shows(GESTURES.get(what) or NO_GESTURES[what], SHOWN_S)
            command = what if what in GESTURES else "none"
            shown.append({"command": command, "from_s": round(from_s, 3), "to_s": round(to_s, 3)})
    (HERE / "all_nine.json").write_text(json.dumps(shown, indent=1) + "\n")


if __name__ == "__main__":
    main()
