"""Starts protocol_server.py in the simulator's environment, and talks to it."""

from __future__ import annotations

import importlib.util
import json
import os
import select
import signal
import subprocess
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SIMULATOR = Path(os.environ.get("FRANKA_SIMULATOR", ROOT / ".venv-franka-sim/bin/python"))
TIMEOUT = 60.0  # s
SLOW = 3.0  # ms a cycle of 1 ms of the robot takes, where speed is not what is looked at
# Of first-in-first-out scheduling, where permitted.
ROBOT_PRIORITY, DRIVER_PRIORITY, TEST_PRIORITY = 60, 50, 40
# Robot and driver take turns, so that the kernel would keep both on one core: they would fill it, and from
# real-time tasks that fill a core the kernel takes it for 50 ms a second. A real robot has its own.
ROBOT_CORES, *_ = CORES = [{core} for core in sorted(os.sched_getaffinity(0))]
DRIVER_CORES = CORES[-1]
OF_ROS = ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "PYTHONPATH", "PYTHONHOME")


def missing() -> str:
    """Why the driver cannot be tested here; empty if it can."""
    if not all(map(importlib.util.find_spec, ("pylibfranka", "panda_py"))):
        return "the hardware extra is not installed (make test-driver installs it)"
    if not SIMULATOR.exists():
        return f"no protocol simulator at {SIMULATOR} (make test-driver installs it)"
    return ""


class SimulatedRobot:
    """A robot of its own, on a loopback address of its own; ends with `close`.

    hand_mass: kg, of the end effector that its settings name. pace: ms that a cycle takes. The robot's clock
    paces whoever talks to it and counts for every deadline, so that a slow robot leaves a busy machine time
    and changes nothing else. protocol: version that it claims to speak; it speaks 10."""

    def __init__(self, hand_mass: float = 0.73, pace: float = SLOW, protocol: int = 10):
        environment = {key: value for key, value in os.environ.items() if key not in OF_ROS}
        self._errors = tempfile.TemporaryFile()
        self.process = subprocess.Popen(
            [
                str(SIMULATOR),
                str(Path(__file__).with_name("protocol_server.py")),
                *map(str, (hand_mass, pace, protocol)),
            ],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
        )
        self._buffer = b""
        self.hostname = self._read()["hostname"]
        # A robot has a computer of its own: what else runs here is not to look like one that went away.
        with suppress(OSError):
            os.sched_setscheduler(self.process.pid, os.SCHED_FIFO, os.sched_param(ROBOT_PRIORITY))
        if os.sched_getscheduler(0) == os.SCHED_FIFO:
            os.sched_setaffinity(self.process.pid, ROBOT_CORES)

    def request(self, line: str) -> dict:
        """Send one request, and its answer."""
        self.process.stdin.write(line.encode() + b"\n")
        self.process.stdin.flush()
        return self._read()

    def freeze(self) -> None:
        """Stop the robot's clock: it answers nobody."""
        self.process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Go on."""
        self.process.send_signal(signal.SIGCONT)

    def close(self) -> None:
        """End the process."""
        self.process.kill()  # it may be frozen
        self.process.wait()
        for file in (self.process.stdin, self.process.stdout, self._errors):
            file.close()

    def _read(self) -> dict:
        deadline = time.monotonic() + TIMEOUT
        while b"\n" not in self._buffer:
            left = max(0.0, deadline - time.monotonic())
            ready, _, _ = select.select([self.process.stdout], [], [], left)
            received = os.read(self.process.stdout.fileno(), 65536) if ready else b""
            if not received:
                words = self._last_words()
                self.close()
                raise RuntimeError(f"the simulated robot {'ended' if ready else 'said nothing'}: {words}")
            self._buffer += received
        line, _, self._buffer = self._buffer.partition(b"\n")
        return json.loads(line)

    def _last_words(self) -> str:
        """The end of what it wrote to its standard error."""
        self._errors.seek(0)
        return self._errors.read()[-1000:].decode(errors="replace").strip()


@contextmanager
def urgent(priority: int = TEST_PRIORITY):
    """Real-time priority, where it is permitted, for this thread and whatever it starts meanwhile.

    For measurements: two cores are then nobody else's.
    """
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


@contextmanager
def simulated_robot(**arguments):
    """A simulated robot, and the parameters that lead the driver to it."""
    robot = SimulatedRobot(**arguments)
    try:
        yield (
            robot,
            {
                "hostname": robot.hostname,
                "realtime": "ignore",
                "calibration": "none",
                "realtime_priority": DRIVER_PRIORITY if os.sched_getscheduler(0) == os.SCHED_FIFO else 0,
            },
        )
    finally:
        robot.close()
