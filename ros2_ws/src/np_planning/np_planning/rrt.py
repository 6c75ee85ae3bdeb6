"""Sampling-based motion planning in joint space, by OMPL.

RRT-Connect finds a first path (Kuffner and LaValle, 2000), informed RRT* looks for shorter ones until the budget ends
(Karaman and Frazzoli, 2011; Gammell et al., 2014), and the shorter of both is shortcut. Budgets count collision checks,
not seconds, so that a seed gives the same path on any machine under any load; a deadline can be set on top of that.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from ompl import base, geometric, util

DOF = 7


class PlanningError(RuntimeError):
    """No motion could be planned; the message gives the reason."""


@dataclass(frozen=True)
class PlanningBudget:
    """What one call of `find_path` may spend.

    first: collision checks until a first path must be there; improve: further checks for shorter ones; seconds: wall
    time for everything, or None, the default and a must where runs have to be reproducible.
    """

    first: int = 60_000
    improve: int = 20_000
    seconds: float | None = None


def joint_step(a, b, resolution: float) -> int:
    """How many steps of at most `resolution` rad lead from joints a to b (..., 7), at least one."""
    return max(1, int(np.ceil(np.linalg.norm(np.subtract(b, a)) / resolution)))


def densify(waypoints, resolution: float) -> np.ndarray:
    """The polyline through waypoints (n, 7) with points (m, 7) at most `resolution` rad apart, waypoints included."""
    waypoints = np.asarray(waypoints, float)
    parts = [waypoints[:1]]
    for a, b in zip(waypoints, waypoints[1:]):
        share = np.linspace(0.0, 1.0, joint_step(a, b, resolution) + 1)[1:, None]
        parts.append(a + share * (b - a))
    return np.concatenate(parts)


def length(waypoints) -> float:
    """Length in rad (Euclidean in joint space) of the polyline through waypoints (n, 7)."""
    return float(np.linalg.norm(np.diff(waypoints, axis=0), axis=1).sum())


def find_path(
    is_free: Callable[[np.ndarray], bool],
    start,
    goal,
    lower,
    upper,
    *,
    seed: int,
    budget: PlanningBudget = PlanningBudget(),
    resolution: float = 0.02,
) -> np.ndarray:
    """Waypoints (n, 7) rad of a short free path from `start` to `goal`, both (7,) rad and free, ends included.

    is_free: whether joints (7,) are valid; lower, upper (7,) rad: limits; resolution rad: distance between the postures
    that are checked on the way. The result depends only on the arguments unless the budget names seconds. Raises
    PlanningError if no path is found.
    """
    straight = np.stack([start, goal])
    if all(is_free(joints) for joints in densify(straight, resolution)):
        return straight  # nothing is shorter
    deadline = np.inf if budget.seconds is None else time.monotonic() + budget.seconds
    search = _TreeSearch(is_free, start, goal, lower, upper, seed, resolution)
    first = search.run(geometric.RRTConnect, budget.first, deadline)
    if first is None:
        limit = f" or {budget.seconds:g} s" if budget.seconds is not None else ""
        raise PlanningError(f"no path found within {budget.first} collision checks{limit}")
    candidates = [search.shorten(first)]
    if budget.improve:
        better = search.run(geometric.InformedRRTstar, budget.improve, deadline)
        candidates += [search.shorten(better)] if better is not None else []
    free = [path for path in candidates if all(is_free(joints) for joints in densify(path, resolution / 2))]
    if not free:
        raise PlanningError("no path survives a check at twice the planner's resolution")
    return min(free, key=length)


class _Counted:
    """The validity check, counting. It holds no reference to OMPL's objects: a cycle through C++ would never be freed."""

    def __init__(self, is_free) -> None:
        self._is_free, self.count = is_free, 0

    def __call__(self, state) -> bool:
        self.count += 1
        return bool(self._is_free(state[0:DOF]))


class _TreeSearch:
    """One start and goal in OMPL's terms."""

    def __init__(self, is_free, start, goal, lower, upper, seed: int, resolution: float) -> None:
        util.setLogLevel(util.LogLevel.LOG_NONE)
        # The seed of generators that are made from now on; all of this search's are.
        util.RNG.setSeed(seed % (2**31 - 1) + 1)
        self._valid = _Counted(is_free)
        space = base.RealVectorStateSpace(DOF)
        bounds = base.RealVectorBounds(DOF)
        bounds.low, bounds.high = list(map(float, lower)), list(map(float, upper))
        space.setBounds(bounds)
        self._information = base.SpaceInformation(space)

        self._information.setStateValidityChecker(self._valid)
        self._information.setStateValidityCheckingResolution(resolution / space.getMaximumExtent())
        self._information.setup()
        self._start, self._goal = self._state(start), self._state(goal)

    @property
    def checks(self) -> int:
        return self._valid.count

    def run(self, planner_class, checks: int, deadline: float) -> np.ndarray | None:
        """Waypoints of an exact path from a planner that may spend so many checks, or None."""
        problem = base.ProblemDefinition(self._information)
        problem.setStartAndGoalStates(self._start, self._goal)
        problem.setOptimizationObjective(base.PathLengthOptimizationObjective(self._information))
        planner = planner_class(self._information)
        planner.setProblemDefinition(problem)
        planner.setup()
        valid, last = self._valid, self.checks + checks
        planner.solve(base.PlannerTerminationCondition(lambda: valid.count >= last or time.monotonic() > deadline))
        # The status is also true for approximate paths.
        return _array(problem.getSolutionPath()) if problem.hasExactSolution() else None

    def shorten(self, waypoints: np.ndarray) -> np.ndarray:
        """Shortcuts through free space; a fixed number of attempts, so that the result does not depend on time."""
        path = geometric.PathGeometric(self._information)
        for joints in waypoints:
            path.append(self._state(joints))
        simplifier = geometric.PathSimplifier(self._information)
        simplifier.reduceVertices(path, 40, 40)
        simplifier.partialShortcutPath(path, 60, 60)
        simplifier.reduceVertices(path, 40, 40)
        return _array(path)

    def _state(self, joints):
        state = self._information.allocState()
        state[0:DOF] = [float(joint) for joint in joints]
        return state


def _array(path) -> np.ndarray:
    return np.array([state[0:DOF] for state in path.getStates()])
