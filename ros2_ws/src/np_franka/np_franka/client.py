"""What the driver requires of a client of the robot's protocol, whichever package it comes from. No ROS."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Protocol

import numpy as np

from np_franka.checklist import RobotFacts

MILLISECOND = 1_000_000  # ns
ROBOT_OF_PROTOCOL = {3: "panda", 4: "panda", 5: "panda", **dict.fromkeys(range(6, 11), "fr3")}
"""Which robot uses which version of the research interface: Franka's compatibility matrix."""
_VERSIONS = re.compile(r"server version: (\d+), library version: (\d+)")


class ArmError(OSError):
    """What the robot refused or reported, or how the connection broke, in one line."""


class ConnectionLost(ArmError):
    """The connection is gone."""


class MotionAborted(ArmError):
    """The robot ended the motion; states still come."""


@dataclass(frozen=True, eq=False)
class ArmReading:
    """One state of the robot.

    time: ns on the robot's clock, whole milliseconds. q (7,) rad, dq (7,) rad/s: joint side; torque (7,) Nm:
    measured at the joints, without gravity; theta (7,) rad, dtheta (7,) rad/s: motor side, None where the
    client does not report it; commanded (7,) Nm: the torque commanded to the drives, without gravity; wrench
    (6,) N, Nm: the robot's own estimate of the external one (O_F_ext_hat_K), base axes, about the stiffness
    frame, which is the end effector's unless it was set otherwise. mode, errors: as the robot names them, errors
    empty if it has none. success_rate: share of the last 100 commands that came in time, 0..1.
    """

    time: int
    q: np.ndarray
    dq: np.ndarray
    torque: np.ndarray
    theta: np.ndarray | None
    dtheta: np.ndarray | None
    commanded: np.ndarray
    wrench: np.ndarray
    mode: str
    errors: str
    success_rate: float


class Client(Protocol):
    """A connection to one robot, made by the constructor. Every method raises ArmError.

    Python's interpreter lock is kept while a state is waited for, so that one thread does all: the robot's
    next state paces it.
    """

    def set_collision_behavior(self, torques: np.ndarray, wrench: np.ndarray) -> None:
        """Stop at external torques (7,) Nm of the joints, or at a wrench (6,) N, Nm at the hand."""

    def facts(self) -> RobotFacts:
        """What the robot reports in the next state, while it is not controlled."""

    def start(self) -> None:
        """Begin to take torques."""

    def read(self) -> ArmReading:
        """Wait for the next state."""

    def write(self, torque: np.ndarray, last: bool) -> None:
        """Reply to the state just read with torque (7,) Nm, without gravity; the last one ends the motion."""

    def clear_errors(self) -> None:
        """Let the robot recover from its reflexes; it does not move."""

    def close(self) -> None:
        """Leave the robot, which then holds itself; never raises."""


def translate_errors(method: Callable) -> Callable:
    """A method of a client that raises what its `translate` makes of its package's `errors`."""

    @wraps(method)
    def call(self, *arguments, **named):
        try:
            return method(self, *arguments, **named)
        except self.errors as error:
            raise self.translate(error) from error

    return call


def mismatch(robot: str, package: str, hostname: str, error: Exception) -> ArmError | None:
    """The error for a robot with another version of the protocol than the package chosen by `robot`: it names
    both; None where `error` is something else."""
    if hasattr(error, "server_version"):  # panda_py's own
        server, library = error.server_version, error.library_version
    elif found := _VERSIONS.search(str(error)):  # libfranka's message
        server, library = map(int, found.groups())
    else:
        return None
    spoken = ROBOT_OF_PROTOCOL.get(server, "")
    advice = f"set robot:={spoken}" if spoken not in ("", robot) else f"install the {package} of its version"
    kind = f"of robot:={spoken}" if spoken else "unknown"
    return ArmError(
        f"robot:={robot}: {package} speaks version {library} of the protocol, the robot at "
        f"{hostname} version {server} ({kind}): {advice}"
    )
