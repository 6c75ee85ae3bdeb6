"""Other methods for a gap, on the same recordings as the diagnosis: a fixed list of parameters, or nothing.

By name: `paper`, the identification of Kim et al. (IROS 2023), CMA-ES on friction, damping and armature joint
by joint; `sysid_3`, mujoco.sysid on the same list and windows; `sysid_6`, mujoco.sysid with everything free
that a plant has, on twice as many windows of all motions; `none`, no fix.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from sim2real.effects.patch import Patch, PatchEffect

from np_blind.baselines.budget import Budget
from np_blind.baselines.closed_loop import INERTIA, Replay, Stretch
from np_blind.baselines.identification import (
    EVERYTHING,
    JOINT,
    Fit,
    Progress,
    active_windows,
    least_squares,
    mean_square,
    paper_identification,
    root,
)
from np_blind.baselines.plant import ArmPlant


def gap(plant: ArmPlant, recorded: list[Stretch], values: Mapping[str, np.ndarray], threads: int = 0) -> np.ndarray:
    """RMS position error (k,) rad of the closed-loop replay along whole stretches; infinite where all
    diverge."""
    errors = Replay(plant, recorded, threads).errors(np.arange(len(recorded)), values)
    return np.sqrt(mean_square(errors.reshape(1, -1, errors.shape[-1]))[0])


def fits(
    plant: ArmPlant,
    recorded: list[Stretch],
    budget: Budget = Budget(),
    seed: int = 0,
    progress: Progress | None = None,
) -> list[Fit]:
    """Every baseline, fitted. Raises ValueError for recordings that cannot be replayed, or in which nothing
    moves."""
    active, _ = active_windows(recorded, budget)
    return [
        Fit("none"),
        paper_identification(plant, recorded, budget, seed, progress),
        least_squares(plant, active, JOINT, budget, progress),
        least_squares(plant, active + spread_windows(recorded, budget), EVERYTHING, budget, progress),
    ]


def compare(
    plant: ArmPlant,
    recorded: list[Stretch],
    held_out: list[Stretch],
    budget: Budget = Budget(),
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, dict]:
    """Every baseline, fitted to `recorded` and judged on `held_out`, as plain numbers and lists.

    By name: gap_before_rad, gap_after_rad and gap_after_by_joint_rad (RMS joint position error of the
    closed-loop replay on held-out stretches), values, fit_rmse_rad, steps, wall_s.
    """
    before = gap(plant, held_out, {}, budget.threads)
    report = {}
    for fit in fits(plant, recorded, budget, seed, progress):
        after = gap(plant, held_out, fit.values, budget.threads)
        report[fit.name] = {
            "gap_before_rad": root(before**2),
            "gap_after_rad": root(after**2),
            "gap_after_by_joint_rad": after.tolist(),
            "values": {name: np.asarray(value).tolist() for name, value in fit.values.items()},
            "fit_rmse_rad": fit.rmse,
            "steps": fit.steps,
            "wall_s": round(fit.wall_s, 2),
        }
    return report


EFFECTS = {
    "frictionloss": ("coulomb_friction", "level"),
    "damping": ("viscous_friction", "coefficient"),
    "armature": ("armature", "inertia"),
    "gain": ("torque_scale", "scale"),
}
"""Parameter of a fit: effect of the catalogue and its parameter, both as changes of the nominal arm."""


def as_patch(plant: ArmPlant, fit: Fit) -> Patch:
    """The fit as a patch of the nominal arm, which simulators load and the blind test follows.

    Masses and centres of mass become changes of the links' first moments (`link_com`); that a heavier link
    also accelerates its carriers is lost, which matters little at the speeds of an arm.
    """
    nominal, found = plant.nominal(), []
    for name, (effect, parameter) in EFFECTS.items():
        for joint, change in zip(plant.joints, fit.values.get(name, nominal[name]) - nominal[name]):
            if change:
                found.append(PatchEffect(effect, joint, {parameter: float(change)}))
    for joint, moment in zip(plant.joints, _moments(plant, fit)):
        if moment.any():
            found.append(PatchEffect("link_com", joint, {f"moment_{a}": float(m) for a, m in zip("xyz", moment)}))
    return Patch(tuple(found))


def _moments(plant: ArmPlant, fit: Fit) -> np.ndarray:
    """Change (k, 3) kg m of the first moment about its joint of what each link carries, masses beyond it as
    points."""
    nominal, model = plant.nominal(), plant.model
    mass, com = (fit.values.get(name, nominal[name]) for name in INERTIA)
    moments = mass[:, None] * com - nominal["mass"][:, None] * nominal["com"]
    beyond = mass - nominal["mass"]
    for link in range(len(moments) - 1, 0, -1):
        # The origin of a link lies on its axis: seen from the link before it stays where it is.
        moments[link - 1] += beyond[link] * model.body_pos[model.jnt_bodyid[link]]
        beyond[link - 1] += beyond[link]
    return moments


def spread_windows(recorded: list[Stretch], budget: Budget) -> list[Stretch]:
    """As many windows as joints have, evenly over everything recorded."""
    windows = [w for stretch in recorded for w in stretch.windows(budget.window, budget.window)]
    count = min(len(windows), budget.windows * recorded[0].position.shape[1])
    return [windows[i] for i in np.linspace(0, len(windows) - 1, count).astype(int)]
