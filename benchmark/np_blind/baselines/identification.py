"""Identification of an arm: parameters with which a replay matches the recording.

Two ways on the same windows and errors: CMA-ES joint by joint, as the paper does it, and the Gauss-Newton of
mujoco.sysid with all parameters at once.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from np_blind.baselines.budget import Budget
from np_blind.baselines.closed_loop import Replay, Stretch
from np_blind.baselines.plant import ArmPlant

JOINT = ("frictionloss", "damping", "armature")
EVERYTHING = (*JOINT, "gain", "mass", "com")
GAIN_RANGE = (0.7, 1.3)
MASS_RANGE = (0.5, 1.5)  # of the nominal mass
COM_SHIFT = 0.05  # m, along each axis of the link
STEPS = 8  # starts of a window within its length
OFF_BOUND = 0.03  # share of its range that a search begins away from a bound: there it may stall
STILL = 1e-3  # rad, standard deviation of a target that holds


@dataclass(frozen=True, eq=False)
class Fit:
    """values: what was identified (`replay.Values`, of one arm), nothing for the nominal one; rmse: of the
    joint positions in the windows it was fitted to, rad; steps: physics steps; wall_s."""

    name: str
    values: Mapping[str, np.ndarray] = field(default_factory=dict)
    rmse: float | None = None
    steps: int = 0
    wall_s: float = 0.0


Progress = Callable[[str, int, int], None]
"""Called with the name of a fit, the round it has done and how many it may take."""


def active_windows(recorded: list[Stretch], budget: Budget) -> tuple[list[Stretch], np.ndarray]:
    """Windows in which one joint moves, the sinusoids, wherever they are; and rows (p, 2): a window, its
    joint.

    Of each joint those in which its target has the largest share of the motion of all, and not less than half
    of its largest one. A joint that never moves has none. Raises ValueError where no stretch is as long as a
    window, or no target moves.
    """
    places = [
        (stretch, step, window)
        for stretch, whole in enumerate(recorded)
        for step, window in enumerate(whole.windows(budget.window, budget.window / STEPS))
    ]
    if not places:
        raise ValueError(f"expected a stretch of {budget.window} s at least, got {[s.duration for s in recorded]} s")
    activity = np.array([window.activity for *_, window in places])
    shares = np.where(activity > STILL, activity / (activity.sum(axis=1, keepdims=True) + 1e-12), 0.0)
    pairs = []
    for joint, value in enumerate(shares.T):
        value = np.where(value < value.max() / 2, 0.0, value)
        for _ in range(budget.windows):
            best = int(value.argmax())
            if not value[best]:
                break
            pairs.append((best, joint))
            for i, (stretch, step, _) in enumerate(places):
                if stretch == places[best][0] and abs(step - places[best][1]) < STEPS:
                    value[i] = 0.0  # overlaps
    if not pairs:
        raise ValueError("expected targets that move, found all joints holding still")
    chosen = sorted({window for window, _ in pairs})
    return [places[i][2] for i in chosen], np.array([(chosen.index(window), joint) for window, joint in pairs])


def paper_identification(
    plant: ArmPlant,
    recorded: list[Stretch],
    budget: Budget = Budget(),
    seed: int = 0,
    progress: Progress | None = None,
) -> Fit:
    """Friction, damping and armature of each joint that moved, by one CMA-ES a joint; all joints side by
    side.

    As Kim et al. (IROS 2023): sinusoids joint by joint, the commands replayed in the simulator until the
    joint positions match. A joint's objective is the mean square error of its own position while it is the
    one that moves; the others have the current values of their own search.
    """
    import cma  # takes two seconds

    begin = time.monotonic()
    windows, pairs = active_windows(recorded, budget)
    replay = Replay(plant, windows, budget.threads)
    nominal = plant.nominal()
    scale = np.stack([plant.largest[name] for name in JOINT])  # (3, k)
    best = np.stack([nominal[name] for name in JOINT])
    searches = {}
    for joint in np.unique(pairs[:, 1]):
        start = np.clip(best[:, joint] / scale[:, joint], OFF_BOUND, 1 - OFF_BOUND)
        options = {"bounds": [0.0, 1.0], "popsize": budget.population, "maxiter": budget.generations}
        options |= {"seed": 1 + 1000 * seed + int(joint), "verbose": -9, "tolx": 1e-4}
        searches[joint] = cma.CMAEvolutionStrategy(start, 0.15, options)
    for generation in range(budget.generations):
        running = [joint for joint, search in searches.items() if not search.stop()]
        if not running:
            break
        asked = [np.array(searches[joint].ask()) for joint in running]
        which, trials = [], []
        for joint, candidates in zip(running, asked):
            own = np.tile(best, (len(candidates), 1, 1))
            own[:, :, joint] = candidates * scale[:, joint]
            for window, _ in pairs[pairs[:, 1] == joint]:
                which += [window] * len(candidates)
                trials.append(own)
        square = mean_square(replay.errors(np.array(which), dict(zip(JOINT, np.concatenate(trials).swapaxes(0, 1)))))
        for joint, candidates in zip(running, asked):
            rows, square = np.split(square, [len(candidates) * np.count_nonzero(pairs[:, 1] == joint)])
            cost = rows[:, joint].reshape(-1, len(candidates)).mean(axis=0)
            # In mrad^2: CMA-ES's tolerances of the objective are absolute.
            searches[joint].tell(list(candidates), list(1e6 * cost))
            best[:, joint] = searches[joint].result.xbest * scale[:, joint]
        if progress:
            progress("paper", generation + 1, budget.generations)
    values = dict(zip(JOINT, best))
    rmse = root(mean_square(replay.errors(np.arange(len(windows)), values)))
    return Fit("paper", values, rmse, replay.steps, time.monotonic() - begin)


def least_squares(
    plant: ArmPlant,
    windows: list[Stretch],
    free: tuple[str, ...] = EVERYTHING,
    budget: Budget = Budget(),
    progress: Progress | None = None,
) -> Fit:
    """The parameters named, of all joints and links at once, by `mujoco.sysid.optimize`.

    The residuals are the position errors of all joints. Parameters are scaled to their range, so that one
    finite difference suits all.
    """
    from mujoco import sysid  # an extra of mujoco

    begin = time.monotonic()
    replay = Replay(plant, windows, budget.threads)
    scaled = _Scaled(plant, free)
    parameters = sysid.ParameterDict()
    for name, start in scaled.start.items():
        parameters.add(sysid.Parameter(name, start, np.zeros_like(start), np.ones_like(start)))
    rounds = 0

    def residual(x: np.ndarray, _) -> list[np.ndarray]:
        nonlocal rounds
        columns = x.reshape(len(x), -1).T
        which = np.tile(np.arange(len(windows)), len(columns))
        values = {n: np.repeat(v, len(windows), axis=0) for n, v in scaled.values(columns).items()}
        errors = replay.errors(which, values)
        # A simulation that diverged is as wrong as an arm that stands at the other end of its range.
        errors = np.nan_to_num(errors, nan=np.pi).reshape(len(columns), -1).T
        rounds += len(columns) > 1
        if progress:
            progress("sysid", rounds, budget.iterations)
        return [np.ascontiguousarray(errors)], None, None

    solution, _ = sysid.optimize(
        parameters, residual, optimizer="mujoco", verbose=False, max_iters=budget.iterations, eps=1e-4,
        xtol=1e-4, output=io.StringIO(),
    )  # fmt: skip
    values = {name: value[0] for name, value in scaled.values(solution.as_vector()[None]).items()}
    rmse = root(mean_square(replay.errors(np.arange(len(windows)), values)))
    return Fit(f"sysid_{len(free)}", values, rmse, replay.steps, time.monotonic() - begin)


def likeliest_delay(
    plant: ArmPlant,
    recorded: list[Stretch],
    delays: Sequence[float],
    budget: Budget,
    progress: Progress | None = None,
) -> tuple[float, dict[float, float]]:
    """The delay, s, of commands with which the paper's parameters explain the windows best; RMSE, rad, of
    each.

    A delay passes for damping and for inertia: where the recording does not contain it, it has to be sought too.
    """
    rmse = {}
    for delay in delays:
        windows, _ = active_windows([stretch.delayed(delay) for stretch in recorded], budget)
        rmse[delay] = least_squares(plant, windows, JOINT, budget, progress).rmse
    return min(rmse, key=rmse.get), rmse


def mean_square(errors: np.ndarray) -> np.ndarray:
    """Over the samples (S, m, k) that exist; of a simulation without any, infinite. (S, k)"""
    counted = np.isfinite(errors)
    number = counted.sum(axis=1)
    total = np.where(counted, errors, 0.0) ** 2
    return np.where(number > 0, total.sum(axis=1) / np.maximum(number, 1), np.inf)


def root(square: np.ndarray) -> float:
    """Root of the mean of mean squares."""
    return float(np.sqrt(np.mean(square)))


class _Scaled:
    """Parameters of a least-squares fit, each 0..1 over its range."""

    def __init__(self, plant: ArmPlant, free: tuple[str, ...]):
        nominal = plant.nominal()
        ranges = {name: (np.zeros_like(top), top) for name, top in plant.largest.items()}
        ranges["gain"] = tuple(np.full_like(nominal["gain"], bound) for bound in GAIN_RANGE)
        ranges["mass"] = tuple(bound * nominal["mass"] for bound in MASS_RANGE)
        ranges["com"] = nominal["com"] - COM_SHIFT, nominal["com"] + COM_SHIFT
        self._range = {name: ranges[name] for name in free}
        self.start = {
            name: np.clip((nominal[name] - low) / (high - low), OFF_BOUND, 1 - OFF_BOUND).ravel()
            for name, (low, high) in self._range.items()
        }

    def values(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Values of x (S, n), in the order of `start`."""
        values, first = {}, 0
        for name, (low, high) in self._range.items():
            part = x[:, first : first + low.size].reshape(len(x), *low.shape)
            values[name] = low + part * (high - low)
            first += low.size
        return values
