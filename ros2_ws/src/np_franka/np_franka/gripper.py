"""The Franka Hand in a process of its own, because its calls block until a motion has ended.

The process reads openings from its standard input, one a line, and writes one JSON object a line: the opening
it measures, or an error. While the fingers move it says nothing. It ends with its input.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys

from np_description.panda import FINGER_MAX, FINGER_SPEED
from np_franka.client import mismatch
from np_franka.robots import ROBOTS

READ_PERIOD = 0.02  # s between two measurements
START_TIMEOUT = 15.0  # s
END_TIMEOUT = 3.0  # s


class GripperError(OSError):
    """The hand does not answer."""


class Gripper:
    """The hand of the robot (a name of ROBOTS) at `hostname`. opening: of each finger, m; error: what went
    wrong last, or empty.

    Raises GripperError where there is none.
    """

    def __init__(self, robot: str, hostname: str):
        self.opening, self.error = 0.0, ""
        self._buffer = b""
        self._process = subprocess.Popen([sys.executable, "-m", "np_franka.gripper", robot, hostname],
                                         stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        os.set_blocking(self._process.stdout.fileno(), False)
        answered, _, _ = select.select([self._process.stdout], [], [], START_TIMEOUT)
        self.poll()
        if not answered or self.error:
            self.close()
            error = self.error or f"no answer within {START_TIMEOUT:g} s"
            raise GripperError(f"hand of {hostname}: {error}")

    def poll(self) -> None:
        """Take over what the process has said since; never waits."""
        try:
            received = os.read(self._process.stdout.fileno(), 65536)
        except BlockingIOError:
            return
        if not received:
            self.error = self.error or "the hand's process has ended"
        *lines, self._buffer = (self._buffer + received).split(b"\n")
        for line in lines:
            said = json.loads(line)
            self.opening, self.error = said.get("opening", self.opening), said.get("error", "")

    def move(self, opening: float) -> None:
        """Move each finger to `opening` m; the newest wish wins. ValueError outside 0 .. FINGER_MAX."""
        if not 0 <= opening <= FINGER_MAX:
            raise ValueError(f"gripper opening: expected 0 .. {FINGER_MAX} m, got {opening}")
        try:
            os.write(self._process.stdin.fileno(), f"{opening!r}\n".encode())
        except BrokenPipeError:
            raise ValueError("the hand's process has ended") from None

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


def _serve(robot: str, hostname: str) -> None:
    client = ROBOTS[robot].load()
    try:
        hand = client.Gripper(hostname)
        wishes = b""
        while True:
            while select.select([sys.stdin], [], [], READ_PERIOD)[0]:
                received = os.read(sys.stdin.fileno(), 65536)
                if not received:
                    return
                wishes += received
            *complete, wishes = wishes.split(b"\n")
            if complete and not hand.move(2 * float(complete[-1]), 2 * FINGER_SPEED):
                _say(error=f"the hand did not reach {float(complete[-1]):.3f} m")
            else:
                _say(opening=hand.read_once().width / 2)
    except BrokenPipeError:
        pass  # nobody listens any more
    except client.ERRORS as error:
        _say(error=str(mismatch(robot, client.PACKAGE, hostname, error) or error))


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal; the driver ends this process
    _serve(*sys.argv[1:])
