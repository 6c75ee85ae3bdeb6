"""The connection to the robot: libfranka's protocol through `pylibfranka`, and nothing else of this project.

Every call of pylibfranka keeps Python's interpreter lock while it waits, so that one thread does all: the
robot's next state paces it.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import monotonic

import numpy as np
import pylibfranka as franka

from np_control.safety import SafetyLimits
from np_franka.checklist import Facts
from np_franka.limits import Collision

MILLISECOND = 1_000_000
SETTLING = 0.5  # s
UPRIGHT = [0.0, 0.0, -9.81]  # m/s^2, gravity in the frame of a base that stands on the table


class ArmError(OSError):
    """What the robot refused or reported, or how the connection broke, in one line."""


@dataclass(frozen=True, eq=False)
class Reading:
    """One state of the robot.

    time: ns on the robot's clock, whole milliseconds. q (7,) rad, dq (7,) rad/s: joint side; torque (7,) Nm:
    measured at the joints, without gravity; theta (7,) rad, dtheta (7,) rad/s: motor side; commanded (7,) Nm:
    the torque that the drives were told, without gravity. mode, errors: the robot's own words, errors empty
    if it has none. success_rate: share of the last 100 commands that came in time, 0..1.
    """

    time: int
    q: np.ndarray
    dq: np.ndarray
    torque: np.ndarray
    theta: np.ndarray
    dtheta: np.ndarray
    commanded: np.ndarray
    mode: str
    errors: str
    success_rate: float


class Arm:
    """One robot. `is_connected`: states come; `is_controlled`: it takes torques.

    A robot that aborts the motion (a reflex, lost commands, the user stop) is connected but not controlled
    any more. Every method raises ArmError.
    """

    def __init__(self, hostname: str, limits: SafetyLimits, collision: Collision, *, enforce_realtime: bool):
        self.hostname = hostname
        self._limits, self._collision = limits, collision
        self._config = franka.RealtimeConfig.kEnforce if enforce_realtime else franka.RealtimeConfig.kIgnore
        self._robot: franka.Robot | None = None
        self._model: franka.Model | None = None
        self._control: franka.ActiveControlBase | None = None

    @property
    def is_connected(self) -> bool:
        """Whether states come."""
        return self._robot is not None

    @property
    def is_controlled(self) -> bool:
        """Whether the robot takes torques."""
        return self._control is not None

    def connect(self) -> None:
        """Open the connection and set the collision thresholds. Does not move the arm."""
        self._drop()
        with _translating(self):
            self._robot = franka.Robot(self.hostname, self._config)
            self._model = self._robot.load_model()
            torques, wrench = self._collision.torques(self._limits), self._collision.wrench()
            self._robot.set_collision_behavior(torques / 2, torques, wrench / 2, wrench)

    def facts(self) -> Facts:
        """What the robot says of itself before it is moved."""
        deadline = monotonic() + SETTLING  # the states on their way may be older than the last recovery
        while True:
            with _translating(self):
                state = self._connection().read_once()
            if state.robot_mode == franka.RobotMode.Idle or monotonic() > deadline:
                break
        return Facts(state.robot_mode.name, str(state.current_errors) if state.current_errors else "",
                     state.m_ee, state.m_load)

    def start(self) -> None:
        """Begin to take torques: from now on every `read` must be followed by a `write`."""
        with _translating(self):
            self._control = self._connection().start_torque_control()

    def read(self) -> Reading:
        """Wait for the next state."""
        with _translating(self):
            state = self._control.readOnce()[0] if self._control else self._connection().read_once()
            state.O_ddP_O = UPRIGHT  # in place of the accelerometer's noise
            gravity = np.array(self._model.gravity(state))
        return Reading(
            round(state.time.to_sec() * 1000) * MILLISECOND, np.array(state.q), np.array(state.dq),
            np.array(state.tau_J) - gravity, np.array(state.theta), np.array(state.dtheta),
            np.array(state.tau_J_d), state.robot_mode.name,
            str(state.current_errors) if state.current_errors else "", state.control_command_success_rate)

    def write(self, torque: np.ndarray, *, last: bool = False) -> None:
        """Answer the state just read with torque (7,) Nm, without gravity; the last one ends the motion."""
        torques = franka.Torques(torque.tolist())
        torques.motion_finished = last
        with _translating(self):
            self._control.writeOnce(torques)
        if last:
            self._control = None

    def clear_errors(self) -> None:
        """Let the robot recover from its reflexes; it does not move."""
        with _translating(self):
            self._connection().automatic_error_recovery()

    def close(self) -> None:
        """Leave the robot, which then holds itself."""
        self._drop()

    def _connection(self) -> franka.Robot:
        if self._robot is None:
            raise ArmError(f"not connected to {self.hostname}")
        return self._robot

    def _drop(self) -> None:
        self._control = self._model = self._robot = None


class _translating:
    """Turns pylibfranka's exceptions into ArmError, and notes what is left of the connection."""

    def __init__(self, arm: Arm):
        self._arm = arm

    def __enter__(self) -> None:
        pass

    def __exit__(self, _type, error, _traceback) -> None:
        if isinstance(error, franka.NetworkException):
            self._arm._drop()
            raise ArmError(f"connection to {self._arm.hostname}: {error}") from error
        if isinstance(error, franka.ControlException):
            self._arm._control = None
            raise ArmError(f"the robot aborted the motion: {error}") from error
        if isinstance(error, (RuntimeError, franka.FrankaException)):
            raise ArmError(f"{type(error).__name__}: {error}") from error
