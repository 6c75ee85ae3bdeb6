"""The original Panda through `panda_py` (libfranka 0.9, protocol 5), for which no simulated robot exists.

This libfranka calls back instead of being read and written (`np_franka.callback_loop`). The package raises
RuntimeError for everything, and reports nothing of the motor side.
"""

from __future__ import annotations

import numpy as np
from panda_py import libfranka as franka

from np_franka.callback_loop import CallbackLoopAdapter
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

PACKAGE = "panda_py"
NO_FILTER = 1000.0  # Hz: libfranka's kMaxCutoffFrequency, from which on it filters nothing
ERRORS = (RuntimeError,)
Gripper = franka.Gripper


class PandaClient:
    """See `np_franka.client.Client`."""

    errors = (*ERRORS, TimeoutError)

    @translate_errors
    def __init__(self, hostname: str, *, enforce_realtime: bool):
        self._hostname = hostname
        realtime = franka.RealtimeConfig.kEnforce if enforce_realtime else franka.RealtimeConfig.kIgnore
        self._robot: franka.Robot | None = None
        self._control: CallbackLoopAdapter | None = None
        self._robot = franka.Robot(hostname, realtime)
        self._model = self._robot.load_model()

    @translate_errors
    def set_collision_behavior(self, torques: np.ndarray, wrench: np.ndarray) -> None:
        """Stop at external torques (7,) Nm, or at a wrench (6,) N, Nm; contact is reported from half of it on."""
        self._robot.set_collision_behavior(*(values.tolist() for values in (torques / 2, torques, wrench / 2, wrench)))

    @translate_errors
    def facts(self) -> RobotFacts:
        """What the robot reports."""
        state = self._robot.read_once()
        return RobotFacts(_mode(state), _words(state.current_errors), state.m_ee, state.m_load)

    def start(self) -> None:
        """Begin to take torques, as they are: neither filtered nor limited in rate by the client."""
        self._control = CallbackLoopAdapter(
            lambda callback: self._robot.control(callback, limit_rate=False, cutoff_frequency=NO_FILTER)
        )

    @translate_errors
    def read(self) -> ArmReading:
        """Wait for the next state."""
        state = self._control.read() if self._control else self._robot.read_once()
        gravity = np.array(self._model.gravity(state))  # of an upright base, by default
        return ArmReading(
            round(state.time.to_sec() * 1000) * MILLISECOND,
            np.array(state.q),
            np.array(state.dq),
            np.array(state.tau_J) - gravity,
            None,
            None,
            np.array(state.tau_J_d),
            np.array(state.O_F_ext_hat_K),
            _mode(state),
            _words(state.current_errors),
            state.control_command_success_rate,
        )

    @translate_errors
    def write(self, torque: np.ndarray, last: bool) -> None:
        """Reply to the state just read; the last torque ends the motion."""
        torques = franka.Torques(torque.tolist())
        torques.motion_finished = last
        if not last:
            self._control.write(torques)
            return
        self._control.finish(torques)
        self._control = None

    @translate_errors
    def clear_errors(self) -> None:
        """Let the robot recover from its reflexes."""
        self._robot.automatic_error_recovery()

    def close(self) -> None:
        """End the motion, if there is one."""
        if self._control is not None:
            self._control.abandon()
            self._control = None

    def translate(self, error: Exception) -> ArmError:
        """What an error means: panda_py distinguishes them by text only; a TimeoutError of the callback loop is a lost connection."""
        if isinstance(error, TimeoutError):
            return ConnectionLost(f"connection to {self._hostname}: {error}")  # `close` then ends the motion
        was_controlled, self._control = self._control is not None, None
        if refusal := mismatch("panda", PACKAGE, self._hostname, error):
            return refusal
        if not self._answers():
            return ConnectionLost(f"connection to {self._hostname}: {error}")
        if was_controlled:
            return MotionAborted(f"the robot aborted the motion: {error}")
        return ArmError(f"{self._hostname}: {error}")

    def _answers(self) -> bool:
        """Whether states still come."""
        if self._robot is None:
            return False
        try:
            self._robot.read_once()
        except RuntimeError:
            return False
        return True


def _mode(state: franka.RobotState) -> str:
    return state.robot_mode.name.removeprefix("k")


def _words(errors: franka.Errors) -> str:
    return str(errors) if errors else ""
