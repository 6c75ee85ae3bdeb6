"""What gravity leaves on the joints: the weight of the arm as it is, against what the nominal arm's controller compensates."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from np_description.panda import NOMINAL, PandaModel


@dataclass(frozen=True, eq=False)
class GravityModel:
    """How gravity and its compensation differ from the nominal arm's."""

    share: float = 1.0
    """Share of the nominal gravity torque that is compensated."""
    bias: np.ndarray = field(default_factory=lambda: np.zeros(7))
    """(7,) rad, error of the angles at which it is compensated."""
    tilt: tuple[float, float] = (0.0, 0.0)
    """(roll, pitch) rad of the base."""


class GravityTorque:
    """Torque that holds an arm of MuJoCo's."""

    def __init__(self, panda: PandaModel = NOMINAL, tilt: tuple[float, float] = (0.0, 0.0)):
        import mujoco  # whoever only reads records does without

        from np_description.domains import CARD
        from np_description.scene import load_model

        self._engine = mujoco
        self._model = load_model(CARD, panda=panda)
        size = -self._model.opt.gravity[2]
        if any(tilt):
            self._model.opt.gravity[:] = [size * tilt[1], -size * tilt[0], -size]
        self._data = mujoco.MjData(self._model)

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """Torque (..., 7) Nm at angles (..., 7) rad."""
        if q.ndim > 1:
            return np.stack([self(row) for row in q])
        mujoco, model, data = self._engine, self._model, self._data
        data.qpos[:7], data.qvel[:] = q, 0.0
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        result = np.empty(model.nv)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, result)
        return result[:7]
