"""The interface of a physics engine; the rest of a simulated robot exists once, in `Simulation`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import mujoco
import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.domains import Pose, Task
from np_description.panda import NOMINAL, PandaModel
from np_description.scene_change import UNCHANGED, SceneChange


class Engine(Protocol):
    """The arm with its object in one engine, stepped by control periods. The same torques give the same bits.

    model: the MuJoCo scene that looks like it, for the renderer, which draws what `configuration` gives.
    """

    model: mujoco.MjModel

    def reset(self, start: Pose) -> None:
        """Everything at rest: the arm ready, fingers closed, the object at `start`, as if nothing had been before."""

    def joints(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position (9,) rad, m, velocity (9,) and effort (9,) Nm, N of the drives, seven joints, then two fingers."""

    def object_pose(self) -> Pose:
        """True pose of the object in the base frame: of the body that the camera sees, whatever moves on or in it."""

    def configuration(self) -> np.ndarray:
        """Generalised positions (nq,) of `model`: 7 joints, 2 fingers, position and quaternion wxyz of the object,
        and where its parts are, if it has any, m."""

    def pressing(self) -> Mapping[str, float]:
        """Sum of the contact forces N in the last physics step on each part of the robot that something presses on: finger,
        housing, link (`np_description.contact.penetration.kind_of`). For the record only: nothing is decided by it."""

    def step(self, torque: np.ndarray, extra: np.ndarray, opening: float) -> None:
        """One control period: the drives give `torque` (7,) Nm within their limits, `extra` (7,) Nm acts on the joints besides
        and is not measured, and each finger is led to `opening` m. Raises FloatingPointError, naming what, on divergence."""


class MakeEngine(Protocol):
    """Builds an engine."""

    def __call__(
        self,
        domain: Task,
        *,
        substeps: int = 1,
        camera: Camera = CAMERA,
        panda: PandaModel = NOMINAL,
        change: SceneChange = UNCHANGED,
    ) -> Engine:
        """substeps: physics steps in a control period; camera: that of `model`; panda: the arm's numbers; change: how the
        scene differs from the domain's."""
