"""Makes the pictures of the README: the real console and a real report, on the simulated fleet.

python scripts/screenshots.py        needs chromium, which turns SVG and HTML into PNG
"""

from __future__ import annotations

import asyncio
import re
import shutil
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, sync_playwright

from m3r_app.options import RunOptions
from m3r_app.run_thread import Live
from ui.console.app import Console
from ui.report import write_report

DOCS = Path(__file__).resolve().parent.parent / "docs"
LARGE, SMALL = (140, 45), (80, 24)
PATIENCE_S = 60.0
TRIES = 8


async def fly(folder: Path, size: tuple[int, int], theme: str, picture: Path) -> Path:
    """Pair with red and go right until the wall shortens it; the screen while that is flown. Returns the flight record."""
    record = folder / f"{picture.stem}.mcap"
    shown: deque[Any] = deque()
    live = Live(RunOptions(record=record, spoken=False), shown.append)
    live.start()
    app = Console(live, shown)
    verdicts: list[str] = []
    async with app.run_test(size=size) as pilot:
        app.theme = theme

        async def until(condition: Callable[[], bool]) -> None:
            end_s = time.monotonic() + PATIENCE_S
            while not condition():
                if time.monotonic() > end_s or live.ended:
                    raise SystemExit("the flight did not go as it should")
                await pilot.pause(0.1)

        def state() -> str:
            return live.snapshot.state.state.value if live.snapshot is not None else ""

        await until(lambda: live.snapshot is not None)
        await pilot.pause(0.5)
        await pilot.press("1")
        await until(lambda: state() == "ManeuverRequestArmed")
        log = app.screen.query_one("#log")
        for _ in range(TRIES):
            await pilot.press("right")
            await until(lambda: state() == "ExecutingBoundedMotion")
            await pilot.pause(1.0)
            verdicts = [line.text for line in log.lines]  # type: ignore[attr-defined]
            if any("reduced" in line for line in verdicts):
                break
            await until(lambda: state() == "ManeuverRequestArmed")
        svg = re.sub(r"@font-face \{.*?\}", "", app.export_screenshot(title="M3R"), flags=re.DOTALL)
        picture.write_text(svg, encoding="utf-8")
        await until(lambda: state() == "ManeuverRequestArmed")
        live.quit()
        await until(lambda: True)
    live.result()
    return record


def main() -> int:
    chromium = shutil.which("chromium")
    if chromium is None:
        raise SystemExit("chromium is not installed: apt-get install chromium")
    DOCS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        large, small = folder / "console.svg", folder / "console-small.svg"
        record = asyncio.run(fly(folder, LARGE, "textual-dark", large))
        asyncio.run(fly(folder, SMALL, "textual-light", small))
        page, _ = write_report(record)
        gl = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium, args=gl)
            png(browser, large, "console.png", (1250, 830))
            png(browser, small, "console-small.png", (760, 490))
            png(browser, page, "report.png", (1100, 830), "body[data-drawn=yes]")
            browser.close()
    return 0


def png(browser: Browser, source: Path, target: str, size_px: tuple[int, int], ready: str | None = None) -> None:
    """A picture of a page, once what it waits for is there."""
    page = browser.new_page(viewport={"width": size_px[0], "height": size_px[1]})
    page.goto(source.as_uri())
    if ready is not None:
        page.wait_for_selector(ready)
        page.wait_for_timeout(1500)
    page.screenshot(path=DOCS / target)
    page.close()


if __name__ == "__main__":
    sys.exit(main())
