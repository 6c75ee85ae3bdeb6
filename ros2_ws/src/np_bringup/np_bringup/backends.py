"""The nodes that own robot and camera: a simulator, or the drivers of the real ones."""

from __future__ import annotations

from collections.abc import Mapping

from np_ros.processes.graph import LaunchArgument, NodeSpec
from np_sim_bridge import simulators

ENGINES = {engine: node.executable for engine, node in simulators.SIMULATORS.items()}
"""Which simulated robot has which engine."""
SIMULATORS = {node.executable: node.package for node in simulators.SIMULATORS.values()}
"""The package of each simulated robot."""
SIMULATED, REAL = ENGINES["mujoco"], "franka_driver"
OWN = "none"
"""A backend that is not ours to start: `backend_node` names its node."""
BACKENDS = (*SIMULATORS, REAL, OWN)
CAMERAS = ("realsense", "none")
CONTROLS = ("topic", "onboard")
ROBOTS = ("fr3", "panda")
DRIVER_PRIORITY, CONTROLLER_PRIORITY = 80, 79  # of first-in-first-out scheduling, on a real robot

ARGUMENTS = (
    LaunchArgument(
        "backend",
        SIMULATED,
        "sim_bridge: simulated robot and camera; physx_bridge: the same in a second engine, which `make physx` installs; "
        "franka_driver: real ones, mode realtime; none: one of your own, started by you.",
    ),
    LaunchArgument(
        "backend_node",
        "",
        "backend none: name of your backend's node, as in its diagnostics. Your camera publishes camera/image_raw and camera/camera_info.",
    ),
    LaunchArgument("robot", "fr3", "franka_driver: fr3, or panda for the original one."),
    LaunchArgument("hostname", "", "franka_driver: address of the robot."),
    LaunchArgument(
        "control",
        "topic",
        "franka_driver, none: topic: the controller is a node; onboard: it runs in the driver, at 1 kHz.",
    ),
    LaunchArgument("camera", "realsense", "franka_driver: realsense: start its node; none: a camera of your own."),
    LaunchArgument(
        "realtime",
        "enforce",
        "franka_driver: enforce: a real-time kernel is required; ignore: a simulated robot.",
    ),
)


def check(given: Mapping[str, str]) -> None:
    """Raises ValueError for arguments that do not go together."""
    for name, allowed in (
        ("backend", BACKENDS),
        ("robot", ROBOTS),
        ("control", CONTROLS),
        ("camera", CAMERAS),
        ("realtime", ("enforce", "ignore")),
    ):
        if given[name] not in allowed:
            raise ValueError(f"{name}: expected one of {', '.join(allowed)}, got {given[name]!r}")
    if (given["backend"] == OWN) != bool(given["backend_node"]):
        raise ValueError(
            f"backend_node: expected the name of your node with backend none, and nothing with another, "
            f"got {given['backend_node']!r} with backend {given['backend']}"
        )
    if given["backend"] in (*SIMULATORS, OWN):
        return
    for name, needed, why in (
        ("mode", "realtime", "a real robot waits for nobody"),
        ("keypoints", "camera", "the true pose of a real object is unknown"),
    ):
        if given[name] != needed:
            raise ValueError(f"{name}: expected {needed} with backend franka_driver ({why}), got {given[name]!r}")
    for name in ("hostname", "calibration"):
        if given[name] in ("", "none"):  # a driver alone may do without a camera, this graph sees
            raise ValueError(f"{name}: expected one with backend franka_driver, got {given[name] or 'none'}")


def real_nodes(given: Mapping[str, str]) -> list[NodeSpec]:
    """Driver, controller and camera of the real robot, for arguments that have been checked."""
    nodes = [
        NodeSpec(
            "np_franka",
            REAL,
            parameters={
                "robot": given["robot"],
                "hostname": given["hostname"],
                "control": given["control"],
                "calibration": given["calibration"],
                "realtime": given["realtime"],
                "realtime_priority": DRIVER_PRIORITY,
            },
        )
    ]
    if given["control"] == "topic":
        nodes.append(
            NodeSpec(
                "np_control",
                "joint_impedance",
                parameters={"mode": "realtime", "realtime_priority": CONTROLLER_PRIORITY},
            )
        )
    if given["camera"] == "realsense":
        parameters = {"calibration": given["calibration"]}
        nodes.append(NodeSpec("np_franka", "realsense_camera", parameters=parameters))
    return nodes


def own_nodes(given: Mapping[str, str]) -> list[NodeSpec]:
    """The nodes beside a backend of the user's own: the controller, unless it has one on board."""
    is_ours = given["control"] == "topic"
    return [NodeSpec("np_control", "joint_impedance", parameters={"mode": given["mode"]})] if is_ours else []


def node_name(given: Mapping[str, str]) -> str:
    """Name of the backend's node, whose diagnostics `episode` reads."""
    return given["backend_node"] or given["backend"]
