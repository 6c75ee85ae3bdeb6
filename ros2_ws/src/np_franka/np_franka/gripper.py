"""The Franka Hand in a process of its own, because its calls block until a motion has ended.

The process reads openings from its standard input, one a line, and writes one JSON object a line: the opening
it measures, if it does, and what is wrong, or an empty error. While the fingers move it writes nothing. A failed
motion is reported until one succeeds; whatever broke, the hand is connected anew. It ends with its input.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from contextlib import suppress

from np_description.panda import FINGER_MAX, FINGER_SPEED
from np_franka.client import mismatch
from np_franka.robots import ROBOTS

READ_PERIOD = 0.02  # s between two measurements
RETRY_PERIOD = 1.0  # s from a failure to the next attempt to connect, unless there is something to do before
START_TIMEOUT = 15.0  # s
END_TIMEOUT = 3.0  # s
ENDED = "the hand's process has ended; `recover` starts it again"


class GripperError(OSError):
    """The hand does not reply."""


class Gripper:
    """The hand of the robot (a name of ROBOTS) at `hostname`. opening: of each finger, m; error: what went
    wrong last, or empty.

    Raises GripperError where there is none.
    """

    def __init__(self, robot: str, hostname: str):
        self.opening, self.error = 0.0, ""
        # A child has its parent's real-time priority, in which the hand's slow start would stop the arm's cycles.
        self._command = ["chrt", "--other", "0", sys.executable, "-m", "np_franka.gripper", robot, hostname]
        self._start()
        answered, _, _ = select.select([self._process.stdout], [], [], START_TIMEOUT)
        self.poll()
        if not answered or self.error:
            self.close()
            error = self.error or f"no reply within {START_TIMEOUT:g} s"
            raise GripperError(f"hand of {hostname}: {error}")

    def _start(self) -> None:
        self._buffer = b""
        self._process = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        os.set_blocking(self._process.stdout.fileno(), False)

    def poll(self) -> None:
        """Read what the process has written since; never waits."""
        try:
            received = os.read(self._process.stdout.fileno(), 65536)
        except BlockingIOError:
            return
        if not received:
            self.error = ENDED
        *lines, self._buffer = (self._buffer + received).split(b"\n")
        for line in lines:
            report = json.loads(line)
            self.opening, self.error = report.get("opening", self.opening), report["error"]

    def move(self, opening: float) -> None:
        """Move each finger to `opening` m; the newest request wins. ValueError outside 0 .. FINGER_MAX."""
        if not 0 <= opening <= FINGER_MAX:
            raise ValueError(f"gripper opening: expected 0 .. {FINGER_MAX} m, got {opening}")
        try:
            os.write(self._process.stdin.fileno(), f"{opening!r}\n".encode())
        except BrokenPipeError:
            raise ValueError(ENDED) from None

    def revive(self) -> None:
        """Start the process again if it has ended; never waits for it, `poll` reads its reports once it is there."""
        if self._process.poll() is not None:
            self.close()
            self._start()

    def close(self) -> None:
        """End the process."""
        self._process.stdin.close()
        try:
            self._process.wait(END_TIMEOUT)
        except subprocess.TimeoutExpired:  # in a motion
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()


def _say(**fields: object) -> None:
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


class _Wishes:
    """The openings that come on standard input."""

    def __init__(self):
        self._buffer = b""

    def newest(self, wait: float) -> float | None:
        """The newest opening m that has come, for which `wait` s are waited; None without. EOFError at the end."""
        while select.select([sys.stdin], [], [], wait)[0]:
            received, wait = os.read(sys.stdin.fileno(), 65536), 0.0
            if not received:
                raise EOFError
            self._buffer += received
        *complete, self._buffer = self._buffer.split(b"\n")
        return float(complete[-1]) if complete else None


def _serve(robot: str, hostname: str) -> None:
    client = ROBOTS[robot].load()
    wishes, wait, hand, failed = _Wishes(), READ_PERIOD, None, ""  # failed: how the last motion did
    while True:
        opening, wait = wishes.newest(wait), READ_PERIOD
        try:
            hand = client.Gripper(hostname) if hand is None else hand
            if opening is not None:
                is_there = hand.move(2 * opening, 2 * FINGER_SPEED)
                failed = "" if is_there else f"the hand did not reach {opening:.3f} m"
            _say(opening=hand.read_once().width / 2, error=failed)
        except client.ERRORS as error:
            hand, wait = None, RETRY_PERIOD
            words = str(mismatch(robot, client.PACKAGE, hostname, error) or error)
            failed = failed if opening is None else words
            _say(error=words)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal; the driver ends this process
    with suppress(EOFError, BrokenPipeError):  # the driver has closed its end of a pipe
        _serve(*sys.argv[1:])
