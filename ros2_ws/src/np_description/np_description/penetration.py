"""How deep shapes are in each other: what tells a simulated success from one that a real robot could have.

Judged by the shapes of the scene at recorded configurations, so that it means the same for every engine and for any bag.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from np_description.domains import Domain, Pose
from np_description.panda import STATE_NAMES
from np_description.scene import OBJECT, load_model

PUSHERS = ("finger", "housing", "link")
PAIRS = (*(f"{pusher}-object" for pusher in PUSHERS), *(f"{p}-surroundings" for p in PUSHERS), "object-surroundings")
SOFT_PAIRS = ("finger-object", "finger-surroundings")  # of rubber


class Penetration:
    """Depths of contact in a domain's scene."""

    def __init__(self, domain: Domain):
        self._model = load_model(domain)
        self._data = mujoco.MjData(self._model)
        self._joints = np.array([self._model.joint(name).qposadr[0] for name in STATE_NAMES])
        self._object = int(self._model.joint(OBJECT).qposadr[0])
        self._kinds = [_kind(self._model.geom(geom).name) for geom in range(self._model.ngeom)]

    def depths(self, joints: np.ndarray, pose: Pose) -> dict[str, float]:
        """The deepest depth m of each pair that touches, with joints and fingers at (9,) rad, m and the object at its pose.

        Raises ValueError for values that are not finite: nothing can be said of them.
        """
        if not (np.isfinite(joints).all() and np.isfinite(pose.position).all() and np.isfinite(pose.quaternion).all()):
            raise ValueError("penetration: expected finite joints and pose")
        data = self._data
        data.qpos[self._joints] = joints
        data.qpos[self._object : self._object + 7] = [*pose.position, *pose.quaternion]
        mujoco.mj_fwdPosition(self._model, data)
        found: dict[str, float] = {}
        for contact in data.contact:
            pair = _pair(*(self._kinds[geom] for geom in contact.geom))
            if pair and contact.dist < 0:
                found[pair] = max(found.get(pair, 0.0), -float(contact.dist))
        return found


@dataclass(frozen=True)
class Depths:
    """Depths mm of many moments. median, q99, largest of all pairs that are not of rubber; by_pair: the same of each pair
    (None where a pair never touched); pushed_otherwise: share of the moments in which the robot touches the object where
    housing or links do."""

    median: float | None
    q99: float | None
    largest: float | None
    by_pair: Mapping[str, Mapping[str, float]]
    pushed_otherwise: float | None

    def as_dict(self) -> dict:
        """For JSON: the keys of the command line's contract."""
        return {
            "median": self.median,
            "q99": self.q99,
            "max": self.largest,
            "by_pair": {name: dict(row) for name, row in self.by_pair.items()},
            "pushed_by_housing_or_links": self.pushed_otherwise,
        }


def summarise(moments: Iterable[Mapping[str, float]]) -> Depths:
    """What the depths (m, by pair) of many moments come to."""
    moments = list(moments)
    by_pair = {pair: [1e3 * m[pair] for m in moments if pair in m] for pair in PAIRS}
    hard = [depth for pair, depths in by_pair.items() if pair not in SOFT_PAIRS for depth in depths]
    touching = [{p for p in PUSHERS if f"{p}-object" in m} for m in moments]
    pushed = [bool(touch - {"finger"}) for touch in touching if touch]
    return Depths(
        *_quantiles(hard),
        {pair: dict(zip(("median", "q99", "max"), _quantiles(depths))) for pair, depths in by_pair.items() if depths},
        float(np.mean(pushed)) if pushed else None,
    )


def _quantiles(depths: Sequence[float]) -> tuple[float | None, float | None, float | None]:
    if not depths:
        return None, None, None
    return tuple(round(float(value), 3) for value in np.quantile(depths, (0.5, 0.99, 1.0)))


def _kind(name: str) -> str:
    if name == OBJECT:
        return "object"
    if name.startswith("panda_hand"):
        return "housing"
    if name.startswith("panda_"):
        return "finger" if "finger" in name else "link"
    return "surroundings" if name else ""


def _pair(one: str, other: str) -> str | None:
    return next((pair for pair in (f"{one}-{other}", f"{other}-{one}") if pair in PAIRS), None)
