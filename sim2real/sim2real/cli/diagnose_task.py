"""`chain BAG... [--out DIR]`: where the gap lies in camera, keypoints, timing, arm, contact, object and table, which effect it is, how large.

Recordings of one set-up: of `excite --suite task`, which all stages have data from, and any others with keypoints, of which the view and the
detector's stage make use. The last line printed is one JSON object; DIR gets chain.json, chain.html and patch.yaml.
"""

from __future__ import annotations

import argparse
import json
import sys
from itertools import accumulate
from pathlib import Path

from np_common.cli import Parser
from sim2real.cli.results import report_violation, write_results

SHARES = {
    "read": 30,
    "scatter": 5,
    "view": 20,
    "touch": 5,
    "force": 5,
    "meeting": 5,
    "lag": 10,
    "motion": 15,
    "page": 5,
}
"""Per cent of the time, about."""


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="chain", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="in the order in which they were recorded")
    parser.add_argument(
        "--calibration", default="", help="camera file that is believed to be right (default: the training camera)"
    )
    parser.add_argument("--without-pose", action="store_true", help="ignore `object_pose`")
    parser.add_argument(
        "--arm",
        type=Path,
        metavar="DIR",
        help="folder of `diagnose_task`: its report.json and patch.yaml are the arm's row",
    )
    parser.add_argument(
        "--held-out",
        type=Path,
        nargs="+",
        default=[],
        metavar="BAG",
        help="further recordings of the task suite, which no stage hears: the patch is held against the object's motion in them",
    )
    parser.add_argument("--out", type=Path, help="folder for chain.json, chain.html and patch.yaml")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Status 2: a recording, a calibration or an arm's answer that breaks its contract."""
    options = parse(arguments)
    # Slow to import, and not wanted by --help.
    from sim2real import single_thread  # noqa: F401, I001  before NumPy
    from np_common.cli import Progress
    from np_description.calibration import CalibrationError, calibrated_camera
    from sim2real.effects.patch import Patch, dump_patch, load_patch
    from sim2real.recordings.reading import ContractViolation
    from sim2real.report.task_sentences import check_schema, document
    from sim2real.task.object_motion.patch_check import withhold_harmful_effects
    from sim2real.task.object_motion.prediction import predict_motion
    from sim2real.task.arm_result import read_arm_result
    from sim2real.task.reading import read_held_out, read_recordings
    from sim2real.task.diagnosis import diagnose_task, make_patch

    progress = Progress(sum(SHARES.values()), "chain")
    begun = dict(zip(SHARES, accumulate(SHARES.values(), initial=0)))

    def tell(stage: str) -> None:
        progress.show(begun[stage], stage)

    try:
        tell("read")
        camera = calibrated_camera(options.calibration)
        arm, panda = None, Patch().panda()
        if options.arm:
            arm = read_arm_result(options.arm)
            panda = load_patch(options.arm / "patch.yaml").panda()
        seen = read_recordings(options.bags, options.calibration, not options.without_pose, camera)
        fresh = read_held_out(options.held_out, seen)
        found = diagnose_task(seen, camera, panda, arm, tell)
    except (CalibrationError, ContractViolation, ValueError) as violation:
        return report_violation(violation)
    tell("motion")
    kept = withhold_harmful_effects(seen.tasks, make_patch(found), camera, panda)
    mended = kept.patch
    moved = fresh or seen.tasks
    predicted = predict_motion(moved, mended, camera, panda, bool(fresh)) if moved else None
    told = document(found, [str(bag) for bag in options.bags], kept, predicted)
    check_schema(told)
    if options.out:
        from sim2real.report.task_page import render  # drawing is slow to import

        tell("page")
        write_results(options.out, "chain", told, lambda: render(found, told, camera))
        (options.out / "patch.yaml").write_text(dump_patch(mended), encoding="utf-8")
    progress.show(sum(SHARES.values()), "done")
    print(told["sentence"])
    print(json.dumps(told))
    return 0


if __name__ == "__main__":
    sys.exit(main())
