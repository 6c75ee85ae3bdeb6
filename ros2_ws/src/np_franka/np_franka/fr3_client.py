"""The FR3 through Franka's own `pylibfranka` (libfranka 0.18 and later, protocol 10)."""

from __future__ import annotations

import numpy as np
import pylibfranka as franka

from np_franka.checklist import RobotFacts
from np_franka.client import (
    MILLISECOND,
    ArmError,
    ArmReading,
    ConnectionLost,
    MotionAborted,
    mismatch,
    translate_errors,
)

PACKAGE = "pylibfranka"
UPRIGHT = [0.0, 0.0, -9.81]  # m/s^2, gravity in the frame of a base that stands on the table
ERRORS = (RuntimeError, franka.FrankaException)
Gripper = franka.Gripper


class Fr3Client:
    """See `np_franka.client.Client`."""

    errors = ERRORS

    @translate_errors
    def __init__(self, hostname: str, *, enforce_realtime: bool):
        self._hostname = hostname
        realtime = franka.RealtimeConfig.kEnforce if enforce_realtime else franka.RealtimeConfig.kIgnore
        self._control: franka.ActiveControlBase | None = None
        self._robot = franka.Robot(hostname, realtime)
        self._model = self._robot.load_model()

    @translate_errors
    def set_collision_behavior(self, torques: np.ndarray, wrench: np.ndarray) -> None:
        """Stop at external torques (7,) Nm, or at a wrench (6,) N, Nm; contact is reported from half of it on."""
        self._robot.set_collision_behavior(torques / 2, torques, wrench / 2, wrench)

    @translate_errors
    def facts(self) -> RobotFacts:
        """What the robot reports."""
        state = self._robot.read_once()
        return RobotFacts(state.robot_mode.name, _words(state.current_errors), state.m_ee, state.m_load)

    @translate_errors
    def start(self) -> None:
        """Begin to take torques."""
        self._control = self._robot.start_torque_control()

    @translate_errors
    def read(self) -> ArmReading:
        """Wait for the next state."""
        state = self._control.readOnce()[0] if self._control else self._robot.read_once()
        state.O_ddP_O = UPRIGHT  # in place of the accelerometer's noise
        gravity = np.array(self._model.gravity(state))
        return ArmReading(
            round(state.time.to_sec() * 1000) * MILLISECOND,
            np.array(state.q),
            np.array(state.dq),
            np.array(state.tau_J) - gravity,
            np.array(state.theta),
            np.array(state.dtheta),
            np.array(state.tau_J_d),
            np.array(state.O_F_ext_hat_K),
            state.robot_mode.name,
            _words(state.current_errors),
            state.control_command_success_rate,
        )

    @translate_errors
    def write(self, torque: np.ndarray, last: bool) -> None:
        """Reply to the state just read; the last torque ends the motion."""
        torques = franka.Torques(torque.tolist())
        torques.motion_finished = last
        self._control.writeOnce(torques)
        if last:
            self._control = None

    @translate_errors
    def clear_errors(self) -> None:
        """Let the robot recover from its reflexes."""
        self._robot.automatic_error_recovery()

    def close(self) -> None:
        """Leave the robot."""
        self._control = self._robot = self._model = None

    def translate(self, error: Exception) -> ArmError:
        """What an error of pylibfranka means."""
        if isinstance(error, franka.NetworkException):
            return ConnectionLost(f"connection to {self._hostname}: {error}")
        if isinstance(error, franka.ControlException):
            self._control = None
            return MotionAborted(f"the robot aborted the motion: {error}")
        return mismatch("fr3", PACKAGE, self._hostname, error) or ArmError(f"{type(error).__name__}: {error}")


def _words(errors: franka.Errors) -> str:
    return str(errors) if errors else ""
