"""Where the command starts: Ctrl-C is answered from the first moment on, before anything heavy is imported."""

from __future__ import annotations

import os
import signal
import sys

INTERRUPTED = 130
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


def main() -> int:
    """Run the command line; returns the exit status."""
    for one in SIGNALS:
        signal.signal(one, _leave)
    from ui.cli import main as run

    return run()


def _leave(_signal: int, _frame: object) -> None:
    """Nothing flies yet: whatever flies takes the signals over."""
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
