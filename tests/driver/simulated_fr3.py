"""franky-sim's FR3 without the bookkeeping that no client here reads. In the simulator's own environment.

The original brings desired poses, elbow, twists and their filtered derivatives up to date in every cycle, in
Python, and packs each field of a state by itself. That is most of what its cycle costs, and this driver reads
none of it. Physics, gravity compensation, hold and wire format stay the simulator's.
"""

from __future__ import annotations

import struct

import numpy as np
import pinocchio as pin
from franky_sim.base_simulator import InnerRobotState
from franky_sim.constants import FRANKA_HAND_FORCE_LIMIT
from franky_sim.franka_robot_state import FrankaRobotState
from franky_sim.mujoco_simulator import FrankaMujocoRobot

# Where in a packed state the fields lie that change: franka_robot_state.py, FrankaRobotState.pack_state.
JOINTS = 4 * 126, struct.Struct("<49f"), ("tau_J", "tau_J_d", "dtau_J", "q", "q_d", "dq", "dq_d")
MOTORS = 4 * 270, struct.Struct("<14f"), ("theta", "dtheta")
MODES = 4 * 320, struct.Struct("<85Bf")


class State(FrankaRobotState):
    """A state of which a changed copy costs a twentieth, and the packing a tenth."""

    def replace(self, **changes) -> State:
        """A copy with these fields changed."""
        state = object.__new__(State)
        vars(state).update(vars(self), **changes)
        return state

    def template(self) -> State:
        """The state whose copies are packed by changing this one's bytes."""
        return self.replace(packed=bytearray(super().pack_state()))

    def pack_state(self) -> bytearray:
        """What the original packs, for a copy of a template that differs in the fields above only."""
        packed = self.packed.copy()
        for offset, layout, names in (JOINTS, MOTORS):
            layout.pack_into(packed, offset, *(number for name in names for number in getattr(self, name)))
        offset, layout = MODES
        layout.pack_into(
            packed,
            offset,
            self.motion_generator_mode,
            self.controller_mode,
            *self.errors,
            *self.reflex_reason,
            self.robot_mode,
            self.control_command_success_rate,
        )
        return packed

    def check(self) -> None:
        """Whether this package's layout is the one above. Raises ValueError."""
        probe = self.replace(
            **{name: tuple(np.random.rand(7)) for _, _, names in (JOINTS, MOTORS) for name in names},
            errors=41 * (True,),
            control_command_success_rate=0.5,
        )
        if probe.pack_state() != super(State, probe).pack_state():
            raise ValueError("a packed state is not laid out as expected: another franky-sim than required?")


class SimulatedFr3(FrankaMujocoRobot):
    """told (7,): Nm, the torque without gravity that was commanded last, by whomever."""

    told: np.ndarray = np.zeros(7)

    def _attach_to_scene(self, model, data, prefix) -> None:
        super()._attach_to_scene(model, data, prefix)
        self._least, self._most = self.torque_limit_low, self.torque_limit_high
        super().torque_control(np.zeros(7))
        super()._post_step()
        self._constant = State(**vars(super().state)).template()  # of which the masses and frames stay
        self._constant.check()
        self._fingers = list(zip(self._finger_qpos_addrs, self._finger_dof_addrs))

    def torque_control(self, torques, has_new_command=True) -> None:
        self.told = np.asarray(torques)
        model, data = self._BaseRobot__model, self._BaseRobot__data
        q = self._data.qpos[self._qpos_addrs]
        lawful = np.minimum(np.maximum(self.told, self._least), self._most)
        self._torque_control(lawful + pin.computeGeneralizedGravity(model, data, q))

    def _pre_step(self) -> None:
        """The fingers' controller, in numbers instead of arrays of two."""
        data, most = self._data, min(self._hand_goal_force, FRANKA_HAND_FORCE_LIMIT)
        stiffness, damping = float(self._kp_hand[0]), float(self._kv_hand[0])
        for position, speed in self._fingers:
            q, dq = float(data.qpos[position]), float(data.qvel[speed])
            force = stiffness * (self._hand_goal_width / 2 - q) - damping * dq
            if abs(dq) > self._hand_goal_velocity and dq * force > 0:
                force = -damping * dq
            data.qfrc_applied[speed] = min(max(force, -most), most)

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
            q=inner.q,
            dq=inner.dq,
            theta=inner.q,
            dtheta=inner.dq,  # gears and links that do not bend
            q_d=inner.q,
            dq_d=inner.dq,
            tau_J=inner.tau_j,
            tau_J_d=self.told,
        )
