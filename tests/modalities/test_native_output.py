"""What native libraries write to standard error while they load."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from modalities.native_output import discarded_stderr


def test_only_what_is_written_meanwhile_is_lost(capfd: pytest.CaptureFixture[str]) -> None:
    os.write(2, b"before ")
    with discarded_stderr():
        os.write(2, b"meanwhile ")
    os.write(2, b"after")
    assert capfd.readouterr().err == "before after"


def test_without_a_standard_error_nothing_is_done() -> None:
    program = "import os\nfrom modalities.native_output import discarded_stderr\nos.close(2)\nwith discarded_stderr():\n    print('on')"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout == "on\n"
