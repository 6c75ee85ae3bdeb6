"""The task graph: every node that takes part in an episode, as a function of the launch arguments."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from np_bringup import backends
from np_description.calibration import load
from np_description.domains import DOMAINS
from np_description.objects.choice import domain_with, embed_object_text
from np_description.objects.scenarios import COUNT
from np_ros.processes.graph import LaunchArgument, NodeSpec, complete
from np_ros.processes.policy_path import policy_path_nodes

KEYPOINT_SOURCES = ("camera", "truth")
NAMESPACE = re.compile(r"(/[A-Za-z]\w*)+")
_NOT_KEPT = ("bag", "run_info", "namespace", "params_file")  # of a recording: how nodes were started here
LOOP_PRIORITY = 20
"""Priority of first-in-first-out scheduling of a simulated arm and its controller in real time."""
OWNER_PRIORITY = 10
"""The same of `episode`, without whose heartbeat for 120 ms the controller stops the arm."""

ARGUMENTS = (
    LaunchArgument("domain", "card", "Task family: card, bump or wall; it needs released weights."),
    LaunchArgument(
        "object",
        "default",
        "What is moved: default, another row of the domain's table of objects, or a .yaml file of your own.",
    ),
    LaunchArgument("scenario", "0", "1, 2, 3: a fixed task of the domain in every episode; 0: tasks are drawn."),
    LaunchArgument("seed", "0", "With an episode's number it names the task; equal seeds give equal runs in lockstep."),
    LaunchArgument("first_episode", "0", "Number of the episode that the first reset draws."),
    LaunchArgument("mode", "lockstep", "lockstep: time waits for every answer; realtime: it does not."),
    LaunchArgument(
        "keypoints",
        "camera",
        "camera: detected in images; truth: projected from the simulated object, to show what perception costs.",
    ),
    LaunchArgument(
        "contacts",
        "1",
        "How often a contact may be chosen: when the time of one is over the hand lets go and looks again; 1: as in the paper.",
    ),
    LaunchArgument("image_rate", "30", "Images a second of simulated time."),
    LaunchArgument(
        "calibration",
        "",
        "File written by `calibrate`: where the camera is; empty: as trained; none: a real robot, no camera.",
    ),
    LaunchArgument("effects", "", "Patch file of effects that the simulated arm and its view have; empty: nominal."),
    LaunchArgument("weights", "", "Folder with released weights; empty: the project's own."),
    LaunchArgument("bag", "", "Record bags with this path, a number is appended; empty: no recorder."),
    LaunchArgument("record_at_start", "true", "true: record from the start; false: wait for recorder/start."),
    LaunchArgument("namespace", "", "Of all nodes, topics and services, for example /lab; empty: none."),
    LaunchArgument(
        "params_file", "", "YAML file of ROS parameters by node, in place of those of this launch; empty: none."
    ),
    LaunchArgument("run_info", "{}", "JSON object that the recorder keeps in the bag."),
    *backends.ARGUMENTS,
)


def task_graph(arguments: Mapping[str, str]) -> list[NodeSpec]:
    """The nodes for launch arguments. Raises ValueError for an unknown argument or value."""
    given = complete(arguments, ARGUMENTS)
    for name, allowed in (
        ("domain", tuple(DOMAINS)),
        ("keypoints", KEYPOINT_SOURCES),
        ("mode", ("lockstep", "realtime")),
        ("record_at_start", ("true", "false")),
    ):
        if given[name] not in allowed:
            raise ValueError(f"{name}: expected one of {', '.join(allowed)}, got {given[name]!r}")
    backends.check(given)
    elsewhere = {backends.REAL: backends.real_nodes, backends.OWN: backends.own_nodes}.get(given["backend"])
    given["object"] = embed_object_text(given["domain"], given["object"])  # for the bag too, wherever that goes
    seeing = {key: given[key] for key in ("mode", "domain", "object", "calibration")}
    seed, image_rate, contacts = (_integer(given, name) for name in ("seed", "image_rate", "contacts"))
    from_camera = given["keypoints"] == "camera"
    effects = {"effects": given["effects"]} if given["effects"] else {}
    answering = policy_path_nodes(given)
    simulated = [
        NodeSpec(
            backends.SIMULATORS.get(given["backend"], ""),
            given["backend"],
            parameters={
                **seeing,
                "scenario": _integer(given, "scenario"),
                "seed": seed,
                "first_episode": _integer(given, "first_episode"),
                "image_rate": image_rate,
                "camera": from_camera,
                **effects,
            },
            is_required=True,
        ),
        answering["controller"],
    ]
    nodes = [
        *(elsewhere(given) if elsewhere else simulated),
        answering["keypoint_detector"]
        if from_camera
        else NodeSpec("np_sim_bridge", "keypoint_oracle", parameters={**seeing, "seed": seed, **effects}),
        *(answering[name] for name in ("pre_contact", "approach", "post_contact")),
        NodeSpec(
            "np_policy", "episode", parameters={**seeing, "backend": backends.node_name(given), "contacts": contacts}
        ),
    ]
    if given["bag"]:
        nodes.insert(0, _recorder(given, is_simulated=elsewhere is None))
    if given["mode"] == "realtime":
        nodes = [_scheduled(node) for node in nodes]
    if given["namespace"] and not NAMESPACE.fullmatch(given["namespace"]):
        raise ValueError(f"namespace: expected one as /lab, got {given['namespace']!r}")
    if given["params_file"] and not Path(given["params_file"]).is_file():
        raise ValueError(f"params_file: expected a file, got {given['params_file']!r}")
    return [replace(node, namespace=given["namespace"], params_file=given["params_file"]) for node in nodes]


def _scheduled(node: NodeSpec) -> NodeSpec:
    """A node in real time: neither the loop, state in, command out, every 2 ms, nor the heartbeat waits for slow nodes."""
    if node.package == "np_control" or node.executable in backends.BACKENDS:
        return replace(node, realtime=LOOP_PRIORITY)
    return replace(node, realtime=OWNER_PRIORITY) if node.executable == "episode" else replace(node, nice=10)


def check_and_build_graph(arguments: Mapping[str, str]) -> list[NodeSpec]:
    """As `task_graph`, after the files that its nodes load have been checked: a launch with a wrong one starts no node.

    Raises ValueError, OSError or WeightsError.
    """
    nodes = task_graph(arguments)
    given = complete(arguments, ARGUMENTS)
    scenario = _integer(given, "scenario")
    if scenario not in range(COUNT + 1):
        raise ValueError(f"scenario: expected one of 0 to {COUNT}, got {scenario}")
    from np_policy.contract import check_weights

    domain = domain_with(given["domain"], given["object"])
    check_weights(domain, given["weights"])
    if given["keypoints"] == "camera":
        from np_perception.detector import KeypointDetector  # slow

        KeypointDetector(domain, given["weights"])
    if given["effects"]:
        from sim2real.effects.patch import load_patch  # slow

        load_patch(given["effects"])
    if given["calibration"] not in ("", "none"):
        load(given["calibration"])
    return nodes


def _recorder(given: Mapping[str, str], is_simulated: bool) -> NodeSpec:
    """The recorder, with the launch arguments as its run_info and the topics that a bag of an episode requires."""
    information = {**json.loads(given["run_info"]), **{k: v for k, v in given.items() if k not in _NOT_KEPT}}
    required = [
        "joint_states",
        "effort_command",
        "keypoints",
        "episode/tick",
        "episode/phase",
        "goal_pose",
        "target_pose",
        "target_gains",
        "joint_trajectory",
        "pre_contact_pose",
        "gripper_command",
        *(("object_pose", "clock") if is_simulated else ()),
    ]
    return NodeSpec(
        "np_record",
        "recorder",
        parameters={
            "bag": given["bag"],
            "run_info": json.dumps(information, sort_keys=True),
            "record_at_start": given["record_at_start"] == "true",
            "required": ",".join(required),
        },
    )


def _integer(given: Mapping[str, str], name: str) -> int:
    try:
        return int(given[name])
    except ValueError:
        raise ValueError(f"{name}: expected an integer, got {given[name]!r}") from None
