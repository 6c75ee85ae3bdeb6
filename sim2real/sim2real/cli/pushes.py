"""`pushes FILE --reference NAME... --new NAME...`: what changed between slow pushes of a block on a table.

FILE is an .npz with three arrays a push: NAME/ft (n, 5 or more): time received, stamp (s), force x y z (N); NAME/tip (m, 5):
times, centre of the round tip (m, world); NAME/object (k, 9): times, position (m, world), quaternion x y z w. The object is a
square block whose frame has its axes along the sides. A NAME may have wildcards. Each new push is asked about alone, then all of
them together, and each push of the reference beside the others: where nothing changed, nothing should be named. Nothing is
drawn at random. The last line printed is one JSON object. Needs no ROS.
"""

from __future__ import annotations

import argparse
import datetime
import fnmatch
import json
import shlex
import sys
from pathlib import Path

import numpy as np

from np_common.cli import Parser

AXES = {"x": 0, "y": 1, "z": 2}


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="pushes", description=__doc__.split("\n")[0])
    parser.add_argument("file", type=Path, metavar="FILE")
    parser.add_argument("--reference", nargs="+", required=True, metavar="NAME")
    parser.add_argument("--new", nargs="+", required=True, metavar="NAME")
    parser.add_argument(
        "--force", default="x,y,z", help="axes of the sensor that give the force on the object along x, y, z"
    )
    parser.add_argument("--half-side", type=float, default=0.05, metavar="M", help="of the block, within 3 mm")
    parser.add_argument(
        "--tip-radius",
        type=float,
        nargs="+",
        required=True,
        metavar="M",
        help="of the reference, and of the new pushes",
    )
    parser.add_argument("--register", action="store_true", help="tip and object are in frames never brought together")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="file that gets the JSON object as well")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Status 2: a recording or an option that breaks its contract."""
    options = parse(arguments)
    try:
        found = answer(options)
    except (OSError, ValueError) as error:
        print(f"pushes: {error}", file=sys.stderr)
        print(json.dumps({"error": str(error)}))
        return 2
    given = sys.argv[1:] if arguments is None else arguments
    found = {
        "date": datetime.date.today().isoformat(),
        "command": "ros2 run np_diagnosis pushes " + shlex.join(_without_folder(word) for word in given),
        **found,
    }
    if options.out:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found))
    return 0


def answer(options: argparse.Namespace) -> dict:
    """The set-up of the reference, and what changed. Raises ValueError, in words, for input that breaks its contract."""
    # Slow to import, and not wanted by --help.
    from sim2real.task.limit_surface import Pushed
    from sim2real.task.push_change import what_changed
    from sim2real.task.push_fit import identify, registered

    reference, new = read(options)
    nominal = Pushed(half_side=options.half_side)

    def set_up(runs):
        return identify(runs, registered(runs, nominal) if options.register else nominal)

    setup = set_up(reference)
    known = setup.pushed
    alone = {run.name: _in_short(what_changed(setup, [run])) for run in new}
    others = {
        run.name: _in_short(what_changed(set_up([r for r in reference if r is not run]), [run])) for run in reference
    }
    return {
        "set_up": {
            "pushes": len(reference),
            "friction_N": float(known.friction),
            "friction_run_to_run": float(setup.spread[0]),
            "support_over_side": float(known.support),
            "tip_friction": float(known.tip_friction),
            "half_side_m": float(known.half_side),
        },
        "new_alone": alone,
        "new_together": _in_full(what_changed(setup, new)),
        "reference_alone": others,
        "figures": _figures(alone, others),
    }


def read(options: argparse.Namespace) -> tuple[list, list]:
    """Windows of the reference's pushes and of the new ones. Raises ValueError for what is not there or not as it should be."""
    from sim2real.task.pushing import read_push, windows

    turn, radii = _turn(options.force), options.tip_radius
    if len(radii) > 2:
        raise ValueError(f"--tip-radius: expected one number or two, got {len(radii)}")
    with np.load(options.file, allow_pickle=False) as data:
        names = sorted({name.rsplit("/", 1)[0] for name in data.files})
        found = []
        for patterns, radius in ((options.reference, radii[0]), (options.new, radii[-1])):
            chosen = [name for name in names if any(fnmatch.fnmatch(name, pattern) for pattern in patterns)]
            if not chosen:
                raise ValueError(f"{options.file.name}: expected pushes {' '.join(patterns)}, got {', '.join(names)}")
            missing = [f"{n}/{s}" for n in chosen for s in ("ft", "tip", "object") if f"{n}/{s}" not in data.files]
            if missing:
                raise ValueError(f"{options.file.name}: expected {missing[0]}, got no such array")
            streams = ((name, *(_in_order(data[f"{name}/{s}"]) for s in ("ft", "tip", "object"))) for name in chosen)
            found.append(
                [windows(read_push(name, ft[:, :4], tip, pose, turn, radius)) for name, ft, tip, pose in streams]
            )
    if common := {r.name for r in found[0]} & {r.name for r in found[1]}:
        raise ValueError(
            f"expected other new pushes than those of the reference, got {', '.join(sorted(common))} in both"
        )
    return found[0], found[1]


def _in_order(rows: np.ndarray) -> np.ndarray:
    """Rows without the time received; those that came after a later one are left out."""
    stamps = rows[:, 1] if rows.ndim == 2 and rows.shape[1] > 1 else np.zeros(0)
    return rows[np.r_[True, stamps[1:] > np.maximum.accumulate(stamps)[:-1]], 1:] if len(stamps) else rows


def _turn(text: str) -> np.ndarray:
    """Rows (3, 3) of a text like -y,-x,z: the signed axis of the sensor along each of the world's. Raises ValueError."""
    words = text.split(",")
    if len(words) != 3 or sorted(word.lstrip("+-") for word in words) != ["x", "y", "z"]:
        raise ValueError(f"--force: expected three signed axes such as -y,-x,z, got {text}")
    turn = np.zeros((3, 3))
    for row, word in enumerate(words):
        turn[row, AXES[word[-1]]] = -1.0 if word.startswith("-") else 1.0
    return turn


def _in_full(change) -> dict:
    gains = {"/".join(effect): float(gain) for effect, gain in change.gains.items()}
    return {**_in_short(change), "gains_nats": gains, "misfit": change.misfit, "strained": list(change.strained)}


def _in_short(change) -> dict:
    named = [
        {
            "effect": list(one.effect),
            "gain_nats": float(one.gain),
            "sizes": [vars(size) for size in one.sizes],
            "rivals": [list(rival) for rival in one.rivals],
            "split_by": one.split_by,
        }
        for one in change.named
    ]
    return {"verdict": change.verdict, "named": named}


def _figures(alone: dict, others: dict) -> dict:
    """Of the new pushes alone, how often each class was named, and named and nothing else; false alarms of the reference."""
    classes = [["/".join(one["effect"]) for one in found["named"]] for found in alone.values()]
    counted = {
        name: sum(name in named for named in classes) for name in sorted({n for named in classes for n in named})
    }
    return {
        "new": len(alone),
        "named": counted,
        "named_alone": {name: sum(named == [name] for named in classes) for name in counted},
        "unexplained": sum(found["verdict"] == "unexplained" for found in alone.values()),
        "reference": len(others),
        "false_alarms": sum(found["verdict"] != "no_gap" for found in others.values()),
    }


def _without_folder(word: str) -> str:
    return Path(word).name if word.startswith("/") else word


if __name__ == "__main__":
    sys.exit(main())
