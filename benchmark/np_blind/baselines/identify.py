"""Identification of an arm as the paper does it, and by mujoco.sysid on the same data.

    python -m np_blind.baselines.identify BAG... [--held-out BAG...]     # recordings by `excite`
    python -m np_blind.baselines.identify --simulate                     # a reference arm with known parameters
    python -m np_blind.baselines.identify LOG.npz --arm z1.xml --blocks 2.3 --delays 0 0.005     # drives' own loops

Writes OUT/identification.json and .png. The last line printed is one JSON object.
"""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from sim2real.excitation.suite import make_suite

from np_blind.baselines.budget import Budget
from np_blind.baselines.closed_loop import Stretch, stretches
from np_blind.baselines.drive_log import read_drive_log
from np_blind.baselines.identification import JOINT, likeliest_delay
from np_blind.baselines.identify_reference import known_arm, record
from np_blind.baselines.methods import compare, gap
from np_blind.baselines.plant import ArmPlant, load_plant, panda_plant
from np_common.cli import Parser

FITTED, HELD_OUT = (
    ("sinusoid", "third_posture"),
    ("reference", "second_posture", "low_damping"),
)  # of the suite
SHARE = 0.6  # of a recording that is fitted to where nothing else is held out


def split(recorded: Sequence[Stretch], share: float = SHARE) -> tuple[list[Stretch], list[Stretch]]:
    """The first part of each stretch, to fit to, and the rest, held out."""
    edges = [round(share * len(stretch)) for stretch in recorded]
    return (
        [stretch.cut(slice(0, edge)) for stretch, edge in zip(recorded, edges)],
        [stretch.cut(slice(edge, None)) for stretch, edge in zip(recorded, edges)],
    )


def alternate(recorded: Sequence[Stretch], seconds: float) -> tuple[list[Stretch], list[Stretch]]:
    """Blocks of this length by turns: the first, third, ... to fit to, the others held out."""
    blocks = [block for stretch in recorded for block in stretch.windows(seconds, seconds)]
    return blocks[::2], blocks[1::2]


def simulate_recording(seed: int) -> tuple[list[Stretch], list[Stretch], dict[str, np.ndarray]]:
    """Recordings of a reference arm to fit to, others held out, and its parameters."""
    truth = known_arm(seed)
    fitted = record(truth, make_suite(FITTED), seed)
    return fitted, record(truth, make_suite(HELD_OUT), seed + 1), truth


def from_files(paths: Sequence[Path], plant: ArmPlant) -> list[Stretch]:
    """The stretches of recordings, bags or logs of drives (.npz). Raises ValueError for what cannot be
    replayed."""
    period, joints = plant.model.opt.timestep, len(plant.joints)
    recorded = [read_drive_log(path, joints, period) for path in paths if path.suffix == ".npz"]
    if bags := [path for path in paths if path.suffix != ".npz"]:
        from sim2real.recordings.reading import load_log  # needs what reads bags, which an .npz file does not

        recorded += [part for path in bags for part in stretches(load_log(path))]
    return recorded


def report(
    plant: ArmPlant,
    fitted: list[Stretch],
    held_out: list[Stretch],
    truth: Mapping[str, np.ndarray] | None,
    budget: Budget,
    seed: int,
) -> dict:
    """Every method's figures; with the errors of its parameters where the truth is known."""
    result = {
        "joints": plant.joints,
        "nominal": {name: plant.nominal()[name].tolist() for name in JOINT},
        "fitted": [[s.name, round(s.duration, 3)] for s in fitted],
        "held_out": [[s.name, round(s.duration, 3)] for s in held_out],
        "methods": compare(plant, fitted, held_out, budget, seed, _show),
    }
    if truth is not None:
        result["truth"] = {name: truth[name].tolist() for name in JOINT}
        # What is left even so: noise, and the step of the nominal simulator against the finer one of the arm.
        result["gap_with_truth_rad"] = float(np.sqrt(np.mean(gap(plant, held_out, truth, budget.threads) ** 2)))
        for method in result["methods"].values():
            method["relative_error"] = {
                name: (np.array(method["values"][name]) / truth[name] - 1).tolist()
                for name in JOINT
                if name in method["values"]
            }
    return result


def plot(result: dict, path: Path) -> None:
    """Held-out error by joint, and parameters against the nominal and, where known, the true ones."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 6), layout="constrained")
    (errors, *parameters) = figure.subplots(2, 2).flat
    joints = np.arange(len(result["joints"]))
    methods = result["methods"]
    for i, (name, method) in enumerate(methods.items()):
        offset = (i - (len(methods) - 1) / 2) * 0.2
        errors.bar(joints + offset, 1e3 * np.array(method["gap_after_by_joint_rad"]), 0.2, label=name)
    errors.set(yscale="log", ylabel="mrad", title="held-out position error of the closed-loop replay, RMS")
    errors.set_ylim(top=4 * errors.get_ylim()[1])
    errors.legend(ncols=len(methods), loc="upper center")
    units = {"frictionloss": "Nm", "damping": "Nms/rad", "armature": "kg m$^2$"}
    for axes, (quantity, unit) in zip(parameters, units.items()):
        axes.plot(joints, result["nominal"][quantity], "k_", markersize=14, label="nominal")
        if "truth" in result:
            axes.plot(joints, result["truth"][quantity], "kx", markersize=9, label="true")
        for i, (name, method) in enumerate(methods.items()):
            if quantity in method["values"]:
                axes.plot(joints + 0.12 * (i - 2), method["values"][quantity], "o", color=f"C{i}", label=name)
        axes.set(ylabel=unit, title=quantity, ylim=(0, None))
    parameters[0].legend(ncols=2)
    for axes in (errors, *parameters):
        axes.set_xticks(joints, [f"J{j + 1}" for j in joints])
    figure.savefig(path, dpi=110)


def summary(result: dict) -> dict:
    """Of each method: gap before and after, mrad; median error of each parameter, if known; time and
    effort."""
    lines = {}
    for name, method in result["methods"].items():
        lines[name] = {
            "gap_before_mrad": round(1e3 * method["gap_before_rad"], 4),
            "gap_after_mrad": round(1e3 * method["gap_after_rad"], 4),
            "wall_s": method["wall_s"],
            "steps": method["steps"],
        }
        for quantity, error in method.get("relative_error", {}).items():
            lines[name][f"{quantity}_error_median"] = round(float(np.median(np.abs(error))), 4)
    return lines


def _show(name: str, done: int, limit: int) -> None:
    if sys.stderr.isatty():
        print(f"\r{name:6s} round {done:3d} of at most {limit}", end="", file=sys.stderr, flush=True)


def main() -> None:
    """Identify, write the figures and the plot."""
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", nargs="*", type=Path, help="to fit to: bags, or drives' logs (.npz)")
    parser.add_argument(
        "--held-out", nargs="+", type=Path, default=[], help=f"default: the last {100 * (1 - SHARE):.0f} %% of each"
    )
    parser.add_argument("--blocks", type=float, help="hold out every second block of this length, s, instead")
    parser.add_argument("--arm", type=Path, help="MJCF file; default: the nominal Panda")
    parser.add_argument("--delays", nargs="+", type=float, default=[], help="s, of commands, of which to take the best")
    parser.add_argument("--simulate", action="store_true", help="a reference arm with known parameters instead")
    parser.add_argument("--out", type=Path, default=Path("runs/identify"))
    parser.add_argument("--seed", type=int, default=0)
    for name, default in vars(Budget()).items():
        parser.add_argument(f"--{name}", type=type(default), default=default)
    arguments = parser.parse_args()
    if bool(arguments.recordings) == arguments.simulate:
        parser.error("expected recordings, or --simulate")
    budget = Budget(**{name: getattr(arguments, name) for name in vars(Budget())})
    plant = load_plant(arguments.arm) if arguments.arm else panda_plant()
    truth, delays = None, {}
    if arguments.simulate:
        fitted, held_out, truth = simulate_recording(arguments.seed)
    else:
        recorded, held_out = from_files(arguments.recordings, plant), from_files(arguments.held_out, plant)
        if held_out:
            fitted = recorded
        else:
            fitted, held_out = alternate(recorded, arguments.blocks) if arguments.blocks else split(recorded)
    if arguments.delays:
        delay, delays = likeliest_delay(plant, fitted, arguments.delays, budget, _show)
        fitted, held_out = ([s.delayed(delay) for s in part] for part in (fitted, held_out))
    result = report(plant, fitted, held_out, truth, budget, arguments.seed)
    if delays:
        result |= {"delay_s": delay, "rmse_of_delays_rad": delays}
    result |= {
        "command": sys.argv[1:],
        "seed": arguments.seed,
        "budget": vars(budget),
        "machine": f"{os.cpu_count()} cores, {platform.machine()}",
    }
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "identification.json").write_text(json.dumps(result, indent=1) + "\n")
    plot(result, arguments.out / "identification.png")
    print(json.dumps({"out": str(arguments.out), **summary(result)}))


if __name__ == "__main__":
    main()
