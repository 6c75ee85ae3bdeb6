"""franky-sim's FR3 without the bookkeeping that no client here reads. In the simulator's own environment.

The original brings desired poses, elbow, twists and their filtered derivatives up to date in every cycle, in
Python. That is most of what its cycle costs, and this driver reads none of it. Physics, gravity compensation,
hold and wire format stay the simulator's.
"""

from __future__ import annotations

import copy

import numpy as np
from franky_sim.base_simulator import InnerRobotState
from franky_sim.franka_robot_state import FrankaRobotState
from franky_sim.mujoco_simulator import FrankaMujocoRobot


class State(FrankaRobotState):
    """A state of which a changed copy costs a twentieth."""

    def replace(self, **changes) -> State:
        """A copy with these fields changed."""
        state = copy.copy(self)
        vars(state).update(changes)
        return state


class SimulatedFr3(FrankaMujocoRobot):
    """told (7,): Nm, the torque without gravity that was commanded last, by whomever."""

    told: np.ndarray = np.zeros(7)

    def _attach_to_scene(self, model, data, prefix) -> None:
        super()._attach_to_scene(model, data, prefix)
        self._least, self._most = self.torque_limit_low, self.torque_limit_high
        super().torque_control(np.zeros(7))
        super()._post_step()
        self._constant = State(**vars(super().state))  # of which the masses and frames stay

    def torque_control(self, torques, has_new_command=True) -> None:
        self.told = np.asarray(torques)
        super().torque_control(torques, has_new_command)

    def _torque_control(self, torques) -> None:
        self._applied_torques = np.minimum(np.maximum(torques, self._least), self._most)
        self._data.qfrc_applied[self._dof_addrs] = self._applied_torques

    def _get_state(self) -> InnerRobotState:
        if self._data is None:
            return super()._get_state()
        return InnerRobotState(
            tuple(self._data.qpos[self._qpos_addrs].tolist()),
            tuple(self._data.qvel[self._dof_addrs].tolist()),
            tuple(self._applied_torques.tolist()),
        )

    def _post_step(self) -> None:
        """Nothing is derived from the step."""

    @property
    def state(self) -> State:
        """What goes over the wire."""
        inner = self._get_state()
        return self._constant.replace(
            q=inner.q, dq=inner.dq, theta=inner.q, dtheta=inner.dq,  # gears and links that do not bend
            q_d=inner.q, dq_d=inner.dq, tau_J=inner.tau_j, tau_J_d=self.told)
