"""How deep shapes are in each other: what tells a simulated success from one that a real robot could have.

Judged by the shapes of the scene at recorded configurations, so that it means the same for every engine and for any bag.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from np_description.domains import Domain, Pose
from np_description.panda import STATE_NAMES
from np_description.scene import OBJECT, load_model

PUSHERS = ("finger", "housing", "link")
PAIRS = (*(f"{pusher}-object" for pusher in PUSHERS), *(f"{p}-surroundings" for p in PUSHERS), "object-surroundings")
SOFT_PAIRS = ("finger-object", "finger-surroundings")  # of rubber
PUSHED = "pushed"
STEP = 0.02  # mm


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


class Tally:
    """How often which depth was seen, in steps of `STEP` mm: small enough to be kept for every episode."""

    def __init__(self, counts: Mapping[str, Mapping[str, int]] | None = None):
        """counts: what `as_dict` gave."""
        self._counts = {name: Counter({int(k): n for k, n in row.items()}) for name, row in (counts or {}).items()}

    def add(self, moment: Mapping[str, float]) -> None:
        """One moment: depth m of each pair that touches."""
        for pair, depth in moment.items():
            self._counts.setdefault(pair, Counter())[round(1e3 * depth / STEP)] += 1
        touching = {pusher for pusher in PUSHERS if f"{pusher}-object" in moment}
        if touching:
            self._counts.setdefault(PUSHED, Counter())[int(touching != {"finger"})] += 1

    def as_dict(self) -> dict[str, dict[str, int]]:
        """For JSON: by pair, how often which number of steps; and how often housing or links pushed (1) or fingers only (0)."""
        return {name: {str(k): n for k, n in sorted(row.items())} for name, row in sorted(self._counts.items())}

    @staticmethod
    def summary(tallies: Iterable[Tally]) -> Depths:
        """What several come to together."""
        whole: dict[str, Counter] = {}
        for tally in tallies:
            for name, row in tally._counts.items():
                whole[name] = whole.get(name, Counter()) + row
        pushed = whole.pop(PUSHED, Counter())
        hard = sum((row for pair, row in whole.items() if pair not in SOFT_PAIRS), Counter())
        by_pair = {
            pair: dict(zip(("median", "q99", "max"), _quantiles(whole[pair]))) for pair in PAIRS if pair in whole
        }
        return Depths(*_quantiles(hard), by_pair, pushed[1] / pushed.total() if pushed else None)


def _quantiles(counts: Counter) -> tuple[float | None, float | None, float | None]:
    if not counts:
        return None, None, None
    depths = np.repeat(*np.array(sorted(counts.items())).T) * STEP
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
