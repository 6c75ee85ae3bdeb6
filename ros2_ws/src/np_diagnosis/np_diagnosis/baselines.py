"""What others do about a gap, on the same recordings: identification with a fixed list of parameters.

- `paper_identification`: as Kim et al. (IROS 2023) do it: sinusoids joint by joint, the commands replayed in the
  simulator, CMA-ES on friction, damping and armature of the joint until the joint positions agree.
- `least_squares`: `mujoco.sysid` (box-constrained Gauss-Newton) on the same windows and residuals, all parameters
  at once; `JOINT` is the paper's list, `EVERYTHING` adds the gain of the drives, mass and centre of mass of links.
- no fix: `Fit("none", {})`.

`compare` fits all of them to some recordings and reports what each leaves of the gap in others.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from np_diagnosis.plant import Plant
from np_diagnosis.replay import Motion, Replay

JOINT = ("frictionloss", "damping", "armature")
EVERYTHING = (*JOINT, "gain", "mass", "com")
GAIN_RANGE = (0.7, 1.3)
MASS_RANGE = (0.5, 1.5)  # of the nominal mass
COM_SHIFT = 0.05  # m, along each axis of the link


@dataclass(frozen=True)
class Budget:
    """How long to look. window s: length of a replayed stretch; windows: of each joint, those in which it moves
    most; generations, population: of CMA-ES, a joint; iterations: of Gauss-Newton."""

    window: float = 4.0
    windows: int = 2
    generations: int = 30
    population: int = 8
    iterations: int = 15


@dataclass(frozen=True, eq=False)
class Fit:
    """values: what was identified (`replay.Values`, of one arm), nothing for the nominal one; rmse: of the joint
    positions in the windows it was fitted to, rad; steps: physics steps; wall_s."""

    name: str
    values: Mapping[str, np.ndarray] = field(default_factory=dict)
    rmse: float = float("nan")
    steps: int = 0
    wall_s: float = 0.0


Progress = Callable[[str, int, int], None]
"""Called with the name of a fit, the round it has done and how many it may take."""


def active_windows(recorded: list[Motion], budget: Budget) -> tuple[list[Motion], np.ndarray]:
    """Windows to fit to, and the joint that each of them is about.

    A window is about the joint whose target moves most; each joint has those in which its share of the motion is
    largest. A joint that never leads has none. Raises ValueError where no motion is as long as a window.
    """
    windows = [w for motion in recorded for w in motion.windows(budget.window)]
    if not windows:
        raise ValueError(f"expected a motion of {budget.window} s at least, got {[len(m) for m in recorded]} rows")
    activity = np.array([w.activity for w in windows])
    leader = activity.argmax(axis=1)
    share = activity.max(axis=1) / np.maximum(activity.sum(axis=1), 1e-9)
    chosen, joints = [], []
    for joint in range(activity.shape[1]):
        own = np.flatnonzero((leader == joint) & (activity[:, joint] > 1e-3))
        # Rounded, so that among windows of one joint alone the one with the larger motion comes first.
        order = np.lexsort((activity[own, joint], share[own].round(1)))[::-1]
        for i in own[order[: budget.windows]]:
            chosen.append(windows[i])
            joints.append(joint)
    return chosen, np.array(joints)


def paper_identification(
    plant: Plant, recorded: list[Motion], budget: Budget = Budget(), seed: int = 0, progress: Progress | None = None
) -> Fit:
    """Friction, damping and armature of each joint that moved, by one CMA-ES a joint; all joints side by side.

    A joint's objective is the mean square error of its own position while it is the one that moves; the others
    have what their own search thinks of them.
    """
    import cma  # takes two seconds

    begin = time.monotonic()
    windows, about = active_windows(recorded, budget)
    replay = Replay(plant, windows)
    values, scale = plant.nominal(), plant.largest
    searches = {}
    for joint in np.unique(about):
        start = np.array([np.clip(values[n][joint] / scale[n][joint], 0.01, 0.99) for n in JOINT])
        options = {
            "bounds": [0.0, 1.0], "popsize": budget.population, "seed": 1 + 1000 * seed + int(joint),
            "maxiter": budget.generations, "tolx": 1e-4, "tolfun": 0.0, "tolfunhist": 0.0, "verbose": -9,
        }  # fmt: skip
        searches[joint] = cma.CMAEvolutionStrategy(start, 0.15, options)
    values = {name: values[name] for name in JOINT}
    generation = 0
    while running := [joint for joint, search in searches.items() if not search.stop()]:
        asked = {joint: np.array(searches[joint].ask()) for joint in running}
        which, trial = [], {name: [] for name in JOINT}
        for joint in running:
            for window in np.flatnonzero(about == joint):
                which += [window] * len(asked[joint])
                for i, name in enumerate(JOINT):
                    rows = np.tile(values[name], (len(asked[joint]), 1))
                    rows[:, joint] = asked[joint][:, i] * scale[name][joint]
                    trial[name].append(rows)
        errors = replay.errors(np.array(which), {name: np.concatenate(rows) for name, rows in trial.items()})
        square = _mean_square(errors)
        first = 0
        for joint in running:
            shape = (np.count_nonzero(about == joint), len(asked[joint]))
            cost = square[first : first + shape[0] * shape[1], joint].reshape(shape).mean(axis=0)
            first += shape[0] * shape[1]
            # In mm^2-like units, so that CMA-ES's absolute tolerances do not stop it early.
            searches[joint].tell(list(asked[joint]), list(1e6 * cost))
            for i, name in enumerate(JOINT):
                values[name][joint] = searches[joint].result.xbest[i] * scale[name][joint]
        generation += 1
        if progress:
            progress("paper", generation, budget.generations)
    rmse = _rmse(replay.errors(np.arange(len(windows)), values))
    return Fit("paper", values, rmse, replay.steps, time.monotonic() - begin)


def least_squares(
    plant: Plant,
    recorded: list[Motion],
    free: tuple[str, ...] = EVERYTHING,
    budget: Budget = Budget(),
    progress: Progress | None = None,
) -> Fit:
    """The parameters named, of all joints and links at once, by `mujoco.sysid.optimize`.

    The residuals are the position errors of all joints in the windows of `active_windows`. Parameters are scaled to
    their range, so that one finite difference suits all.
    """
    from mujoco import sysid  # an extra of mujoco

    begin = time.monotonic()
    windows, _ = active_windows(recorded, budget)
    replay = Replay(plant, windows)
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
    rmse = _rmse(replay.errors(np.arange(len(windows)), values))
    return Fit(f"sysid_{len(free)}", values, rmse, replay.steps, time.monotonic() - begin)


def gap(plant: Plant, recorded: list[Motion], values: Mapping[str, np.ndarray]) -> np.ndarray:
    """RMS position error (k,) rad of the closed-loop replay along whole motions; infinite where all diverge."""
    errors = Replay(plant, recorded).errors(np.arange(len(recorded)), values)
    return np.sqrt(_mean_square(errors.reshape(1, -1, errors.shape[-1]))[0])


def compare(
    plant: Plant,
    recorded: list[Motion],
    held_out: list[Motion],
    budget: Budget = Budget(),
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, dict]:
    """Every baseline, fitted to `recorded` and judged on `held_out`, as plain numbers and lists.

    By name: gap_before_rad, gap_after_rad and gap_after_by_joint_rad (RMS joint position error of the closed-loop
    replay on held-out motions), values, fit_rmse_rad, steps, wall_s.
    """
    before = gap(plant, held_out, {})
    report = {}
    for fit in (
        Fit("none"),
        paper_identification(plant, recorded, budget, seed, progress),
        least_squares(plant, recorded, JOINT, budget, progress),
        least_squares(plant, recorded, EVERYTHING, budget, progress),
    ):
        after = gap(plant, held_out, fit.values)
        report[fit.name] = {
            "gap_before_rad": _over_joints(before),
            "gap_after_rad": _over_joints(after),
            "gap_after_by_joint_rad": after.tolist(),
            "values": {name: np.asarray(value).tolist() for name, value in fit.values.items()},
            "fit_rmse_rad": fit.rmse,
            "steps": fit.steps,
            "wall_s": round(fit.wall_s, 2),
        }
    return report


class _Scaled:
    """Parameters of a least-squares fit, each 0..1 over its range."""

    def __init__(self, plant: Plant, free: tuple[str, ...]):
        nominal = plant.nominal()
        ranges = {name: (np.zeros_like(top), top) for name, top in plant.largest.items()}
        ranges["gain"] = tuple(np.full_like(nominal["gain"], bound) for bound in GAIN_RANGE)
        ranges["mass"] = tuple(bound * nominal["mass"] for bound in MASS_RANGE)
        ranges["com"] = nominal["com"] - COM_SHIFT, nominal["com"] + COM_SHIFT
        self._range = {name: ranges[name] for name in free}
        self.start = {
            name: np.clip((nominal[name] - low) / (high - low), 0.001, 0.999).ravel()
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


def _mean_square(errors: np.ndarray) -> np.ndarray:
    """Over the samples (S, m, k) that exist; of a simulation without any, infinite. (S, k)"""
    counted = np.isfinite(errors)
    total = np.where(counted, errors, 0.0) ** 2
    number = counted.sum(axis=1)
    return np.where(number > 0, total.sum(axis=1) / np.maximum(number, 1), np.inf)


def _rmse(errors: np.ndarray) -> float:
    return _over_joints(np.sqrt(_mean_square(errors.reshape(1, -1, errors.shape[-1]))[0]))


def _over_joints(rms: np.ndarray) -> float:
    return float(np.sqrt(np.mean(rms**2)))
