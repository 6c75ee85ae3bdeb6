"""The parameters of `franka_driver`."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta
from functools import partial

import numpy as np
from rclpy.node import Node

from np_control.controller import ControllerConfig
from np_control.impedance import DAMPING_RATIO_MAX, DAMPING_RATIO_MIN, STIFFNESS_MAX
from np_control.safety import SafetyLimits
from np_description.calibration import MAX_AGE
from np_description.control_rate import SECOND
from np_description.force_reflex import FORCE_REFLEX, ForceReflex
from np_franka.arm import FrankaArm
from np_franka.checklist import Checklist
from np_franka.driver import Driver
from np_franka.onboard import Onboard
from np_franka.robots import ROBOTS
from np_ros.node import parameter

CONTROLS = ("topic", "onboard")


@dataclass(frozen=True)
class DriverSettings:
    """What the node needs besides its driver. realtime: enforce, or ignore for a simulated robot."""

    robot: str
    hostname: str
    control: str
    calibration: str
    realtime: str
    has_gripper: bool
    priority: int


def declare(node: Node) -> tuple[DriverSettings, Driver]:
    """Declare and read the parameters; the driver they describe, not connected. ValueError, ArmError."""
    settings = _settings(node)
    robot = ROBOTS[settings.robot]
    stiffness, ratio = _gains(node)
    checklist = _checklist(node, settings, stiffness, ratio, robot.limits)
    onboard = _onboard(node, stiffness, ratio, robot.limits)
    reflex = _force_reflex(node)
    if not settings.hostname:
        raise ValueError("parameter hostname: expected the robot's address, got none")
    robot.load()  # a missing package is reported before anything is connected
    arm = FrankaArm(
        partial(robot.open, settings.hostname, enforce_realtime=settings.realtime == "enforce"),
        reflex.torques(robot.limits.torque),
        reflex.wrench(),
    )
    return settings, Driver(arm, robot.limits, checklist, onboard if settings.control == "onboard" else None)


def _settings(node: Node) -> DriverSettings:
    return DriverSettings(
        parameter(node, "robot", "fr3", "fr3, or panda for the original one.", choices=tuple(ROBOTS)),
        parameter(node, "hostname", "", "Address of the robot."),
        parameter(
            node,
            "control",
            "topic",
            "topic: torques come as effort_command, 500 times a second; "
            "onboard: the impedance law runs here in every cycle of the robot.",
            choices=CONTROLS,
        ),
        parameter(node, "calibration", "", "The camera's calibration file; none: a run without a camera."),
        parameter(
            node,
            "realtime",
            "enforce",
            "enforce: refuse to start without a real-time kernel and priority; ignore: only for a simulated robot.",
            choices=("enforce", "ignore"),
        ),
        parameter(node, "gripper", True, "Whether the robot has a Franka Hand."),
        parameter(node, "realtime_priority", 0, "SCHED_FIFO priority; 0: none.", 0, 90),
    )


def _gains(node: Node) -> tuple[np.ndarray, float]:
    """Stiffness (7,) Nm/rad and damping ratio of the controller on board."""
    stiffness = np.array(
        parameter(
            node,
            "stiffness",
            STIFFNESS_MAX.tolist(),
            "On board: stiffness of each joint while holding and on trajectories, Nm/rad.",
        )
    )
    if stiffness.shape != (7,):
        raise ValueError(f"parameter stiffness: expected 7 numbers, got {stiffness.size}")
    ratio = parameter(
        node,
        "damping_ratio",
        1.0,
        "On board: damping ratio while holding and on trajectories.",
        DAMPING_RATIO_MIN,
        DAMPING_RATIO_MAX,
    )
    return stiffness, ratio


def _checklist(
    node: Node, settings: DriverSettings, stiffness: np.ndarray, ratio: float, limits: SafetyLimits
) -> Checklist:
    days = parameter(
        node, "calibration_max_age", MAX_AGE / timedelta(days=1), "Days that a calibration is good for.", 0.0, 3650.0
    )
    return Checklist(settings.calibration, timedelta(days=days), stiffness, np.full(7, ratio), limits)


def _onboard(node: Node, stiffness: np.ndarray, ratio: float, limits: SafetyLimits) -> Onboard:
    latency = parameter(
        node,
        "policy_latency",
        0.02,
        "On board: s from the state that a target is for until it takes effect.",
        0.0,
        1.0,
    )
    timeout = parameter(
        node, "target_timeout", 0.3, "On board: s within which a target must be followed by the next.", 0.05, 10.0
    )
    config = ControllerConfig(stiffness, ratio, policy_latency_ns=round(latency * SECOND))
    return Onboard(config, limits, round(timeout * SECOND))


def _force_reflex(node: Node) -> ForceReflex:
    return ForceReflex(
        parameter(
            node,
            "collision_torque",
            FORCE_REFLEX.torque,
            "External torque of a joint, as a share of its torque limit, at which the robot stops itself.",
            0.05,
            1.0,
        ),
        parameter(node, "collision_force", FORCE_REFLEX.force, "The same for the hand's force, N.", 5.0, 100.0),
        parameter(node, "collision_moment", FORCE_REFLEX.moment, "The same for its moment, Nm.", 1.0, 50.0),
    )
