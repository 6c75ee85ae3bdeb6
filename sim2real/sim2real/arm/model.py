"""The nominal arm of the diagnosis: a tree of hinges, taken from any MuJoCo model (from a file: `arm.files`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import mujoco
import numpy as np

from np_description.domains import CARD
from np_description.panda import NOMINAL, PANDA, TCP_FRAME
from np_description.scene import load_model

UNLIMITED_TORQUE = 100.0  # Nm, the scale of a joint whose model states no limit
UNLIMITED_SPEED = 10.0  # rad/s, likewise


@dataclass(frozen=True)
class HeldJoint:
    """A joint of the model that is not of the arm, and that the model holds still, although it carries the arm or is carried by it."""

    name: str
    """Its name."""
    reference: float
    """rad or m at which it is held."""
    load: float
    """Nm by which a motion of 1 rad, or 1 m, changes the torques that hold the arm, at most."""


@dataclass(frozen=True, eq=False)
class Arm:
    """Hinges base to tip, n of them; SI units. At the reference angles each joint's frame stands in its parent link's."""

    joints: tuple[str, ...]
    """Names of the joints."""
    parent: np.ndarray
    """(n,), index of the link that carries each joint, -1 for the base."""
    offset: np.ndarray
    """(n, 3) m, origin of the joint's frame in its parent link (the base: in the world)."""
    rotation: np.ndarray
    """(n, 3, 3), orientation of that frame."""
    axis: np.ndarray
    """(n, 3), unit vector in the joint's own frame."""
    reference: np.ndarray
    """(n,) rad, angles at which offset and rotation hold."""
    mass: np.ndarray
    """(n,) kg, of the link and all that hangs rigidly on it."""
    moment: np.ndarray
    """(n, 3) kg m, mass times centre of mass, in the link's frame."""
    inertia: np.ndarray
    """(n, 3, 3) kg m^2 about the joint's origin, axes of the link's frame."""
    tip: np.ndarray
    """(3,) m, tool point in the last link."""
    gravity: np.ndarray
    """(3,) m/s^2 in the world."""
    position_lower: np.ndarray
    """(n,) rad."""
    position_upper: np.ndarray
    """(n,) rad."""
    velocity_limit: np.ndarray
    """(n,) rad/s."""
    torque_limit: np.ndarray
    """(n,) Nm."""
    frictionloss: np.ndarray
    """(n,) Nm, Coulomb friction."""
    damping: np.ndarray
    """(n,) Nms/rad."""
    armature: np.ndarray
    """(n,) kg m^2, inertia of the rotor at the joint."""
    rest: np.ndarray
    """(n,) rad, resting posture."""
    name: str
    """Name of the model, which a patch states."""
    held: tuple[HeldJoint, ...] = ()
    """Other joints of the model that move the arm or are moved by it."""

    def __len__(self) -> int:
        return len(self.joints)

    def rigid_body_only(self) -> Arm:
        """Without joint friction, damping and rotors, as a sensor after the gear might see it."""
        none = np.zeros(len(self))
        return replace(self, frictionloss=none, damping=none, armature=none)


@cache
def panda(hand: bool = True) -> Arm:
    """The nominal Panda; without its hand, the bare flange."""
    model = load_model(CARD)
    if not hand:
        for name in ("panda_hand", *(f.replace("_joint", "") for f in NOMINAL.fingers)):
            body = model.body(name).id
            model.body_mass[body], model.body_inertia[body] = 0.0, 0.0
    arm = arm_from_model(model, NOMINAL.joints, site=TCP_FRAME)
    return replace(
        arm,
        position_lower=NOMINAL.position_lower,
        position_upper=NOMINAL.position_upper,
        velocity_limit=NOMINAL.velocity_limit,
        torque_limit=NOMINAL.torque_limit,
        rest=NOMINAL.ready,
        name=PANDA,
    )


def arm_from_model(model: mujoco.MjModel, joints: Sequence[str], site: str | None = None) -> Arm:
    """The arm of these hinges; every other joint of the model is held at its reference."""
    index = []
    for name in joints:
        j = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        if j < 0 or model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE:
            known = [model.joint(k).name for k in range(model.njnt)]
            raise ValueError(f"expected hinge joints of the model, got {name!r}; it has {known}")
        index.append(j)
    if len({int(model.jnt_bodyid[j]) for j in index}) < len(index):
        raise ValueError(f"expected one hinge a body, got several in one of {list(joints)}")
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, data)
    count = len(index)
    carrier = {int(model.jnt_bodyid[j]): i for i, j in enumerate(index)}
    owner = np.full(model.nbody, -1)
    for body in range(1, model.nbody):
        owner[body] = carrier.get(body, owner[model.body_parentid[body]])
    origin, axes = data.xanchor[index], data.xmat.reshape(-1, 3, 3)
    frame = axes[model.jnt_bodyid[index]]
    parent = np.array([owner[model.body_parentid[model.jnt_bodyid[j]]] for j in index])
    if (parent >= np.arange(count)).any():
        raise ValueError(f"expected joints from the base outwards, got {list(joints)}")
    base = (np.zeros(3), np.eye(3))
    parent_frames = [base if p < 0 else (origin[p], frame[p]) for p in parent]
    mass, moment, inertia = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3, 3))
    for body in range(1, model.nbody):
        i = owner[body]
        if i < 0:
            continue
        turn = frame[i].T @ data.ximat[body].reshape(3, 3)
        centre = frame[i].T @ (data.xipos[body] - origin[i])
        m = model.body_mass[body]
        mass[i] += m
        moment[i] += m * centre
        inertia[i] += turn @ np.diag(model.body_inertia[body]) @ turn.T
        inertia[i] += m * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    dof = model.jnt_dofadr[index]
    limited = model.jnt_limited[index].astype(bool)
    tip = data.site(site).xpos if site else data.xpos[np.flatnonzero(owner == count - 1)[-1]]
    return Arm(
        tuple(joints),
        parent,
        np.array([r.T @ (o - p) for o, (p, r) in zip(origin, parent_frames)]),
        np.array([r.T @ f for f, (_, r) in zip(frame, parent_frames)]),
        model.jnt_axis[index].copy(),
        model.qpos0[model.jnt_qposadr[index]].copy(),
        mass,
        moment,
        inertia,
        frame[-1].T @ (tip - origin[-1]),
        model.opt.gravity.copy(),
        np.where(limited, model.jnt_range[index, 0], -np.inf),
        np.where(limited, model.jnt_range[index, 1], np.inf),
        np.full(count, UNLIMITED_SPEED),
        _torque_limits(model, index),
        model.dof_frictionloss[dof].copy(),
        model.dof_damping[dof].reshape(count, -1)[:, 0].copy(),
        model.dof_armature[dof].copy(),
        model.qpos0[model.jnt_qposadr[index]].copy(),
        "",
        _held_joints(model, data, index),
    )


def _held_joints(model: mujoco.MjModel, data: mujoco.MjData, index: Sequence[int]) -> tuple[HeldJoint, ...]:
    """Other hinges and slides between the world and the arm, or between the arm and its ends."""
    mujoco.mj_comPos(model, data)
    bodies = {int(model.jnt_bodyid[j]) for j in index}
    below = {body for body in range(model.nbody) if _ancestors(model, body) & bodies}
    above = set.union(*(_ancestors(model, body) for body in bodies))
    found = []
    for j in set(range(model.njnt)).difference(index):
        body, kind = int(model.jnt_bodyid[j]), mujoco.mjtJoint(int(model.jnt_type[j]))
        if body not in below | above or kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            continue
        lever = data.subtree_com[body] - data.xanchor[j]
        reach = np.linalg.norm(np.cross(data.xaxis[j], lever)) if kind == mujoco.mjtJoint.mjJNT_HINGE else 1.0
        load = model.body_subtreemass[body] * np.linalg.norm(model.opt.gravity) * reach
        found.append(HeldJoint(model.joint(j).name, float(model.qpos0[model.jnt_qposadr[j]]), float(load)))
    return tuple(found)


def _ancestors(model: mujoco.MjModel, body: int) -> set[int]:
    """The body itself, and all that carry it."""
    found = {body}
    while body:
        body = int(model.body_parentid[body])
        found.add(body)
    return found


def _torque_limits(model: mujoco.MjModel, index: Sequence[int]) -> np.ndarray:
    """Nm at the joint, the least that joint or motor states; UNLIMITED_TORQUE where neither does."""
    limits = np.full(len(index), np.inf)
    on_joint = np.isin(model.actuator_trntype, (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    for i, j in enumerate(index):
        if model.jnt_actfrclimited[j]:
            limits[i] = np.abs(model.jnt_actfrcrange[j]).max()
        for a in np.flatnonzero(
            on_joint & (model.actuator_trnid[:, 0] == j) & model.actuator_forcelimited.astype(bool)
        ):
            limits[i] = min(limits[i], np.abs(model.actuator_forcerange[a]).max() * abs(model.actuator_gear[a, 0]))
    return np.where(np.isfinite(limits), limits, UNLIMITED_TORQUE)
