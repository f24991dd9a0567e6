"""`m3r serve`: the console in a browser on this computer, by textual-serve. One operator at a time.

Whoever reaches the page can ask a drone to move, so it listens on loopback only, and a page of somebody else that is open in
the same browser is refused: requests must name this host, and the console's socket must be opened by this page.
"""

from __future__ import annotations

import re
import shlex
import socket
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from aiohttp import web
from textual_serve.server import Server

from m3r_app.ports import require_free

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence

    Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

HOST = "127.0.0.1"
POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "font-src 'self' data:; connect-src 'self' ws://127.0.0.1:{port}"
)
"""Nothing is fetched from elsewhere: a laptop in a field has no network, and needs none."""
ELSEWHERE = re.compile(rf'<link[^>]*href="https?://(?!{re.escape(HOST)}:)[^>]*>')
FOCUS = """<script>
const look = setInterval(() => {
  const keyboard = document.querySelector("textarea");
  if (keyboard && document.body.classList.contains("-first-byte")) { keyboard.focus(); clearInterval(look); }
}, 100);
</script>"""


class Console(Server):
    """textual-serve's server for this page only."""

    def __init__(self, command: str, port: int) -> None:
        super().__init__(command, host=HOST, port=port, title="M3R", public_url=f"http://{HOST}:{port}")

    def initialize_logging(self) -> None:
        """Nothing to add: ours is set up by the command line."""

    async def _make_app(self) -> web.Application:
        app = await super()._make_app()
        app.middlewares.extend([self._ours_only, self._page_alone])
        app.router.add_get("/favicon.ico", self._no_icon)
        app.on_response_prepare.append(self._with_policy)
        return app

    async def on_startup(self, app: web.Application) -> None:  # noqa: ARG002
        print(f"the console is at {self.public_url} (Ctrl-C ends it, and leaves the drone in Hold)", flush=True)

    @web.middleware
    async def _ours_only(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        origin = request.headers.get("Origin")
        if request.host != f"{HOST}:{self.port}" or (origin is not None and origin != self.public_url):
            raise web.HTTPForbidden(text=f"open the console as {self.public_url}")
        if request.path == "/ws" and origin is None:
            raise web.HTTPForbidden(text="the console's socket is for its own page")
        return await handler(request)

    @web.middleware
    async def _page_alone(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """The page without what it would fetch from elsewhere, and with the keyboard in the console from the start."""
        response = await handler(request)
        if request.path == "/" and isinstance(response, web.Response) and response.text is not None:
            response.text = ELSEWHERE.sub("", response.text).replace("</body>", f"{FOCUS}</body>")
        return response

    async def _no_icon(self, _request: web.Request) -> web.Response:
        return web.Response(status=204)

    async def _with_policy(self, _request: web.Request, response: web.StreamResponse) -> None:
        response.headers["Content-Security-Policy"] = POLICY.format(port=self.port)
        response.headers["X-Frame-Options"] = "DENY"


def serve(words: Sequence[str], port: int) -> int:
    """Serve until interrupted. words: options of the console. Raises LinkError for a port in use."""
    require_free(HOST, port, socket.SOCK_STREAM, "choose another with --port")
    with tempfile.TemporaryDirectory(prefix="m3r-") as folder:
        command = [sys.executable, "-m", "ui.entry", "console", "--seat", str(Path(folder) / "seat"), *words]
        # exec: no shell stays between the server and the console, so that neither outlives the other.
        Console(f"exec {shlex.join(command)}", port).serve()
    return 0
