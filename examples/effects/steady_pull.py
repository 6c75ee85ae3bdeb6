"""An effect of one's own: a constant force pulls at the hand wherever it goes, for example that of a hose from the ceiling.

    NP_EFFECTS_PATH=examples/effects ros2 run np_diagnosis diagnose runs/suite_000 --out runs/report

This file is all that it takes: its values in a patch, its action on the simulated arm, its appearance in a recording.
"""

from __future__ import annotations

import numpy as np
from sim2real.effects.effect import Effect, EffectTarget, Quantity
from sim2real.effects.evidence import Context
from sim2real.effects.hooks import HookContext, ResistanceFunction
from sim2real.effects.regressor import EffectRegressor, Parameter
from sim2real.effects.stage import Stage

from np_control.kinematics import jacobian
from np_description.panda import JOINT_NAMES

FORCES = tuple(Quantity(f"force_{axis}", "N", -30.0, 30.0) for axis in "xyz")  # in the base frame


def _levers(q: np.ndarray) -> np.ndarray:
    """Torque (n, 7, 3) Nm on the joints by a force of 1 N at the tool point, along each axis of the base, at q (n, 7)."""
    return np.swapaxes(jacobian(q)[..., :3, :], -1, -2)


def _regressors(context: Context) -> list[EffectRegressor]:
    if context.arm.joints != JOINT_NAMES:
        return []  # of another arm we have no kinematics
    levers = _levers(context.samples.position)
    return [
        EffectRegressor(
            "steady_pull",
            tuple(Parameter(f.name, f.unit, f.lower, f.upper, 2.0) for f in FORCES),
            {Stage.DYNAMICS: lambda c, j: -levers[:, j]},  # the drives give what the pull does not
            "virtual work: torque = J^T force",
            is_arm=True,
        )
    ]


def _pull(values: HookContext) -> ResistanceFunction:
    force = np.stack([values(f.name)[..., 0] for f in FORCES], axis=-1)  # of the arm: the same at every joint

    def resist(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        torque = np.einsum("njx,nx->nj", _levers(q.reshape(-1, 7)), np.atleast_2d(force))
        return -torque.reshape(q.shape)

    return resist


EFFECT = Effect(
    "steady_pull",
    EffectTarget.ARM,
    FORCES,
    _regressors,
    joints=_pull,
    numpy_only=True,
    catalogue_row={
        "module": "rigid_body",
        "model": "tau = J(q)^T F, F constant in the base frame",
        "panda_magnitude": "1-10 N: hoses, a balancer (prior)",
        "signature": "torque in all joints that turns with the hand's place, not with its speed",
        "exciting_experiment": "dwell in several postures",
    },
)
