"""The nodes from robot state and images to commands, as an episode starts them and as a replay of its recording does again."""

from __future__ import annotations

from collections.abc import Mapping

from np_ros.processes.graph import NodeSpec


def policy_path_nodes(given: Mapping[str, str]) -> dict[str, NodeSpec]:
    """Controller, detector, policies and planner by name, the controller as "controller"; `given`: the launch arguments
    mode, domain, object, calibration, weights and seed."""
    named = {key: given[key] for key in ("mode", "domain")}
    seeing = {**named, "object": given["object"], "calibration": given["calibration"]}
    learned = {**seeing, "weights": given["weights"]}
    return {
        "controller": NodeSpec("np_control", "joint_impedance", parameters={"mode": given["mode"]}),
        "keypoint_detector": NodeSpec(
            "np_perception", "keypoint_detector", parameters={**named, "weights": given["weights"]}
        ),
        "pre_contact": NodeSpec("np_policy", "pre_contact", parameters=learned),
        "approach": NodeSpec("np_policy", "approach", parameters={**seeing, "seed": int(given["seed"])}),
        "post_contact": NodeSpec("np_policy", "post_contact", parameters=learned),
    }
