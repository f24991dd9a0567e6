"""The outer guard: a small process that ends an app whose guard thread has fallen silent in command of a drone (X7).

Started by `m3r_app.vehicle.guard` as a script, with nothing imported that is not needed:

    guard_process.py APP_PID APP_PIDFD SILENCE_S

Standard input carries one byte per pulse of the guard thread: `+` in command, `-` not. Each is answered by one byte on
standard output, so that the thread knows that somebody watches. The app's death or the end of the input ends this. The
app is killed, not asked: an interpreter that is stuck cannot answer, and MAVSDK's threads go on sending setpoints.
"""

import os
import select
import signal
import sys
import time

CHECK_S = 0.05
COUNTED_S = 0.1
"""The most that one round counts as silence: if it took longer we ourselves were stopped, perhaps with the app."""


def end(app_pid: int, app_pidfd: int) -> None:
    """Kill the app and nobody else: by its pidfd, which never names another process, or as its child."""
    if app_pidfd >= 0:
        signal.pidfd_send_signal(app_pidfd, signal.SIGKILL)
    elif os.getppid() == app_pid:
        os.kill(app_pid, signal.SIGKILL)


def watch(app_pid: int, app_pidfd: int, silence_s: float) -> None:
    """Watch until the app ends, or is ended."""
    poll = select.poll()
    poll.register(0, select.POLLIN)
    if app_pidfd >= 0:
        poll.register(app_pidfd, select.POLLIN)
    in_command = False
    silent_s = 0.0
    last_s = time.monotonic()
    while True:
        ready = dict(poll.poll(CHECK_S * 1000))
        now_s = time.monotonic()
        gap_s, last_s = now_s - last_s, now_s
        if app_pidfd in ready:
            return  # the app has ended
        if 0 in ready:
            pulses = os.read(0, 4096)
            if not pulses:
                return
            try:
                os.write(1, pulses[-1:])
            except BrokenPipeError:
                return  # the app went between its pulse and our answer
            in_command = pulses[-1:] == b"+"
            silent_s = 0.0
            continue
        silent_s += min(gap_s, COUNTED_S)
        if in_command and silent_s >= silence_s:
            end(app_pid, app_pidfd)
            text = (
                f"m3r: the app did not respond for {silent_s:.1f} s while it commanded a drone, so it was ended; "
                "the drone's own failsafe holds it. Take it over by remote control or start m3r again.\n"
            )
            os.write(2, text.encode())
            return


if __name__ == "__main__":
    watch(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]))
