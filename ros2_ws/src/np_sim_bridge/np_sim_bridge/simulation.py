"""The simulated Panda with its object, one control period at a time, in any engine. No ROS.

The simulated arm behaves as the real one does at its torque interface: it compensates its own gravity, so
torques in and out are without gravity. Everything is a function of (engine, domain, seed, episode number, torques).
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from sim2real.effects.arm_effects import ArmEffects
from sim2real.effects.patch import Patch

from np_control.external_force import ForceObserver
from np_control.force_watch import ForceWatch
from np_description.camera import CAMERA, Camera
from np_description.domains import Pose, Task, sample_task
from np_description.engine import MakeEngine
from np_description.force_reflex import DEFAULT_MODE
from np_description.mujoco_engine import MujocoEngine
from np_description.objects.scenarios import make_fixed_task
from np_description.panda import FINGER_MAX, FINGER_SPEED
from np_sim_bridge.schedule import PERIOD, SECOND

_TRAVEL = FINGER_SPEED * PERIOD / SECOND  # m of a finger in a period, at most
_NOTHING = np.zeros(7)  # Nm


@dataclass(frozen=True)
class Measurement:
    """One sample of encoders and torque sensors: seven joints, then two fingers."""

    stamp: int
    """ns."""
    position: np.ndarray
    """(9,) rad, m."""
    velocity: np.ndarray
    """(9,) rad/s, m/s."""
    effort: np.ndarray
    """Drive torque without gravity during the period that ends at the stamp (9,) Nm, N."""


@dataclass(frozen=True)
class EpisodeTask:
    """One episode's task, in the base frame."""

    episode: int
    """Number."""
    start: Pose
    """The object's pose."""
    goal: Pose
    """The goal pose."""


class Simulation:
    """The arm at its ready posture and the object at the start of the task, at stamp 0, until stepped.

    seed: together with an episode number it names a task; scenario: a fixed one instead, of which they name the scatter, 0 for
    none (np_description.objects.scenarios); first_episode: the task that stands there at the
    beginning; substeps: physics steps in a control period of 2 ms; camera: the one in the scene; patch: effects
    that nominal arm and scene lack; engine: builds the physics; force_reflex: stop or observe.

    `force` follows the external force that the robot would estimate, and `reflex` is the reason to stop the arm, "" for none:
    the owner of the guards makes a fault of it.
    """

    def __init__(
        self,
        domain: Task,
        *,
        scenario: int = 0,
        seed: int = 0,
        first_episode: int = 0,
        substeps: int = 1,
        camera: Camera = CAMERA,
        patch: Patch = Patch(),
        engine: MakeEngine = MujocoEngine,
        force_reflex: str = DEFAULT_MODE,
    ):
        self.domain = domain
        self._change = patch.scene_change()
        self.engine = engine(domain, substeps=substeps, camera=camera, panda=patch.panda(), change=self._change)
        self._patch, self._seed, self._scenario = patch, seed, scenario
        self._observer, self.force = ForceObserver(PERIOD / SECOND, patch.panda()), ForceWatch(force_reflex)
        self.stamp = 0
        self.reset(first_episode, 0)

    @property
    def model(self) -> mujoco.MjModel:
        """The scene, for the renderer."""
        return self.engine.model

    def reset(self, episode: int, stamp: int) -> EpisodeTask:
        """Draw the task of `episode`, put arm and object there at rest, fingers closed, at the time `stamp` ns.

        The state depends on (seed, episode) only. Raises ValueError for a stamp before the present one.
        """
        if stamp < self.stamp:
            raise ValueError(f"reset: time never runs backwards; it is {self.stamp} ns, got {stamp} ns")
        rng = np.random.default_rng([self._seed, episode])
        if self._scenario:
            start, goal = make_fixed_task(self.domain, self._scenario, rng)
        else:
            start, goal = sample_task(self.domain, rng)
        self.engine.reset(self._change.pose(start))
        self._opening = self._led = 0.0  # m: where the fingers shall be, and how far they have been led
        self._effects = ArmEffects(self._patch, PERIOD / SECOND, self._seed) if self._patch.arm.effects else None
        self._measured: Measurement | None = None
        self._observer.reset()
        self.force.reset()
        self.reflex = ""
        self.stamp = stamp
        self.task = EpisodeTask(episode, start, goal)
        return self.task

    def measure(self) -> Measurement:
        """Joint positions, velocities and torques of the present state."""
        if self._effects is None:
            return Measurement(self.stamp, *self.engine.joints())
        if self._measured is None or self._measured.stamp != self.stamp:  # sensors with a memory are read once
            position, velocity, effort = self.engine.joints()
            position[:7], velocity[:7], effort[:7] = self._effects.sense(
                position[:7].copy(), velocity[:7].copy(), effort[:7].copy()
            )
            self._measured = Measurement(self.stamp, position, velocity, effort)
        return self._measured

    @property
    def wrench(self) -> np.ndarray:
        """Filtered external wrench (6,) N, Nm on the hand as the robot estimates it, about T_E, base axes."""
        return self._observer.last.wrench

    @property
    def held_back(self) -> tuple[str, ...]:
        """The parameters of the patch that are below the physical minimum, a line for each."""
        return tuple(self._patch.list_clipped_parameters())

    @property
    def ignored_effects(self) -> tuple[str, ...]:
        """Effects of the patch that a backend cannot carry."""
        return self._effects.ignored if self._effects else ()

    def object_pose(self) -> Pose:
        """True pose of the object in the base frame."""
        return self.engine.object_pose()

    def configuration(self) -> np.ndarray:
        """Generalised positions (nq,) of the whole scene, for the renderer."""
        return self.engine.configuration()

    def set_fingers(self, opening: float) -> None:
        """Move each finger to `opening` m, at the hand's speed. Raises ValueError outside 0 .. FINGER_MAX."""
        if not 0 <= opening <= FINGER_MAX:
            raise ValueError(f"gripper opening: expected 0 .. {FINGER_MAX} m, got {opening}")
        self._opening = opening

    def step(self, torque: np.ndarray) -> None:
        """Advance by one period with the joint torque (7,) Nm, without gravity, held constant.

        Raises FloatingPointError if the physics diverged, with the engine's message.
        """
        extra = friction = _NOTHING
        position, velocity, _ = self.engine.joints()
        q, dq = position[:7], velocity[:7]
        if self._effects is not None:
            torque = self._effects.drive(torque, q)
            extra = self._effects.extra(q, dq)
            friction = self._effects.friction
        self._led += min(max(self._opening - self._led, -_TRAVEL), _TRAVEL)
        self.stamp += PERIOD
        try:
            self.engine.step(torque, extra, self._led)
        except FloatingPointError as error:
            raise FloatingPointError(f"simulation diverged at {self.stamp} ns: {error}") from error
        _, velocity, effort = self.engine.joints()
        estimate = self._observer.update(q, dq, velocity[:7], effort[:7] - friction)
        self.reflex = self.force.add(estimate, self.engine.pressing)
