"""What only the sim bridge has: its parameters, and the images of its renderers on the topic."""

import numpy as np
import pytest
from np_bringup.supervisor import NodeDied
from np_ros.messages import image_array
from np_sim_bridge.renderer import WarpRenderer
from np_sim_bridge.simulation import Simulation
from np_description.domains import BUMP
from sensor_msgs.msg import Image


@pytest.mark.parametrize("parameters, text", [
    ({"domain": "sphere"}, "expected one of"),
    ({"policy_rate": 3}, "policy_rate: expected a divisor of 500 Hz, got 3"),
    ({"renderer": "vulkan"}, "expected one of"),
    ({"seed": "two"}, "seed"),
    ({"mode": "fast"}, "expected one of"),
])
def test_a_bad_parameter_ends_the_node_with_the_reason(graph, probe, parameters, text):
    graph.run("np_sim_bridge", "sim_bridge", {"camera": False, **parameters})
    with pytest.raises(NodeDied, match="status 1") as died:
        probe.wait_until(lambda: False)
    assert text in str(died.value)


def test_the_image_is_that_of_the_task(graph, probe):
    images = probe.collect("camera/image_raw", Image)
    graph.run("np_sim_bridge", "sim_bridge", {"domain": "bump", "seed": 7, "first_episode": 4, "renderer": "warp",
                                              "shadows": False})
    probe.wait_until(lambda: images)
    simulation = Simulation(BUMP, seed=7, first_episode=4)
    expected = WarpRenderer(simulation.model, shadows=False).render(simulation.configuration())
    assert (image_array(images[0]) == expected).all() and np.ptp(expected) > 100
