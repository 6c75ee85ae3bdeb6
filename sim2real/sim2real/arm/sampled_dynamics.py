"""Rigid-body dynamics of the nominal arm at the samples of a recording."""

from __future__ import annotations

import numpy as np

from sim2real.arm import rigid_body as rigid
from sim2real.arm.model import Arm
from sim2real.arm.prediction import Prediction
from sim2real.recordings.signals import Samples


class SampledDynamics:
    """Dynamics of k joints at n samples; regressors are computed once a link."""

    def __init__(self, arm: Arm, samples: Samples, prediction: Prediction):
        self._arm, self._samples, self._prediction = arm, samples, prediction
        self._regressors: dict[int, np.ndarray] = {}

    def regressor(self, link: int) -> np.ndarray:
        """Change (n, k, 10) of the torques with the inertial parameters of one link, in `rigid.PARAMETERS` order."""
        if link not in self._regressors:
            self._regressors[link] = rigid.regressor(self._arm, self._prediction.motion, link)
        return self._regressors[link]

    def mass_centre_change(self, link: int) -> np.ndarray:
        """Change (n, k, 3) of the torques with a link's m c along x, y, z; its inertia about its centre stays."""
        return self.regressor(link) @ rigid.mass_centre_change(self._arm, link)

    def gravity_torque(self, gravity: np.ndarray) -> np.ndarray:
        """Torque (n, k) Nm that holds the arm under another gravity (3,) m/s^2."""
        return rigid.gravity_torque(self._arm, self._samples.position, gravity)

    def link_inertia_traces(self) -> np.ndarray:
        """Inertia (k,) kg m^2 of each link about its own centre, as a number."""
        return rigid.link_inertia_traces(self._arm)

    def links_moved_by(self, joint: int) -> list[int]:
        """Links that a joint turns."""
        return rigid.links_moved_by(self._arm, joint)
