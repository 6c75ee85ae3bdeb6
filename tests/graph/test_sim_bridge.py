"""What only the sim bridge has: its parameters, and the images of its renderers on the topic."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph_tools import refusal
from sensor_msgs.msg import Image, JointState
from sim2real.effects.patch import Patch, PatchEffect, dump_patch

from np_description.domains import BUMP
from np_description.message_arrays import image_array, joint_state_arrays
from np_description.panda import NOMINAL, STATE_NAMES
from np_ros.processes.graph import NodeSpec
from np_ros.processes.supervisor import NodeDied
from np_ros.qos import EVENT
from np_sim_bridge.nodes.sim_bridge_node import main
from np_sim_bridge.renderer import WarpRenderer
from np_sim_bridge.simulation import Simulation


@pytest.mark.parametrize(
    "parameters, text",
    [
        ({"domain": "sphere"}, "expected one of"),
        ({"policy_rate": 3}, "policy_rate: expected a divisor of 500 Hz, got 3"),
        ({"renderer": "vulkan"}, "expected one of"),
        ({"seed": "two"}, "seed"),
        ({"mode": "fast"}, "expected one of"),
    ],
)
def test_a_bad_parameter_ends_the_node_with_the_reason(capfd, parameters, text):
    assert text in refusal(capfd, main, camera=False, **parameters)


def test_the_image_is_that_of_the_task(graph, probe):
    images = probe.collect("camera/image_raw", Image)
    graph.run(
        "np_sim_bridge",
        "sim_bridge",
        {"domain": "bump", "seed": 7, "first_episode": 4, "renderer": "warp", "shadows": False},
    )
    probe.wait_until(lambda: images)
    simulation = Simulation(BUMP, seed=7, first_episode=4)
    expected = WarpRenderer(simulation.model, shadows=False).render(simulation.configuration())
    assert (image_array(images[0]) == expected).all() and np.ptp(expected) > 100


def patch_file(folder, *effects):
    path = folder / "patch.yaml"
    path.write_text(dump_patch(Patch(tuple(PatchEffect(*effect) for effect in effects))))
    return str(path)


def test_an_effect_that_is_not_in_force_as_asked_is_a_warning(graph, probe, tmp_path):
    patch = patch_file(tmp_path, ("coulomb_friction", "panda_joint2", {"level": -5.0}))
    said = probe.collect("diagnostics", DiagnosticArray, EVENT)
    graph.run("np_sim_bridge", "sim_bridge", {"camera": False, "effects": patch})
    told = "coulomb_friction at panda_joint2: asks for a frictionloss of"
    probe.wait_until(
        lambda: any(s.level == DiagnosticStatus.WARN and told in s.message for m in said for s in m.status)
    )


def test_a_second_bridge_refuses_to_start(graph, probe):
    states = probe.collect("joint_states", JointState)
    graph.run("np_sim_bridge", "sim_bridge", {"camera": False})
    probe.wait_until(lambda: states)
    graph.start(NodeSpec("np_sim_bridge", "sim_bridge", "second", {"camera": False}))
    with pytest.raises(NodeDied, match="second ended with status 1") as died:
        probe.wait_until(lambda: False)
    assert "expected nobody else to publish /joint_states in ROS domain" in str(died.value)
    assert "found /sim_bridge: end the other graph" in str(died.value)


def test_of_two_bridges_that_start_at_once_one_stays(graph, probe):
    """Each sees the other's publisher; without a lock both refused, and the domain had no backend."""
    states = probe.collect("joint_states", JointState)
    graph.start([NodeSpec("np_sim_bridge", "sim_bridge", name, {"camera": False}) for name in ("one", "two")])
    with pytest.raises(NodeDied, match="expected nobody else to publish /joint_states in ROS domain") as died:
        probe.wait_until(lambda: False)
    graph.kill(died.value.name)
    other = {"one": "two", "two": "one"}[died.value.name]
    states.clear()
    probe.wait_until(lambda: states)
    assert not graph.ended(other)


def test_the_arm_carries_the_effects_of_a_patch(graph, probe, tmp_path):
    """A bias is read from the first state on; what a backend cannot carry is named in the log."""
    states = probe.collect("joint_states", JointState)
    graph.run(
        "np_sim_bridge",
        "sim_bridge",
        {
            "camera": False,
            "effects": patch_file(
                tmp_path,
                ("encoder_bias", "panda_joint4", {"bias": 0.02}),
                ("stiffness_gain_error", "panda_joint1", {"relative": 0.1}),
            ),
        },
    )
    probe.wait_until(lambda: states)
    position, _, _ = joint_state_arrays(states[0], STATE_NAMES)
    assert np.allclose(position[:7] - NOMINAL.ready, 0.02 * (np.arange(7) == 3), atol=1e-9)
    log = tmp_path / "log"
    probe.wait_until(
        lambda: any(
            "a backend cannot carry: stiffness_gain_error" in path.read_text(errors="replace")
            for path in log.rglob("*")
            if path.is_file()
        )
    )


@pytest.mark.parametrize(
    "content, text",
    [
        ("effects: [{effect: magic, component: arm, parameters: {}}]", "expected an effect of the arm"),
        ("effects: 3", "expected a mapping with the list"),
        (None, "expected a patch.yaml"),
    ],
)
def test_a_patch_that_is_wrong_ends_the_node_with_the_reason(capfd, tmp_path, content, text):
    path = tmp_path / "wrong.yaml"
    if content is not None:
        path.write_text(content)
    assert text in refusal(capfd, main, camera=False, effects=path)
