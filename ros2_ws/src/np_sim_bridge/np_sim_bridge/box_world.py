"""A box on a table, perhaps beside a wall, and one finger, in MuJoCo: the smallest world in which contact is held against rigid theory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np

from np_description.contact.model import OBJECT_FRICTION, ContactModel
from np_description.domains import Pose
from np_description.scene import set_friction_law, surface_options

GRAVITY = 9.81
TIP_RADIUS = 0.008  # m, of the fingertip's capsule
STEP = 0.002  # s, the bridge's


@dataclass(frozen=True)
class BoxOnTable:
    """A box on a table, with or without a finger that pushes it."""

    half_size: tuple[float, float, float]
    """(3,) m."""
    mass: float
    """kg."""
    tip: tuple[float, float, float] | None = None
    """Where the finger starts (3,) m; None: no finger."""
    pressing: tuple[int, float] | None = None
    """Axis (0 to 2) and sign along which a force pushes the finger; None: it is led along all three axes."""
    beside_wall: bool = False
    """Whether the box touches a fixed wall with its face towards +x."""


DOWNWARDS, FORWARDS = (2, -1.0), (0, 1.0)
WALL_HALF_SIZE = (0.08, 0.3, 0.3)  # m


def wall_position(world: BoxOnTable) -> tuple[float, float, float]:
    """Centre of the wall (3,) m."""
    return world.half_size[0] + WALL_HALF_SIZE[0], 0.0, WALL_HALF_SIZE[2]


class BoxWorld(Protocol):
    """The interface of an engine for the static bench. The box begins at rest at the origin of the table."""

    def tilt(self, angle: float, heading: float) -> None:
        """Turn gravity by `angle` rad, downhill towards `heading` rad in the table's plane."""

    def pull(self, force: np.ndarray, height: float = 0.0) -> None:
        """Pull the box from now on with a force (3,) N, `height` m above its centre."""

    def lead(self, position: np.ndarray, press: float = 0.0) -> None:
        """Lead the finger to (3,) m; along the axis on which it presses, with `press` N instead."""

    def step(self, seconds: float) -> None:
        """Let time go on."""

    def pose(self) -> Pose:
        """Pose of the box."""

    def velocity(self) -> np.ndarray:
        """Velocity of the box's centre (3,) m/s."""

    def tip(self) -> np.ndarray:
        """Centre of the fingertip's sphere (3,) m."""


class MujocoBoxWorld:
    """A BoxWorld of MuJoCo."""

    def __init__(self, world: BoxOnTable, contact: ContactModel, timestep: float = STEP):
        self._model = _spec(world, contact, timestep).compile()
        self._data = mujoco.MjData(self._model)
        self._pressing = world.pressing
        self._height, self._force = 0.0, np.zeros(3)
        if world.tip is not None:
            self.lead(np.asarray(world.tip))
        mujoco.mj_forward(self._model, self._data)

    def tilt(self, angle: float, heading: float) -> None:
        """As in BoxWorld."""
        downhill = np.sin(angle) * np.array([np.cos(heading), np.sin(heading)])
        self._model.opt.gravity[:] = GRAVITY * np.array([*downhill, -np.cos(angle)])

    def pull(self, force: np.ndarray, height: float = 0.0) -> None:
        """As in BoxWorld."""
        self._force, self._height = np.asarray(force, float), height

    def lead(self, position: np.ndarray, press: float = 0.0) -> None:
        """As in BoxWorld."""
        self._data.ctrl[:3] = np.asarray(position) - self._model.body("finger").pos
        if self._pressing:
            axis, sign = self._pressing
            self._data.ctrl[axis] = sign * press

    def step(self, seconds: float) -> None:
        """As in BoxWorld."""
        body = self._model.body("box").id
        for _ in range(round(seconds / self._model.opt.timestep)):
            lever = self._data.xmat[body].reshape(3, 3) @ [0.0, 0.0, self._height]
            self._data.xfrc_applied[body] = [*self._force, *np.cross(lever, self._force)]
            mujoco.mj_step(self._model, self._data)
        mujoco.mj_forward(self._model, self._data)

    def pose(self) -> Pose:
        """As in BoxWorld."""
        return Pose(self._data.qpos[:3].copy(), self._data.qpos[3:7].copy())

    def velocity(self) -> np.ndarray:
        """As in BoxWorld."""
        return self._data.qvel[:3].copy()

    def tip(self) -> np.ndarray:
        """As in BoxWorld."""
        return self._data.body("finger").xpos.copy()


def _spec(world: BoxOnTable, contact: ContactModel, timestep: float) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    set_friction_law(spec.option, contact)
    spec.worldbody.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], **surface_options(contact.table, contact.hard)
    )
    box = spec.worldbody.add_body(name="box", pos=[0, 0, world.half_size[2]])
    box.add_freejoint()
    box.add_geom(
        name="box",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=world.half_size,
        mass=world.mass,
        **surface_options(OBJECT_FRICTION, contact.hard),
    )
    if world.beside_wall:
        spec.worldbody.add_geom(
            name="wall",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=WALL_HALF_SIZE,
            pos=wall_position(world),
            **surface_options(contact.table, contact.hard),
        )
    if world.tip is None:
        return spec
    finger = spec.worldbody.add_body(name="finger", pos=world.tip, gravcomp=1.0)
    finger.add_geom(
        name="finger",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[TIP_RADIUS, 0, 0],
        mass=0.1,
        priority=1,
        contype=2,
        conaffinity=1,
        **surface_options(contact.finger, contact.rubber),
    )
    spec.geom("box").conaffinity = 3  # the finger touches the box only
    for number, name in enumerate("xyz"):
        joint = finger.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=np.eye(3)[number])
        joint.armature = 1.0  # of the arm behind it
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        if world.pressing and number == world.pressing[0]:
            joint.damping = np.array([50.0, 0, 0])
            actuator.set_to_motor()
        else:
            actuator.set_to_position(kp=1e5, kv=6e2)
    return spec
