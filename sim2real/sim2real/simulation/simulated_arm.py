"""The simulated arm of a replay: hinges, masses and drives as a MuJoCo model."""

from __future__ import annotations

import mujoco

from np_description.domains import CARD
from np_description.panda import NOMINAL, PandaModel
from np_description.scene import OBJECT, build_scene


def panda_spec(panda: PandaModel = NOMINAL, timestep: float = 0.002) -> mujoco.MjSpec:
    """The nominal simulator's Panda with its hand, fingers closed; the robot itself compensates gravity."""
    spec = build_scene(CARD, timestep=timestep, panda=panda)
    spec.delete(spec.body(OBJECT))
    for name in panda.fingers:
        spec.delete(spec.joint(name))
    for name, limit in zip(panda.joints, panda.torque_limit):
        spec.joint(name).actfrcrange = [-limit, limit]
    return spec


def compile_arm(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The arm of a description with one drive a joint, which gives ctrl + biasprm[1] q + biasprm[2] dq within its limits.

    What neither moves nor has mass is deleted from the description, contacts too. The integrator is Euler's with implicit
    joint damping: for a torque from outside the same as implicitfast, while the drives' own damping stays explicit, as in a
    digital controller. Raises ValueError for other joints than hinges.
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
    return model
