"""The fastest plan that `approach` may be asked for is one that the controller follows."""

from np_control.safety import LIMITS
from np_policy.nodes.approach_node import ApproachNode
from np_ros.parameters import list_parameters


def test_the_fastest_plan_is_within_what_the_controller_follows():
    velocity = next(one for one in list_parameters(ApproachNode) if one.name == "velocity")
    assert float(velocity.allowed.split(" to ")[1]) < LIMITS.speed_fraction
