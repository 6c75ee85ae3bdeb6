"""Histograms of penetration depths, and their summary over episodes. No MuJoCo."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

PUSHERS = ("finger", "housing", "link")
PAIRS = (*(f"{pusher}-object" for pusher in PUSHERS), *(f"{p}-surroundings" for p in PUSHERS), "object-surroundings")
SOFT_PAIRS = ("finger-object", "finger-surroundings")  # of rubber
PUSHED = "pushed"
STEP = 0.02  # mm


@dataclass(frozen=True)
class PenetrationDepths:
    """Penetration depths of many moments."""

    median: float | None
    """Of all pairs that are not of rubber, mm."""
    q99: float | None
    """99 % quantile of the same, mm."""
    largest: float | None
    """Largest of the same, mm."""
    by_pair: Mapping[str, Mapping[str, float]]
    """The same three by pair; None where a pair never touched."""
    pushed_otherwise: float | None
    """Of the moments in which the robot touches the object, the share in which housing or links do."""

    def as_dict(self) -> dict:
        """The keys of the published JSON."""
        return {
            "median": self.median,
            "q99": self.q99,
            "max": self.largest,
            "by_pair": {name: dict(row) for name, row in self.by_pair.items()},
            "pushed_by_housing_or_links": self.pushed_otherwise,
        }


class DepthHistogram:
    """Counts of depths in steps of `STEP` mm: small enough to be kept for every episode."""

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

    def add_moments(self, depths: np.ndarray) -> None:
        """Many moments: depths (n, pairs) m in the order of `PAIRS`, 0 where a pair does not touch."""
        for pair, column in zip(PAIRS, depths.T):
            steps, numbers = np.unique(np.rint(1e3 * column[column > 0] / STEP).astype(int), return_counts=True)
            self._counts.setdefault(pair, Counter()).update(dict(zip(steps.tolist(), numbers.tolist())))
        touches = depths[:, [PAIRS.index(f"{pusher}-object") for pusher in PUSHERS]] > 0
        otherwise = int((touches[:, 1:].any(1)).sum())
        fingers = int(touches.any(1).sum()) - otherwise
        self._counts.setdefault(PUSHED, Counter()).update({0: fingers, 1: otherwise})

    def as_dict(self) -> dict[str, dict[str, int]]:
        """JSON: counts of steps by pair; counts of moments in which housing or links pushed (1) or fingers only (0)."""
        return {name: {str(k): n for k, n in sorted(row.items())} for name, row in sorted(self._counts.items())}

    @staticmethod
    def joined(tallies: Iterable[DepthHistogram]) -> DepthHistogram:
        """The sum of several histograms."""
        whole = DepthHistogram()
        for tally in tallies:
            for name, row in tally._counts.items():
                whole._counts.setdefault(name, Counter()).update(row)
        return whole

    @staticmethod
    def summary(tallies: Iterable[DepthHistogram]) -> PenetrationDepths:
        """The summary of several histograms."""
        whole = dict(DepthHistogram.joined(tallies)._counts)
        pushed = whole.pop(PUSHED, Counter())
        hard = sum((row for pair, row in whole.items() if pair not in SOFT_PAIRS), Counter())
        by_pair = {
            pair: dict(zip(("median", "q99", "max"), _quantiles(whole[pair]))) for pair in PAIRS if whole.get(pair)
        }
        return PenetrationDepths(*_quantiles(hard), by_pair, pushed[1] / pushed.total() if pushed.total() else None)


def _quantiles(counts: Counter) -> tuple[float | None, float | None, float | None]:
    if not counts:
        return None, None, None
    depths = np.repeat(*np.array(sorted(counts.items())).T) * STEP
    return tuple(round(float(value), 3) for value in np.quantile(depths, (0.5, 0.99, 1.0)))
