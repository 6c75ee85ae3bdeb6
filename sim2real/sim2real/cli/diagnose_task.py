"""`diagnose_task BAG... [--out DIR]`: the gap of camera, keypoints, timing, arm, contact, object and table: which effect, and how large.

Recordings of one set-up: of `excite --suite task`, which all stages have data from, and any others with keypoints, which the camera and the
keypoint stage use. The last line printed is one JSON object; DIR gets task.json, task.html and patch.yaml.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from itertools import accumulate
from pathlib import Path

from np_common.cli import Parser
from sim2real.cli.results import report_fault, report_violation, write_results

SHARES = {
    "read": 30,
    "scatter": 5,
    "view": 20,
    "touch": 5,
    "meeting": 5,
    "force": 5,
    "untouched": 2,
    "lag": 8,
    "motion": 15,
    "page": 5,
}
"""Approximate share of the time, per cent."""


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="diagnose_task", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="recordings in the order of time")
    parser.add_argument("--calibration", default="", help="file of the nominal camera (default: the training camera)")
    parser.add_argument("--without-pose", action="store_true", help="ignore `object_pose`")
    parser.add_argument(
        "--arm", type=Path, metavar="DIR", help="folder of `diagnose`: its report.json and patch.yaml are the arm's row"
    )
    parser.add_argument(
        "--held-out",
        type=Path,
        nargs="+",
        default=[],
        metavar="BAG",
        help="recordings of the task suite that no stage uses: the patch is tried on the object's motion in them",
    )
    parser.add_argument("--out", type=Path, help="folder for task.json, task.html and patch.yaml")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Status 2: a recording, a calibration or an arm report that breaks its contract."""
    options = parse(arguments)
    # Slow to import, and not needed by --help.
    from sim2real import single_thread  # noqa: F401, I001  before NumPy
    from np_common.cli import Progress
    from np_description.calibration import CalibrationError, load_calibrated_camera
    from sim2real.effects.patch import Patch, dump_patch, load_patch
    from sim2real.recordings.reading import ContractViolation
    from sim2real.report.task_document import check_schema, document
    from sim2real.task.arm_result import read_arm_result
    from sim2real.task.diagnosis import diagnose_task
    from sim2real.task.object_motion.patch_check import check_patch
    from sim2real.task.object_motion.prediction import predict_motion
    from sim2real.arm.model import panda as nominal_arm
    from sim2real.wiring.check import check_wiring
    from sim2real.task.reading import read_held_out, read_recordings
    from sim2real.task.suite.recording import correct_encoders

    progress = Progress(sum(SHARES.values()), "task")
    begun = dict(zip(SHARES, accumulate(SHARES.values(), initial=0)))

    def on_stage(stage: str) -> None:
        progress.show(begun[stage], stage)

    try:
        on_stage("read")
        camera = load_calibrated_camera(options.calibration)
        arm, arm_patch = None, Patch()
        if options.arm:
            arm = read_arm_result(options.arm)
            arm_patch = load_patch(options.arm / "patch.yaml")
        panda, encoder_bias = arm_patch.panda(), arm_patch.per_joint("encoder_bias", "bias")
        for bag in options.bags:
            if fault := check_wiring(bag, nominal_arm()):
                return report_fault(fault, bag, options.out)
        recordings = read_recordings(options.bags, options.calibration, not options.without_pose, camera)
        held_out = tuple(correct_encoders(t, encoder_bias) for t in read_held_out(options.held_out, recordings))
        recordings = replace(recordings, tasks=tuple(correct_encoders(t, encoder_bias) for t in recordings.tasks))
        diagnosis = diagnose_task(recordings, camera, panda, arm, on_stage)
    except (CalibrationError, ContractViolation, ValueError) as violation:
        return report_violation(violation)
    on_stage("motion")
    kept = check_patch(recordings.tasks, diagnosis, camera, panda)
    moved = held_out or recordings.tasks
    predicted = predict_motion(moved, kept.patch, camera, panda, bool(held_out)) if moved else None
    report = document(diagnosis, [str(bag) for bag in options.bags], kept, predicted)
    check_schema(report)
    if options.out:
        from sim2real.report.task_page import render  # drawing is slow to import

        on_stage("page")
        write_results(options.out, "task", report, lambda: render(diagnosis, report, camera))
        (options.out / "patch.yaml").write_text(dump_patch(kept.patch), encoding="utf-8")
    progress.show(sum(SHARES.values()), "done")
    print(report["sentence"])
    print(json.dumps(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
