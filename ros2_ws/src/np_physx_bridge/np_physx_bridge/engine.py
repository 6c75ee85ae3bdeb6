"""The engine of `physx_bridge`: PhysX 5 on the CPU, in single precision."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite

import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.contact.depths import PUSHERS
from np_description.contact.model import HARD, ContactModel
from np_description.domains import Pose, Task
from np_description.panda import (
    BASE_FRAME,
    FINGER_FORCE,
    JOINT_NAMES,
    NOMINAL,
    STATE_NAMES,
    PandaModel,
)
from np_description.scene import FINGER_DAMPING, FINGER_STIFFNESS, OBJECT, contact_model, load_model
from np_description.scene_change import UNCHANGED, SceneChange
from np_physx_bridge.library import sapien
from np_physx_bridge.scene import STICTION, Translator, count_substeps, scene
from np_sim_bridge.schedule import PERIOD, SECOND

VERSION = "3"
"""Of this engine's behaviour, which is frozen: it stands in every row of an evaluation. A change of the behaviour takes a bench
against theory that fails before, never a task, and a new number (`tests/np_physx_bridge/test_frozen.py`)."""


class PhysxEngine:
    """An Engine of PhysX; arguments as for MakeEngine. contact: its coefficients of friction, all else is PhysX's own;
    default: the hard ones, with the hand that the domain's bags are judged by.

    Coulomb friction of a joint is a drive towards standstill that gives at most `frictionloss`: PhysX solves it implicitly
    with the contacts, so that a joint sticks. Its own joint friction is a coefficient on the load, which is another law.
    Raises OSError where SAPIEN is not installed.
    """

    def __init__(
        self,
        domain: Task,
        *,
        substeps: int = 1,
        camera: Camera = CAMERA,
        panda: PandaModel = NOMINAL,
        contact: ContactModel | None = None,
        change: SceneChange = UNCHANGED,
    ):
        self._sapien = sapien()
        contact = contact or replace(HARD, hand=domain.contact.hand)
        self.model = load_model(
            domain, timestep=PERIOD / SECOND / substeps, camera=camera, panda=panda, contact=contact, change=change
        )
        self._ready, self._limit, self._least = panda.ready, panda.torque_limit, -panda.torque_limit
        self._friction = panda.frictionloss
        # As the scene's joints have it: the arm's viscous damping is no part of its drives, the fingers' is.
        self._damping = panda.damping
        self._finger_damping = FINGER_DAMPING + float(self.model.dof_damping[self._dof(STATE_NAMES[-1])])
        self._contact = change.contact(contact_model(domain, contact))
        first = self.model.joint(OBJECT).id + 1
        self._part_names = [self.model.joint(joint).name for joint in range(first, self.model.njnt)]
        mass = float(self.model.body_subtreemass[self.model.body(OBJECT).id])
        self._substeps = substeps * count_substeps(mass, is_rigid=not self._part_names)
        self._timestep = PERIOD / SECOND / self._substeps

    def _dof(self, joint: str) -> int:
        return int(self.model.joint(joint).dofadr[0])

    def reset(self, start: Pose) -> None:
        """As in Engine: the scene is built anew, for PhysX remembers contacts."""
        self._scene, self._system = scene(self._sapien, self._timestep)
        translator = Translator(self._sapien, self.model, self._contact)
        entities, self.articulation, joints = translator.articulation(BASE_FRAME)
        things, self.object, self._parts = self._make_object(translator, start)
        for entity in (translator.surroundings(), *entities, *things):
            self._scene.add_entity(entity)
        if self._parts is not None:
            self._parts.set_root_pose(self._sapien.Pose(start.position, start.quaternion))
        order = [joint.name for joint in self.articulation.get_active_joints()]
        self._kinds = translator.kinds
        self._dofs = len(order)
        # In PhysX's order; joints without a command stay at zero.
        self._force = np.zeros(len(order), dtype=np.float32)
        self._order = np.array([order.index(name) for name in STATE_NAMES])
        self._drives = [joints[name] for name in STATE_NAMES[len(JOINT_NAMES) :]]
        for joint, limit in zip([joints[name] for name in JOINT_NAMES], self._friction):
            joint.set_drive_properties(0.0, STICTION if limit else 0.0, float(limit))
            joint.set_drive_velocity_target(0.0)
        for joint in self._drives:
            joint.set_drive_properties(FINGER_STIFFNESS, self._finger_damping, FINGER_FORCE)
            joint.set_drive_target(0.0)
        self._opening = 0.0
        position = np.zeros(len(STATE_NAMES))
        position[: len(JOINT_NAMES)] = self._ready
        self.articulation.set_qpos(self._as_articulation(position))
        self.articulation.set_qvel(np.zeros(self._dofs, dtype=np.float32))
        self._effort = np.zeros(len(STATE_NAMES))
        self._start: Pose | None = start  # as drawn, until single precision has had its turn
        self._read()
        self._position = position

    def _make_object(self, translator: Translator, start: Pose):
        """The object's entities, the component that is seen, and the articulation of one that is not rigid, else None."""
        if not self._part_names:
            body, component = translator.free_body(OBJECT)
            body.pose = self._sapien.Pose(start.position, start.quaternion)
            return [body], component, None
        entities, articulation, joints = translator.articulation(OBJECT, is_free=True)
        order = [joint.name for joint in articulation.get_active_joints()]
        self._part_order = [order.index(name) for name in self._part_names]
        return entities, articulation.get_links()[0], articulation

    def joints(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As in Engine."""
        return self._position.copy(), self._velocity.copy(), self._effort.copy()

    def object_pose(self) -> Pose:
        """As in Engine."""
        if self._start is not None:
            return Pose(np.array(self._start.position), np.array(self._start.quaternion))
        pose = self.object.entity.pose
        quaternion = np.asarray(pose.q, float)
        return Pose(np.asarray(pose.p, float), quaternion / np.linalg.norm(quaternion))

    def configuration(self) -> np.ndarray:
        """As in Engine."""
        pose = self.object_pose()
        parts = [] if self._parts is None else np.asarray(self._parts.get_qpos(), float)[self._part_order]
        return np.concatenate([self._position, pose.position, pose.quaternion, parts])

    def pressing(self) -> dict[str, float]:
        """As in Engine."""
        found: dict[str, float] = {}
        for contact in self._system.get_contacts():
            force = sum((float(np.linalg.norm(point.impulse)) for point in contact.points), 0.0) / self._timestep
            for kind in {self._kinds[shape] for shape in contact.shapes} & {*PUSHERS}:
                found[kind] = found.get(kind, 0.0) + force
        return {kind: force for kind, force in found.items() if force > 0}

    def step(self, torque: np.ndarray, extra: np.ndarray, opening: float) -> None:
        """As in Engine."""
        arm = len(JOINT_NAMES)
        # Halves of numpy.clip, sums of squares: at 500 Hz what Python does here costs as much as what PhysX does.
        driven = np.maximum(np.minimum(torque, self._limit), self._least)
        if opening != self._opening:
            self._opening = opening
            for joint in self._drives:
                joint.set_drive_target(opening)
        for _ in range(self._substeps):
            fingers = self._position[arm:].tolist(), self._velocity[arm:].tolist()
            self._force[self._order[:arm]] = driven + extra - self._damping * self._velocity[:arm]
            self.articulation.set_qf(self._force)
            self._system.step()
            self._start = None
            self._read()
        servo = [FINGER_STIFFNESS * (opening - x) - FINGER_DAMPING * v for x, v in zip(*fingers)]
        self._effort[:arm], self._effort[arm:] = driven, [max(min(f, FINGER_FORCE), -FINGER_FORCE) for f in servo]
        pose = self.object.entity.pose
        parts = (("joints", self._position), ("speeds", self._velocity), (OBJECT, pose.p), (OBJECT, pose.q))
        if not isfinite(sum(values @ values for _, values in parts)):
            raise FloatingPointError(f"{next(name for name, v in parts if not isfinite(v @ v))} not finite")

    def _read(self) -> None:
        self._position = np.asarray(self.articulation.get_qpos(), float)[self._order]
        self._velocity = np.asarray(self.articulation.get_qvel(), float)[self._order]

    def _as_articulation(self, values: np.ndarray) -> np.ndarray:
        """Values in the order of STATE_NAMES in PhysX's own order."""
        ordered = np.zeros(self._dofs, dtype=np.float32)
        ordered[self._order] = values
        return ordered
