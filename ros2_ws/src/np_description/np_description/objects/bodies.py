"""An object's core and parts as bodies of MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from np_description.contact.model import HARD
from np_description.objects.parts import split_object
from np_description.objects.spec import ObjectSpec


def add_parts(body: mujoco.MjsBody, spec: ObjectSpec, touching: Mapping[str, object]) -> int:
    """Give `body` the mass of the object's core, and bodies on slides for its parts; how many these are.

    touching: what a shape of the object's outside is like; names of the parts begin with the body's.
    """
    core, parts = split_object(spec)
    _weigh(body, core.mass, core.centre, core.inertia)
    carriers = {None: body}
    for part in parts:
        name, axis = f"{body.name}_{part.name}", np.eye(3)[part.axis]
        moving = carriers[part.parent].add_body(name=name)
        _weigh(moving, part.mass, part.centre, np.trace(part.spread) * np.eye(3) - part.spread)
        moving.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=axis,
            range=part.travel,
            stiffness=np.array([part.stiffness, 0, 0]),
            damping=np.array([part.damping, 0, 0]),
            armature=part.armature,
            frictionloss=part.friction,
            solref_limit=HARD.hard.solref,  # a stop is one whatever the contacts are
            solimp_limit=HARD.hard.solimp,
        )
        if part.touches:
            box = mujoco.mjtGeom.mjGEOM_BOX
            moving.add_geom(name=name, type=box, pos=part.centre, size=part.half_size, **touching)
        carriers[part.name] = moving
    return len(parts)


def _weigh(body: mujoco.MjsBody, mass: float, centre: np.ndarray, inertia: np.ndarray) -> None:
    body.explicitinertial, body.mass, body.ipos = True, mass, centre
    body.fullinertia = [*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
