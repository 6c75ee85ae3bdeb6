"""Penetration depths, which distinguish a simulated success from one that a real robot could have.

Judged by the shapes of the scene at recorded configurations, so that it means the same for every engine and for any bag.
"""

from __future__ import annotations

import mujoco
import numpy as np

from np_description.contact.depths import PAIRS
from np_description.contact.model import ContactModel
from np_description.domains import Pose, Task
from np_description.panda import STATE_NAMES
from np_description.scene import OBJECT, SHAFT, SUPPORT, load_model


class Penetration:
    """Depths of contact in a domain's scene. contact: whose shapes they are judged by; default: the domain's."""

    def __init__(self, domain: Task, contact: ContactModel | None = None):
        self._model = load_model(domain, contact=contact)
        self._data = mujoco.MjData(self._model)
        self._joints = np.array([self._model.joint(name).qposadr[0] for name in STATE_NAMES])
        self._object = int(self._model.joint(OBJECT).qposadr[0])
        # Where it gives way it may be entered: plates stand at their stops.
        for joint in range(self._model.njnt):
            if self._model.jnt_stiffness[joint]:
                self._data.qpos[self._model.jnt_qposadr[joint]] = self._model.jnt_range[joint].sum()
        self._kinds = [kind_of(self._model.geom(geom).name) for geom in range(self._model.ngeom)]

    def depths(self, joints: np.ndarray, pose: Pose) -> dict[str, float]:
        """The deepest depth m of each pair that touches, with joints and fingers at (9,) rad, m and the object at its pose.

        Raises ValueError for values that are not finite.
        """
        if not (np.isfinite(joints).all() and np.isfinite(pose.position).all() and np.isfinite(pose.quaternion).all()):
            raise ValueError("penetration: expected finite joints and pose")
        data = self._data
        data.qpos[self._joints] = joints
        data.qpos[self._object : self._object + 7] = [*pose.position, *pose.quaternion]
        mujoco.mj_fwdPosition(self._model, data)
        found: dict[str, float] = {}
        for contact in data.contact:
            pair = pair_of(*(self._kinds[geom] for geom in contact.geom))
            if pair and contact.dist < 0:
                found[pair] = max(found.get(pair, 0.0), -float(contact.dist))
        return found


def kind_of(name: str) -> str:
    """The part that a geom belongs to, by its name: object, finger, housing, link, surroundings, or nothing that touches.

    A finger works with its tip; its bare shaft is counted with the housing."""
    if name.startswith((OBJECT, SUPPORT)):
        return "object"
    if name.startswith("panda_hand") or (name.startswith("panda_finger") and name.endswith(SHAFT)):
        return "housing"
    if name.startswith("panda_"):
        return "finger" if "finger" in name else "link"
    return "surroundings" if name else ""


def pair_of(one: str, other: str) -> str | None:
    """The name of a pair of such parts, None for one that is not watched."""
    return next((pair for pair in (f"{one}-{other}", f"{other}-{one}") if pair in PAIRS), None)
