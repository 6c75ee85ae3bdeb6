"""The simulated arm of a replay: a MuJoCo model of hinges only, and the bounds of what may be identified in it."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np

from np_description.domains import CARD
from np_description.panda import NOMINAL, PandaModel
from np_description.scene import OBJECT, build_scene


@dataclass(frozen=True, eq=False)
class Plant:
    """An arm of k hinges as MuJoCo model, base to tip, nothing else that moves.

    torque_limit (k,) Nm: of the drives. largest: upper bounds (k,) of frictionloss Nm, damping Nms/rad and
    armature kg m^2 of its joints, beyond what any arm of this size has. Gravity acts as the model's `gravcomp`
    says. Raises ValueError for a model with other joints.
    """

    model: mujoco.MjModel
    torque_limit: np.ndarray
    largest: dict[str, np.ndarray] = field(repr=False)

    def __post_init__(self) -> None:
        types = self.model.jnt_type
        if self.model.nv != self.model.njnt or (types != mujoco.mjtJoint.mjJNT_HINGE).any():
            raise ValueError(f"plant: expected a model with hinges only, got joint types {types.tolist()}")

    @property
    def joints(self) -> tuple[str, ...]:
        """Names, base to tip."""
        return tuple(self.model.joint(i).name for i in range(self.model.njnt))

    @property
    def links(self) -> np.ndarray:
        """Bodies (k,) that the joints move."""
        return self.model.jnt_bodyid

    def nominal(self) -> dict[str, np.ndarray]:
        """What a replay may change, as the model has it (`replay.Values`)."""
        model, count = self.model, self.model.nv
        return {
            "frictionloss": model.dof_frictionloss.copy(),
            "damping": model.dof_damping.copy(),
            "armature": model.dof_armature.copy(),
            "gain": np.ones(count),
            "mass": model.body_mass[self.links],
            "com": model.body_ipos[self.links],
        }


def panda_plant(model: PandaModel = NOMINAL, timestep: float = 0.002) -> Plant:
    """The nominal simulator's Panda with its hand, fingers closed, gravity compensated as by the robot itself."""
    spec = build_scene(CARD, timestep=timestep, panda=model)
    spec.delete(spec.body(OBJECT))
    for name in model.fingers:
        spec.delete(spec.joint(name))
    bare(spec)
    count = len(model.joints)
    largest = {"frictionloss": 3.0, "damping": 8.0, "armature": 0.6}
    return Plant(
        spec.compile(), model.torque_limit, {name: np.full(count, value) for name, value in largest.items()}
    )


def bare(spec: mujoco.MjSpec) -> None:
    """Take everything out that neither moves nor has mass: shapes, drives, cameras, keyframes; no contacts."""
    for elements in (spec.actuators, spec.sensors, spec.keys, spec.cameras, spec.geoms, spec.sites):
        for element in list(elements):
            spec.delete(element)
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
