"""The simulated arm of a replay: hinges, masses, drives, and the bounds of what may be identified."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from np_description.domains import CARD
from np_description.panda import NOMINAL, PandaModel
from np_description.scene import OBJECT, build_scene

FLOATING_MASS = 1e-6  # kg, of the bodies that carry a gravity compensation and nothing else


@dataclass(frozen=True, eq=False)
class ArmPlant:
    """An arm of k hinges as MuJoCo model, base to tip, nothing else that moves. Made by `make_plant`.

    model: with one drive a joint, which gives ctrl + biasprm[1] q + biasprm[2] dq within the limits.
    free_model: the same arm, whose gravity compensation is that of the nominal masses whatever its own masses
    are. largest: upper bounds (k,) of frictionloss Nm, damping Nms/rad, armature kg m^2 of its joints, beyond
    any arm of this size.
    """

    model: mujoco.MjModel
    free_model: mujoco.MjModel
    largest: dict[str, np.ndarray] = field(repr=False)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names, base to tip."""
        return tuple(self.model.joint(i).name for i in range(self.model.njnt))

    def nominal(self) -> dict[str, np.ndarray]:
        """What a replay may change, as the model has it (`replay.Values`)."""
        model, links = self.model, self.model.jnt_bodyid
        return {
            "frictionloss": model.dof_frictionloss.copy(),
            "damping": model.dof_damping.copy(),
            "armature": model.dof_armature.copy(),
            "gain": np.ones(model.nv),
            "mass": model.body_mass[links],
            "com": model.body_ipos[links],
        }


def panda_plant(panda: PandaModel = NOMINAL, timestep: float = 0.002) -> ArmPlant:
    """The nominal simulator's Panda with its hand, fingers closed, gravity compensated as by the robot
    itself."""
    spec = build_scene(CARD, timestep=timestep, panda=panda)
    spec.delete(spec.body(OBJECT))
    for name in panda.fingers:
        spec.delete(spec.joint(name))
    for name, limit in zip(panda.joints, panda.torque_limit):
        spec.joint(name).actfrcrange = [-limit, limit]
    return make_plant(spec, {"frictionloss": 3.0, "damping": 8.0, "armature": 0.6})


def load_plant(path: str | Path) -> ArmPlant:
    """An arm from an MJCF file of hinges. Raises ValueError for a file that is none, naming it.

    Limits of the drives are the joints' `actuatorfrcrange`, where they have one. Gravity pulls at the arm
    unless its bodies have `gravcomp`.
    """
    try:
        return make_plant(mujoco.MjSpec.from_file(str(path)), {"frictionloss": 12.0, "damping": 15.0, "armature": 0.6})
    except ValueError as error:
        raise ValueError(f"{path}: expected an MJCF file of an arm, got: {error}") from error


def make_plant(spec: mujoco.MjSpec, largest: dict[str, float]) -> ArmPlant:
    """A plant from a description, of which everything goes that neither moves nor has mass, contacts too.

    The integrator is Euler's with implicit joint damping: for a torque from outside the same as implicitfast,
    while the drives' own damping stays explicit, as in a digital controller. Raises ValueError for other
    joints than hinges.
    """
    for elements in (spec.actuators, spec.sensors, spec.keys, spec.cameras, spec.geoms, spec.sites):
        for element in list(elements):
            spec.delete(element)
    types = [joint.type for joint in spec.joints]
    if not types or any(kind != mujoco.mjtJoint.mjJNT_HINGE for kind in types):
        raise ValueError(f"expected hinges only, got joints of types {[int(kind) for kind in types]}")
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    for joint in spec.joints:
        spec.add_actuator(
            name=joint.name,
            target=joint.name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        )
    model = spec.compile()
    # The limit is that of the drive's command, before its gain; the joint's own would come after.
    limited = model.jnt_actfrclimited.astype(bool)
    model.actuator_forcelimited[:] = limited
    model.actuator_forcerange[:] = model.jnt_actfrcrange
    model.jnt_actfrclimited[:] = False
    free = _compensate_nominal_weight(spec).compile()
    for name in ("actuator_forcelimited", "actuator_forcerange", "jnt_actfrclimited"):
        getattr(free, name)[:] = getattr(model, name)
    return ArmPlant(model, free, {name: np.full(model.nv, value) for name, value in largest.items()})


def _compensate_nominal_weight(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    # What compensates gravity does not know the true mass of a link: it pulls with the nominal weight at the
    # nominal centre of mass, through a body of its own that weighs nothing.
    spec = spec.copy()
    for body in [body for body in spec.bodies if body.gravcomp and list(body.joints)]:
        pull = body.add_body(pos=body.ipos, ipos=[0, 0, 0], mass=FLOATING_MASS)
        pull.inertia, pull.explicitinertial = [FLOATING_MASS] * 3, True
        pull.gravcomp = body.gravcomp * body.mass / FLOATING_MASS
        body.gravcomp = 0.0
    return spec
