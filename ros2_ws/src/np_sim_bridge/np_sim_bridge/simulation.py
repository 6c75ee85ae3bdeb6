"""The MuJoCo Panda with its object, one control period at a time. No ROS.

The simulated arm behaves as the real one does at its torque interface: it compensates its own gravity, so
torques in and out are without gravity. Everything is a function of (domain, seed, episode number, torques).
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.domains import Domain, Pose, sample_task
from np_description.panda import FINGER_MAX, FINGER_SPEED, JOINT_NAMES, STATE_NAMES
from np_description.scene import OBJECT, load_model
from np_effects.arm_effects import ArmEffects
from np_effects.patch import Patch
from np_sim_bridge.schedule import PERIOD, SECOND

_TRAVEL = FINGER_SPEED * PERIOD / SECOND  # m of a finger in a period, at most


@dataclass(frozen=True)
class Measurement:
    """What the encoders and torque sensors say at `stamp` ns: seven joints, then two fingers.

    position (9,) rad, m; velocity (9,) rad/s, m/s; effort (9,) Nm, N: what the drives gave during the period
    that ends at the stamp, without gravity.
    """

    stamp: int
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray


@dataclass(frozen=True)
class Task:
    """One episode's task: its number, and the object's start and goal pose in the base frame."""

    episode: int
    start: Pose
    goal: Pose


class Simulation:
    """The arm at its ready posture and the object at the start of the task, at stamp 0, until stepped.

    seed: together with an episode number it names a task; first_episode: the task that stands there at the
    beginning; substeps: physics steps in a control period of 2 ms; camera: the one in the scene; patch: effects
    that the nominal arm lacks.
    """

    def __init__(
        self,
        domain: Domain,
        *,
        seed: int = 0,
        first_episode: int = 0,
        substeps: int = 1,
        camera: Camera = CAMERA,
        patch: Patch = Patch(),
    ):
        self.domain = domain
        self.model = load_model(domain, timestep=PERIOD / SECOND / substeps, camera=camera, panda=patch.panda())
        self._patch = patch
        self._data = mujoco.MjData(self.model)
        self._seed, self._substeps = seed, substeps
        joints = [self.model.joint(name) for name in STATE_NAMES]
        self._position = np.array([joint.qposadr[0] for joint in joints])
        self._velocity = np.array([joint.dofadr[0] for joint in joints])
        self._motors = np.array([self.model.actuator(name).id for name in JOINT_NAMES])
        self._fingers = np.array([self.model.actuator(name).id for name in STATE_NAMES[len(JOINT_NAMES) :]])
        self._object = int(self.model.joint(OBJECT).qposadr[0])
        self.stamp = 0
        self.reset(first_episode, 0)

    def reset(self, episode: int, stamp: int) -> Task:
        """Draw the task of `episode`, put arm and object there at rest, fingers closed, at the time `stamp` ns.

        The state depends on (seed, episode) only. Raises ValueError for a stamp before the present one.
        """
        if stamp < self.stamp:
            raise ValueError(f"reset: time never runs backwards; it is {self.stamp} ns, got {stamp} ns")
        start, goal = sample_task(self.domain, np.random.default_rng([self._seed, episode]))
        mujoco.mj_resetDataKeyframe(self.model, self._data, self.model.key("ready").id)
        self._data.qpos[self._object : self._object + 7] = [*start.position, *start.quaternion]
        self._data.qfrc_applied[:] = 0.0
        self._opening = 0.0
        self._effects = ArmEffects(self._patch, PERIOD / SECOND, self._seed) if self._patch.effects else None
        self._measured: Measurement | None = None
        self.stamp = stamp
        self.task = Task(episode, start, goal)
        return self.task

    def measure(self) -> Measurement:
        """Joint positions, velocities and torques of the present state."""
        data = self._data
        if self._effects is None:
            return Measurement(
                self.stamp, data.qpos[self._position], data.qvel[self._velocity], data.qfrc_actuator[self._velocity]
            )
        if self._measured is None or self._measured.stamp != self.stamp:  # sensors with a memory are read once
            position, velocity, effort = (
                values.copy()
                for values in (data.qpos[self._position], data.qvel[self._velocity], data.qfrc_actuator[self._velocity])
            )
            position[:7], velocity[:7], effort[:7] = self._effects.sense(position[:7], velocity[:7], effort[:7])
            self._measured = Measurement(self.stamp, position, velocity, effort)
        return self._measured

    @property
    def held_back(self) -> tuple[str, ...]:
        """Where the patch asks for less than is physical, a line for each."""
        return tuple(self._patch.held_back())

    @property
    def ignored_effects(self) -> tuple[str, ...]:
        """Effects of the patch that a backend cannot carry."""
        return self._effects.ignored if self._effects else ()

    def object_pose(self) -> Pose:
        """True pose of the object in the base frame."""
        pose = self._data.qpos[self._object : self._object + 7].copy()
        return Pose(pose[:3], pose[3:])

    def configuration(self) -> np.ndarray:
        """Generalised positions (nq,) of the whole scene, for the renderer."""
        return self._data.qpos.copy()

    def set_fingers(self, opening: float) -> None:
        """Move each finger to `opening` m, at the hand's speed. Raises ValueError outside 0 .. FINGER_MAX."""
        if not 0 <= opening <= FINGER_MAX:
            raise ValueError(f"gripper opening: expected 0 .. {FINGER_MAX} m, got {opening}")
        self._opening = opening

    def step(self, torque: np.ndarray) -> None:
        """Advance by one period with the joint torque (7,) Nm, without gravity, held constant.

        Raises FloatingPointError if the physics diverged, naming MuJoCo's warning.
        """
        if self._effects is not None:
            torque = self._effects.drive(torque)
            joints = self._velocity[: len(JOINT_NAMES)]
            self._data.qfrc_applied[joints] = self._effects.extra(
                self._data.qpos[self._position[: len(JOINT_NAMES)]], self._data.qvel[joints]
            )
        self._data.ctrl[self._motors] = torque
        self._data.ctrl[self._fingers] += np.clip(self._opening - self._data.ctrl[self._fingers], -_TRAVEL, _TRAVEL)
        mujoco.mj_step(self.model, self._data, self._substeps)
        self.stamp += PERIOD
        for warning in (
            mujoco.mjtWarning.mjWARN_BADQPOS,
            mujoco.mjtWarning.mjWARN_BADQVEL,
            mujoco.mjtWarning.mjWARN_BADQACC,
        ):
            # MuJoCo answers these by resetting the scene to its default, which would pass for a measurement.
            if self._data.warning[warning].number:
                raise FloatingPointError(f"simulation diverged at {self.stamp} ns: {warning.name}")
