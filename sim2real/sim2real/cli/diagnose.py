"""`diagnose LOG... --out DIR`: compare recordings of free motion with the nominal arm."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from np_common.cli import Parser
from sim2real.cli.results import report_fault, report_violation

NO_FAULT = "No convention is contradicted: order, signs, units, frames, clocks and pictures, as far as the recordings show them."

if TYPE_CHECKING:  # what is slow to import comes after the options are read
    from sim2real.arm.model import Arm
    from sim2real.recordings.signals import Log


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="diagnose", description=__doc__)
    parser.add_argument(
        "logs",
        nargs="+",
        type=Path,
        metavar="LOG",
        help="rosbag2 folder, or .npz file with t_s, q_rad, dq_rad_s, tau_J_Nm (torque with gravity); "
        "nothing may touch the arm in it",
    )
    parser.add_argument("--out", type=Path, help="folder for report.json and report.html")
    parser.add_argument(
        "--wiring",
        action="store_true",
        help="only name a wrong convention of the recordings, which may be of anything: joint order, sign, unit, frame, clock, picture",
    )
    parser.add_argument("--no-hand", action="store_true", help="the flange was bare")
    parser.add_argument(
        "--rigid-body", action="store_true", help="nominal arm without joint friction, damping and rotors"
    )
    parser.add_argument(
        "--reference",
        nargs="+",
        type=Path,
        default=[],
        metavar="OLD",
        help="recordings of the same arm when it was well: what changed since is explained, not what the nominal arm lacks",
    )
    parser.add_argument(
        "--effort",
        choices=("drive", "sensor", "current"),
        help="which torque is measured: the drives', or that of sensors after the gear (default: inferred from the recording); "
        "or the motors' current in A",
    )
    parser.add_argument(
        "--torque-per-ampere",
        nargs="+",
        type=float,
        metavar="NM",
        help="torque constants at the joints, base to tip, Nm/A: efforts are motor currents (default: estimated)",
    )
    parser.add_argument("--model", type=Path, help="MJCF or URDF file of another arm: its hinges, in its order")
    parser.add_argument(
        "--joints", nargs="+", metavar="NAME", help="hinges of the model that are the arm, base to tip (default: all)"
    )
    parser.add_argument(
        "--tip", metavar="NAME", help="site, body or link of the model at the tool point (default: its last)"
    )
    parser.add_argument(
        "--quick", action="store_true", help="the one best effect, from parts of the recordings; no page"
    )
    parser.add_argument(
        "--patch",
        type=Path,
        help="verify this patch.yaml of the Panda instead: simulate new recordings with it and without",
    )
    options = parser.parse_args(arguments)
    if not (options.out or options.wiring):
        parser.error("the following arguments are required: --out")
    return options


def _load_all(paths: Sequence[Path], arm: Arm) -> list[Log]:
    """Logs of the arm's joints. Raises ContractViolation."""
    from sim2real.recordings.reading import load_log

    logs = []
    for number, path in enumerate(paths):
        print(f"reading {path} ({number + 1} of {len(paths)})", file=sys.stderr)
        logs.append(load_log(path, arm))
    return logs


def _apply_constants(options: argparse.Namespace, logs: list[Log]) -> list[Log]:
    """Logs marked as motor currents where the options state it, as torques where they give the constants. Raises ValueError."""
    from sim2real.recordings.motor_current import apply_torque_constants, mark_as_current

    if not options.torque_per_ampere:
        return [mark_as_current(log) for log in logs] if options.effort == "current" else logs
    if options.effort not in (None, "current"):
        raise ValueError(f"--torque-per-ampere: expected efforts that are currents, got --effort {options.effort}")
    return [apply_torque_constants(log, options.torque_per_ampere) for log in logs]


def _check_free_motion(path: Path, log: Log) -> None:
    """Raises ContractViolation for a log of an episode or of the task suite, in which the hand touches things."""
    from np_description.phases import APPROACH, POST
    from sim2real.recordings.reading import ContractViolation
    from sim2real.task.suite.recording import spans_of

    is_episode = any(state.phase in (APPROACH, POST) for _, state in log.phases)
    if is_episode or spans_of(log):
        got = "a pushing episode" if is_episode else "the task suite"
        raise ContractViolation(
            f"bag {path}: expected free motion of the arm, got {got}, in which the hand touches things: `diagnose_task` reads it"
        )


def verify_patch(options: argparse.Namespace) -> int:
    """A recording beside the simulator with a patch and without it; verification.json, and JSON as the last line."""
    from sim2real.arm.model import panda
    from sim2real.effects.patch import load_patch
    from sim2real.preparation import convert_to_torques
    from sim2real.recordings.reading import ContractViolation
    from sim2real.simulation.verification import verification_sentence, verify_patch, write_verification

    try:
        if options.model or options.no_hand or options.rigid_body:
            raise ValueError("--patch: expected the nominal Panda with its hand, which a patch is made for")
        patch = load_patch(options.patch)
        found = verify_patch(convert_to_torques(_load_all(options.logs, panda()), panda()), patch)
    except (ValueError, FloatingPointError) as error:
        print(f"diagnose: {error}", file=sys.stderr)
        print(json.dumps({"error": str(error)}))
        return 2 if isinstance(error, ContractViolation) else 1
    print(verification_sentence(found))
    for line in found["held_back"]:
        print(f"held back: {line}")
    print(
        json.dumps({**found, "patch": str(options.patch), "verification": str(write_verification(options.out, found))})
    )
    return 0


def _load_nominal_arm(options: argparse.Namespace) -> Arm:
    """The nominal arm that the options name. Raises ValueError for a model that is none."""
    from sim2real.arm.model import panda

    if options.model:
        from sim2real.arm.files import load_arm

        arm = load_arm(options.model, options.joints, options.tip)
        print(f"arm {arm.name}: {', '.join(arm.joints)}", file=sys.stderr)
    elif options.joints or options.tip:
        raise ValueError("--joints and --tip: expected --model with them, the Panda's are known")
    else:
        arm = panda(not options.no_hand)
    return arm.rigid_body_only() if options.rigid_body else arm


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object. Status 2: a log that breaks the contract or a convention."""
    options = parse(arguments)
    if options.patch:
        return verify_patch(options)
    from sim2real import single_thread  # noqa: F401, I001  before NumPy
    from sim2real.diagnosis import diagnose
    from sim2real.consequences import follow_up
    from sim2real.progress import StageProgress
    from sim2real.recordings.reading import ContractViolation
    from sim2real.report.document import write_report
    from sim2real.wiring.check import check_wiring

    began = time.monotonic()
    try:
        arm = _load_nominal_arm(options)
        logs, before = (_apply_constants(options, _load_all(paths, arm)) for paths in (options.logs, options.reference))
        effort = "drive" if options.torque_per_ampere else options.effort
        for path, log in zip((*options.logs, *options.reference), (*logs, *before)):
            if not options.wiring:
                _check_free_motion(path, log)
            if fault := check_wiring(path, arm, log):
                return report_fault(fault, path, options.out)
        if options.wiring:
            print(NO_FAULT)
            print(json.dumps({"verdict": "no_fault"}))
            return 0
        total, part = sum(log.duration for log in logs), "parts of " if options.quick else ""
        other = f"{sum(log.duration for log in before):.0f} s of the arm as it was" if before else "the nominal arm"
        print(f"comparing {part}{total:.0f} s with {other}", file=sys.stderr)
        progress = StageProgress(options.quick)
        diagnosis = diagnose(logs, arm, reference=before, effort=effort, quick=options.quick, tell=progress.begin)
    except ContractViolation as violation:
        return report_violation(violation)
    except ValueError as error:
        print(f"diagnose: {error}", file=sys.stderr)
        print(json.dumps({"error": str(error)}))
        return 1
    consequences = follow_up(diagnosis, options.quick, progress.begin)
    report = write_report(
        options.out,
        diagnosis,
        logs,
        consequences,
        lambda: time.monotonic() - began,
        options.quick,
        progress.begin,
    )
    progress.end()
    print(report["sentence"])
    gap, held_out = report["gap"], report["held_out"]
    print(
        json.dumps(
            {
                "verdict": report["verdict"],
                "effects": [f"{e['effect']} at {e['component']}" for e in report["effects"] if e["is_added"]],
                "before": gap["before"],
                "after": gap["after"],
                "floor": gap["floor"],
                "held_out": held_out and {name: held_out[name] for name in ("unit", "before", "after", "ci95")},
                "shrink": gap["shrink"],
                "shrink_ci95": gap["shrink_ci95"],
                "report": str(options.out / "report.json"),
                "runtime_s": report["runtime_s"],
            }
        )
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
