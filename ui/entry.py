"""Where the command starts: Ctrl-C is answered from the first moment on, before anything heavy is imported."""

from __future__ import annotations

import contextlib
import os
import signal
import sys

from m3r_app.exit_status import ExitStatus

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


def main() -> int:
    """Run the command line and leave with its exit status.

    The process ends here, without the interpreter's own end: MAVSDK's destructors corrupt the heap there when many vehicles
    were connected, and the status would be that of the crash. Everything of ours has been closed by then.
    """
    for one in SIGNALS:
        signal.signal(one, _leave)
    from ui.cli import main as run

    try:
        status = run()
    except SystemExit as left:  # argparse: help, a wrong option
        status = left.code if isinstance(left.code, int) else int(left.code is not None)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # nobody reads it any more
            stream.flush()
    os._exit(status)


def _leave(_signal: int, _frame: object) -> None:
    """Nothing flies yet: whatever flies takes the signals over."""
    os._exit(ExitStatus.INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
