"""The external force of an episode: figures of an evaluation's row, their summary, and the force reflex."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass

import numpy as np

from np_control.external_force import ExternalForce
from np_description.force_reflex import COUNTED_FORCES, DEFAULT_MODE, FORCE_REFLEX, MODES, STOP

REFLEX_CAUSE = "reflex: force"
TOUCH = 3.0  # N of filtered force, from which on an arm counts as touching: joint friction at rest leaves errors of up to 2 N
STEP = 0.1  # N, resolution in which forces are counted
SCALES = {f"{force:g}": force / FORCE_REFLEX.force for force in COUNTED_FORCES}
"""Thresholds at which stops are counted, by their force in N, as a share of the reflex's."""


@dataclass(frozen=True)
class ForceFigures:
    """The external force of one episode."""

    force_n: Mapping[str, float]
    """Filtered force, N: `median` and `q99` of the periods in which it is `TOUCH` or more (0 for none), `max` of all."""
    raw_peak_n: float
    """Largest force before the filter, N."""
    body: str
    """What pressed hardest at that peak: finger, housing (of the hand) or link; empty where the engine reports none."""
    reflex_stops: Mapping[str, int]
    """How often each threshold of `SCALES` was crossed: stops that the robot would have made, or has made."""


class ForceWatch:
    """Follows the estimates of an episode.

    mode: one of `np_description.force_reflex.MODES`. Raises ValueError for another one.
    """

    def __init__(self, mode: str = DEFAULT_MODE):
        if mode not in MODES:
            raise ValueError(f"force_reflex: expected one of {', '.join(MODES)}, got {mode}")
        self.mode = mode
        self.reset()

    def reset(self) -> None:
        """A new episode begins."""
        self._touches: Counter[int] = Counter()  # periods by filtered force in steps: a backend may run for days
        self._largest = self._raw_peak = 0.0
        self._body, self._share = "", 0.0
        self._stops = dict.fromkeys(SCALES, 0)

    def add(self, force: ExternalForce, pressing: Callable[[], Mapping[str, float]]) -> str:
        """Take the estimate of one period; why the arm must stop now, "" where it need not.

        pressing: called at a new peak only, returns the force N by what of the robot presses.
        """
        filtered, raw = _size(force.wrench), _size(force.raw)
        self._largest = max(self._largest, filtered)
        if filtered >= TOUCH:
            self._touches[round(filtered / STEP)] += 1
        if raw > self._raw_peak:
            self._raw_peak, by_body = raw, pressing()
            self._body = max(by_body, key=by_body.get) if by_body else ""
        before, self._share = self._share, force.share
        for name, scale in SCALES.items():
            self._stops[name] += before <= scale < force.share
        if self.mode != STOP or force.share <= 1.0:
            return ""
        if np.isnan(force.share):
            return f"{REFLEX_CAUSE}: no estimate: expected finite angles, speeds and torques of the joints"
        return f"{REFLEX_CAUSE}: {filtered:.0f} N at the hand, {force.share:.2f} of the threshold that is nearest"

    @property
    def figures(self) -> ForceFigures:
        """Figures of the episode so far."""
        steps = sorted(self._touches)
        periods = np.cumsum([self._touches[step] for step in steps])
        median, q99 = (
            STEP * steps[np.searchsorted(periods, share * periods[-1])] if steps else 0.0 for share in (0.5, 0.99)
        )
        largest = {"median": median, "q99": q99, "max": self._largest}
        rounded = {name: round(float(value), 2) for name, value in largest.items()}
        return ForceFigures(rounded, round(self._raw_peak, 2), self._body, dict(self._stops))

    def __str__(self) -> str:
        """The figures as JSON."""
        return json.dumps(asdict(self.figures))


def read_figures(text: str) -> ForceFigures:
    """The figures that `str` of a ForceWatch gave. Raises ValueError for another text."""
    try:
        return ForceFigures(**json.loads(text))
    except TypeError as error:
        raise ValueError(f"external force: expected its figures as JSON, got {text}") from error


def summary(episodes: Iterable[ForceFigures]) -> dict[str, object]:
    """Summary of several episodes; {} for none.

    force_n and raw_peak_n: median, 99 % and largest of the episodes' largest forces, N; touching_n: median of their medians while
    touching; peak_by: episodes by the body that gave the raw peak; reflex_stops: episodes with at least one stop by threshold, N.
    """
    of = list(episodes)
    if not of:
        return {}
    touching = [figures.force_n["median"] for figures in of if figures.force_n["median"]]
    return {
        "force_n": _spread([figures.force_n["max"] for figures in of]),
        "raw_peak_n": _spread([figures.raw_peak_n for figures in of]),
        "touching_n": round(float(np.median(touching)), 1) if touching else None,
        "peak_by": dict(Counter(figures.body or "unknown" for figures in of).most_common()),
        "reflex_stops": {name: sum(figures.reflex_stops[name] > 0 for figures in of) for name in SCALES},
        "force_episodes": len(of),
    }


def _spread(values: list[float]) -> dict[str, float]:
    quantiles = np.quantile(values, (0.5, 0.99, 1.0))
    return {name: round(float(value), 1) for name, value in zip(("median", "q99", "max"), quantiles)}


def _size(wrench: np.ndarray) -> float:
    return float(np.sqrt(wrench[:3] @ wrench[:3]))
