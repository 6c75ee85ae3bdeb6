"""`excite --out BAG [--suite arm|task]`: move the arm through the excitation suite, or through the task suite at an object, and record a bag."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

from sim2real.excitation.contact_suite.suite import FAMILIES, check_families
from sim2real.excitation.suite import FURTHER, NAMES, make_suite
from sim2real.thresholds import THRESHOLDS

from np_common.cli import INTERRUPTED, Parser, Progress, interrupt_on_sigterm, new_folder
from np_description.calibration import CalibrationError, load_calibrated_camera
from np_description.objects.choice import domain_with, embed_object_text
from np_description.weights.provenance import origin
from np_ros.processes.graph import NodeSpec
from np_ros.processes.supervisor import NodeDied, Supervisor
from np_sim_bridge.simulators import SIMULATORS

RUNNING_TIMEOUT = 20.0  # s for the first state of an arm that should be running


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="excite", description=__doc__)
    parser.add_argument(
        "--suite",
        choices=["arm", "task"],
        default="arm",
        help="arm: in the air; task: touches, drags, pushes and a scrape of table and object, planned from where it is seen",
    )
    parser.add_argument("--domain", default="bump", help="task: whose object and obstacles lie there (default bump)")
    parser.add_argument("--object", default="default", help="task: another object of the domain, or a .yaml file")
    parser.add_argument("--seed", type=int, default=0, help="task, sim: where the object lies")
    parser.add_argument("--engine", choices=list(SIMULATORS), default="mujoco", help="sim: whose physics")
    parser.add_argument(
        "--keypoints",
        choices=["truth", "camera"],
        default="truth",
        help="task, sim: projected from the simulated object, or found in images by the released detector",
    )
    parser.add_argument(
        "--calibration", default="", help="task: file of the camera that is believed in; else as trained"
    )
    parser.add_argument(
        "--only",
        nargs="+",
        default=[],
        metavar="EXPERIMENT",
        help=f"instead of all: {', '.join(NAMES)}; beyond the suite {', '.join(FURTHER)}; or a family such as sinusoid. "
        f"task: {', '.join(FAMILIES)}",
    )
    parser.add_argument("--out", type=Path, required=True, help="path of the bag; a number is appended")
    parser.add_argument(
        "--backend",
        choices=["sim", "running"],
        default="sim",
        help="sim: start simulator and controller; running: use those of this ROS domain",
    )
    parser.add_argument(
        "--mode",
        choices=["lockstep", "realtime"],
        default="lockstep",
        help="that of the backend; a real arm is realtime",
    )
    parser.add_argument("--effects", default="", help="sim: file with effects that the simulator carries")
    parser.add_argument("--logs", type=Path, default=Path("runs/excite"), help="folder for logs; a number is appended")
    options = parser.parse_args(arguments)
    try:
        if options.suite == "arm":
            make_suite(options.only)
        else:
            check_families(options.only)
            domain_with(options.domain, options.object)
            load_calibrated_camera(options.calibration)
    except (ValueError, CalibrationError) as error:
        parser.error(str(error))
    if options.effects and options.backend != "sim":
        parser.error("--effects: only a simulator that is started here can carry them")
    return options


def make_graph(
    bag: Path,
    mode: str,
    with_arm: bool = True,
    effects: str = "",
    information: dict | None = None,
    engine: str = "mujoco",
    scene: dict | None = None,
    keypoints: str = "truth",
) -> list[NodeSpec]:
    """The recorder, and with_arm the simulated arm and its controller.

    scene: parameters `domain`, `object`, `seed` and `calibration` of a task, whose keypoints are recorded; None: the arm alone.
    """
    nodes = [
        NodeSpec(
            "np_record",
            "recorder",
            parameters={
                "bag": str(bag),
                "record_images": False,
                "run_info": json.dumps(information or {}, sort_keys=True),
            },
        )
    ]
    if with_arm:
        realtime = 20 if mode == "realtime" else 0
        from_camera = scene is not None and keypoints == "camera"
        carried = {"effects": effects} if effects else {}
        arm = {"mode": mode, "camera": from_camera, **carried, **(scene or {})}
        nodes += [
            replace(SIMULATORS[engine], parameters=arm, realtime=realtime),
            NodeSpec("np_control", "joint_impedance", parameters={"mode": mode}, realtime=realtime),
        ]
        if from_camera:
            seeing = {"mode": mode, "domain": scene["domain"]}
            nodes.append(NodeSpec("np_perception", "keypoint_detector", parameters=seeing))
        elif scene is not None:
            nodes.append(NodeSpec("np_sim_bridge", "keypoint_oracle", parameters={"mode": mode, **carried, **scene}))
    return nodes


def excite(options: argparse.Namespace) -> dict:
    """Run the experiments; what was recorded."""
    from np_diagnosis.nodes.excite_node import READY_TIMEOUT, Exciter  # slow, as what is imported below
    from np_ros.processes.domain import ros_domain_id

    is_sim = options.backend == "sim"
    information = {
        "experiments": options.only or list(NAMES),
        "mode": options.mode,
        "effects": options.effects,
        "revision": origin()["revision"],
    }
    is_task = options.suite == "task"
    if is_task:
        scene = {
            "domain": options.domain,
            "object": embed_object_text(options.domain, options.object),
            "seed": options.seed,
            "calibration": options.calibration,
        }
        information |= {**scene, "suite": "task", "experiments": options.only or list(FAMILIES)}
    nodes = make_graph(
        options.out,
        options.mode,
        is_sim,
        options.effects,
        {**information, "engine": options.engine} if is_sim else information,
        options.engine,
        scene if is_task else None,
        options.keypoints,
    )
    ros_domain = None if is_sim else ros_domain_id()
    bar: Progress | None = None

    def show(name: str, number: int, count: int) -> None:
        nonlocal bar
        if is_task:
            _say(name)
            return
        bar = bar or Progress(round(motion), "excite, s of motion")
        ways = count - len(durations)  # to the first posture, where the arm rests elsewhere
        bar.show(sum(durations[: max(0, number - 1 - ways)]), name)

    durations = [] if is_task else [segment.duration for segment in make_suite(options.only)]
    motion = sum(durations)
    if not is_task and motion < (enough := THRESHOLDS.blocks.shortest):
        _say(
            f"{motion:.1f} s of motion; `diagnose` requires {enough:g} s: name further experiments, or one such as sweep_7"
        )
    with Supervisor(new_folder(options.logs), domain_id=ros_domain) as supervisor:
        supervisor.start(nodes)
        with Exciter(supervisor, lockstep=options.mode == "lockstep", on_segment=show) as exciter:
            limit = READY_TIMEOUT if is_sim else RUNNING_TIMEOUT
            exciter.wait_until_ready({node.name for node in nodes}, limit, _say)
            if is_task:
                domain = domain_with(options.domain, options.object)
                segments = exciter.run_task(domain, options.only, load_calibrated_camera(options.calibration))
            else:
                segments = exciter.run(options.only)
                bar.show(round(motion), "done")
            return {"segments": segments, **exciter.stop_recording()}


def _say(text: str) -> None:
    print(f"excite: {text}", file=sys.stderr, flush=True)


def _what_is_there(out: Path) -> str:
    """What an interrupted run has left of its bag."""
    from np_record.bag import BagError, Recording
    from np_record.bag_writer import INCOMPLETE

    bag = max(out.parent.glob(f"{out.name}_[0-9]*"), default=None)
    if bag is None:
        return "nothing was recorded"
    try:
        with Recording(bag) as recording:
            why = recording.information.get(INCOMPLETE)
    except BagError as error:
        return str(error)
    return f"{bag} ends early: {why}" if why else f"{bag} is complete up to here"


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object."""
    options = parse(arguments)
    from np_ros.client.supervised_client import GraphError

    interrupt_on_sigterm()
    try:
        print(json.dumps(excite(options)))
    except KeyboardInterrupt:
        print(f"interrupted; {_what_is_there(options.out)}", file=sys.stderr)
        return INTERRUPTED
    except (GraphError, NodeDied, TimeoutError, LookupError, ValueError, OSError) as error:
        print(f"excite: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
