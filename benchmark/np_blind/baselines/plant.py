"""The simulated arm that the baselines identify, with the bounds of what may be identified."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from sim2real.simulation.simulated_arm import compile_arm, panda_spec

from np_description.panda import NOMINAL

FLOATING_MASS = 1e-6  # kg, of the bodies that carry a gravity compensation and nothing else


@dataclass(frozen=True, eq=False)
class ArmPlant:
    """An arm of k hinges as MuJoCo model, base to tip, nothing else that moves. Made by `make_plant`."""

    model: mujoco.MjModel
    """The arm with one drive a joint (`compile_arm`)."""
    free_model: mujoco.MjModel
    """The same arm, whose gravity compensation is that of the nominal masses whatever its own masses are."""
    largest: dict[str, np.ndarray] = field(repr=False)
    """Upper bounds (k,) of frictionloss Nm, damping Nms/rad, armature kg m^2, beyond any arm of this size."""

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


def panda_plant(timestep: float = 0.002) -> ArmPlant:
    """The nominal simulator's Panda with its hand."""
    return make_plant(panda_spec(NOMINAL, timestep), {"frictionloss": 3.0, "damping": 8.0, "armature": 0.6})


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
    """A plant from a description. Raises ValueError for other joints than hinges."""
    model = compile_arm(spec)
    free = _compensate_nominal_weight(spec).compile()
    for name in ("actuator_forcelimited", "actuator_forcerange", "jnt_actfrclimited"):
        getattr(free, name)[:] = getattr(model, name)
    return ArmPlant(model, free, {name: np.full(model.nv, value) for name, value in largest.items()})


def _compensate_nominal_weight(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    # Gravity compensation does not use the true mass of a link: it pulls with the nominal weight at the
    # nominal centre of mass, through a body of its own that weighs nothing.
    spec = spec.copy()
    for body in [body for body in spec.bodies if body.gravcomp and list(body.joints)]:
        pull = body.add_body(pos=body.ipos, ipos=[0, 0, 0], mass=FLOATING_MASS)
        pull.inertia, pull.explicitinertial = [FLOATING_MASS] * 3, True
        pull.gravcomp = body.gravcomp * body.mass / FLOATING_MASS
        body.gravcomp = 0.0
    return spec
