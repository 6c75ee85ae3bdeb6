"""`feel BAG [--out DIR]`: what the hand felt in the task suite: table and object by touch, friction and mass by force.

A recording of `excite --suite task`. The last line printed is one JSON object; DIR gets feel.json and patch.yaml, with what is named alone
and a simulated scene carries.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from np_common.cli import Parser
from sim2real.cli.answers import refuse


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="feel", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bag", type=Path, metavar="BAG")
    parser.add_argument("--patch", type=Path, help="the arm's own gap, as `diagnose` found it; else the arm is nominal")
    parser.add_argument("--out", type=Path, help="folder for feel.json and patch.yaml")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Status 2: a recording or a patch that breaks its contract."""
    options = parse(arguments)
    # Slow to import, and not wanted by --help.
    from sim2real import single_thread  # noqa: F401, I001  before NumPy
    from np_description.camera import CAMERA
    from sim2real.effects.patch import Patch, dump_patch, load_patch
    from sim2real.recordings.reading import ContractViolation
    from sim2real.report.felt_words import document, patch
    from sim2real.task.contact_force.stage import weigh
    from sim2real.task.suite.recording import read_task
    from sim2real.task.suite.seen import over
    from sim2real.task.surface.stage import feel

    try:
        panda = (load_patch(options.patch) if options.patch else Patch()).panda()
        recording = read_task(options.bag)
        touched = feel(recording, panda)
        forced = weigh(recording, panda, over(CAMERA, touched.lift))
    except (ContractViolation, ValueError) as violation:
        return refuse(violation)
    told = document(touched, forced)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "feel.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
        (options.out / "patch.yaml").write_text(dump_patch(patch(touched, forced)), encoding="utf-8")
    print("\n".join(told["sentences"]))
    print(json.dumps(told))
    return 0


if __name__ == "__main__":
    sys.exit(main())
