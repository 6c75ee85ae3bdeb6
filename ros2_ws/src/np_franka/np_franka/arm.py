"""The connection to the robot and what is left of it when something breaks. No ROS."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic

import numpy as np

from np_franka.checklist import READY_MODE, RobotFacts
from np_franka.client import ArmError, ArmReading, Client, ConnectionLost, MotionAborted

SETTLING = 0.5  # s that states on their way may be older than the last recovery


class FrankaArm:
    """One robot, as `open_client` connects to it. `is_connected`: states come; `is_controlled`: it takes
    torques.

    A robot that aborts the motion (a reflex, lost commands, the user stop) is connected but not controlled
    any more. collision: torques (7,) Nm and wrench (6,) N, Nm at which it stops itself. Every method raises
    ArmError.
    """

    def __init__(self, open_client: Callable[[], Client], torques: np.ndarray, wrench: np.ndarray):
        self._open, self._thresholds = open_client, (torques, wrench)
        self._client: Client | None = None
        self.is_controlled = False

    @property
    def is_connected(self) -> bool:
        """Whether states come."""
        return self._client is not None

    def connect(self) -> None:
        """Open the connection and set the collision thresholds. Does not move the arm."""
        self.close()
        self._client = self._open()
        self._ask("set_collision_behavior", *self._thresholds)

    def facts(self) -> RobotFacts:
        """What the robot reports before it is moved."""
        deadline = monotonic() + SETTLING
        while (facts := self._ask("facts")).mode != READY_MODE and monotonic() < deadline:
            pass
        return facts

    def start(self) -> None:
        """Begin to take torques: from now on every `read` must be followed by a `write`."""
        self._ask("start")
        self.is_controlled = True

    def read(self) -> ArmReading:
        """Wait for the next state."""
        return self._ask("read")

    def write(self, torque: np.ndarray, *, last: bool = False) -> None:
        """Reply to the state just read with torque (7,) Nm, without gravity; the last one ends the motion."""
        self._ask("write", torque, last)
        self.is_controlled = not last

    def clear_errors(self) -> None:
        """Let the robot recover from its reflexes; it does not move."""
        self._ask("clear_errors")

    def close(self) -> None:
        """Leave the robot, which then holds itself."""
        client, self._client, self.is_controlled = self._client, None, False
        if client is not None:
            client.close()

    def _ask(self, method: str, *arguments: object) -> object:
        """Call the client, and note what is left of the connection."""
        if self._client is None:
            raise ArmError("not connected to the robot")
        try:
            return getattr(self._client, method)(*arguments)
        except ConnectionLost:
            self.close()
            raise
        except MotionAborted:
            self.is_controlled = False
            raise
