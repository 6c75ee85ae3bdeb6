"""`baselines BAG... --out DIR`: what others' identification makes of recordings of the Panda, as patches.

DIR/NAME/patch.yaml for each NAME of paper, sysid_3, sysid_6 and none (np_blind.baselines.methods). Needs no ROS.
The last line printed is one JSON object: rmse in the windows fitted to, physics steps and time of each.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from np_blind.baselines.budget import Budget
from np_common.cli import Parser


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="baselines", description=__doc__.split("\n")[0])
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="rosbag2 folder with effort_command")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    for name, default in vars(Budget()).items():
        parser.add_argument(f"--{name}", type=type(default), default=default)
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Status 2: a recording that breaks its contract."""
    options = parse(arguments)
    # Slow to import, and not needed by --help.
    from sim2real.effects.patch import dump_patch
    from sim2real.recordings.reading import ContractViolation, load_log

    from np_blind.baselines.closed_loop import stretches
    from np_blind.baselines.methods import as_patch, fits
    from np_blind.baselines.plant import panda_plant

    budget, plant = Budget(**{name: getattr(options, name) for name in vars(Budget())}), panda_plant()
    try:
        recorded = [part for path in options.bags for part in stretches(load_log(path))]
        found = fits(plant, recorded, budget, options.seed, _show)
    except ValueError as error:  # a ContractViolation is one
        print(f"baselines: {error}", file=sys.stderr)
        print(json.dumps({"error": str(error)}))
        return 2 if isinstance(error, ContractViolation) else 1
    for fit in found:
        folder = options.out / fit.name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "patch.yaml").write_text(dump_patch(as_patch(plant, fit)), encoding="utf-8")
    print(json.dumps({f.name: {"rmse_rad": f.rmse, "steps": f.steps, "wall_s": round(f.wall_s, 2)} for f in found}))
    return 0


def _show(name: str, done: int, limit: int) -> None:
    print(f"{name}: round {done} of at most {limit}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
