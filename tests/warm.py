"""The project's programs as processes of their own, forked from one that has imported them already.

Importing is most of a short run, and a suite has a hundred of them. What runs is what the command runs, with its own streams,
environment, signals and exit status; only the import is done beforehand. How the command starts cold is tests/ui/test_cli.py's.
"""

from __future__ import annotations

import functools
import importlib
import json
import os
import select
import selectors
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from io import FileIO
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).resolve().parent.parent
PROGRAMS = ("ui.entry", "m3r_app.sim.__main__", "tests.virtual_pad", "tests.soak.weakened")
IMPORTED = (*PROGRAMS, "ui.cli", "m3r_app.run")
LONGEST = 1 << 18


class Program:
    """A running program: as much of `subprocess.Popen` as the tests use, in bytes and without buffers."""

    def __init__(
        self,
        program: str,
        arguments: Sequence[str],
        stdin: int = subprocess.DEVNULL,
        stderr: int | None = None,
        env: Mapping[str, str] | None = None,
    ) -> None:
        """stdin: PIPE, DEVNULL or a file descriptor; stdout is always a pipe; stderr: PIPE, or None for the tests' own."""
        given: list[int] = []
        self.returncode: int | None = None
        self.stdin: FileIO | None = None
        self.stderr: FileIO | None = None
        if stdin == subprocess.PIPE:
            out, into = os.pipe()
            self.stdin = FileIO(into, "w")
            given.append(out)
        else:
            given.append(os.open(os.devnull, os.O_RDONLY) if stdin == subprocess.DEVNULL else os.dup(stdin))
        out, into = os.pipe()
        self.stdout = FileIO(out)
        given.append(into)
        if stderr == subprocess.PIPE:
            out, into = os.pipe()
            self.stderr = FileIO(out)
            given.append(into)
        else:
            given.append(os.dup(2))
        self._status, theirs = socket.socketpair()
        asked = {"program": program, "arguments": list(arguments), "env": dict(os.environ if env is None else env)}
        message = json.dumps(asked).encode()
        assert len(message) < LONGEST
        socket.send_fds(_nursery(), [message], [*given, theirs.fileno()])
        for fd in given:
            os.close(fd)
        theirs.close()
        self._lines = self._status.makefile("rb")
        self.pid = int(self._lines.readline())

    def poll(self) -> int | None:
        if self.returncode is None and select.select([self._status], [], [], 0.0)[0]:
            self.wait()
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Raises subprocess.TimeoutExpired."""
        if self.returncode is None:
            if not select.select([self._status], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
            self.returncode = int(self._lines.readline())
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def communicate(self, timeout: float | None = None) -> tuple[bytes, bytes]:
        """All that is still told, up to the end. Raises subprocess.TimeoutExpired."""
        deadline_s = None if timeout is None else time.monotonic() + timeout
        if self.stdin is not None:
            self.stdin.close()
        told = {stream: b"" for stream in (self.stdout, self.stderr) if stream is not None and not stream.closed}
        with selectors.DefaultSelector() as waiting:
            for stream in told:
                waiting.register(stream, selectors.EVENT_READ)
            while waiting.get_map():
                left_s = None if deadline_s is None else deadline_s - time.monotonic()
                ready = waiting.select(left_s)
                if not ready:
                    raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
                for key, _ in ready:
                    stream = key.fileobj
                    assert isinstance(stream, FileIO)
                    more = stream.read(65536)
                    told[stream] += more or b""
                    if not more:
                        waiting.unregister(stream)
                        stream.close()
        self.wait(None if deadline_s is None else max(0.0, deadline_s - time.monotonic()))
        return told.get(self.stdout, b""), told.get(self.stderr, b"") if self.stderr is not None else b""


@functools.cache
def _nursery() -> socket.socket:
    """Where to ask for a program; its process ends with this one."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for kind in (socket.SO_SNDBUF, socket.SO_RCVBUF):
        ours.setsockopt(socket.SOL_SOCKET, kind, LONGEST)
    subprocess.Popen(
        [sys.executable, "-u", "-m", "tests.warm", str(theirs.fileno())],
        cwd=ROOT,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # what has threads cannot be forked
        stdin=subprocess.DEVNULL,
        pass_fds=[theirs.fileno()],
    )
    theirs.close()
    return ours


def _serve(requests: socket.socket) -> None:
    """Fork a keeper for each request; returns in a process that is to become the program."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in pytest's terminal
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    while True:
        message, fds, _, _ = socket.recv_fds(requests, LONGEST, 4)
        if not message:
            os._exit(0)
        if os.fork() == 0:
            requests.close()
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            signal.signal(signal.SIGINT, signal.default_int_handler)
            _keep(fds)
            asked = json.loads(message)
            os.environ.clear()
            os.environ.update(asked["env"])
            sys.argv = [asked["program"], *asked["arguments"]]
            return
        for fd in fds:
            os.close(fd)


def _keep(fds: Sequence[int]) -> None:
    """Tell the id of the program and its exit status, and end it with those who asked; returns in the program."""
    pid = os.fork()
    if pid == 0:
        os.close(fds[3])
        for number, fd in enumerate(fds[:3]):
            os.dup2(fd, number)
            os.close(fd)
        return
    for fd in fds[:3]:
        os.close(fd)
    status = socket.socket(fileno=fds[3])
    status.sendall(b"%d\n" % pid)
    ended = os.pidfd_open(pid)
    if status in select.select([ended, status], [], [])[0]:
        os.kill(pid, signal.SIGKILL)
    _, how = os.waitpid(pid, 0)
    status.sendall(b"%d\n" % os.waitstatus_to_exitcode(how))
    os._exit(0)


def main() -> NoReturn:
    for module in IMPORTED:
        importlib.import_module(module)
    assert len(list(Path("/proc/self/task").iterdir())) == 1, "an import has started a thread"
    _serve(socket.socket(fileno=int(sys.argv[1])))
    sys.exit(sys.modules[sys.argv[0]].main())


if __name__ == "__main__":
    main()
