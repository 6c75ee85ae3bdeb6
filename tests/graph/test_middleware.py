"""Backend, controller and a client talk over every middleware that is installed beside the one of all other tests."""

import os
import subprocess
import sys

import pytest
from ament_index_python import get_resources
from rclpy import get_rmw_implementation_identifier

from np_ros.processes.graph import NodeSpec

OTHERS = sorted(get_resources("rmw_typesupport").keys() - {"rmw_implementation", get_rmw_implementation_identifier()})
CLIENT = """
import rclpy
from sensor_msgs.msg import JointState
from np_description.message_arrays import joint_state_arrays
from np_description.panda import JOINT_NAMES
from np_ros.client.graph_client import GraphClient

client = GraphClient("client", limit=120.0)
commands = client.collect("effort_command", JointState)
client.wait_until(lambda: client.publishers("effort_command"), what="a controller")
answer = client.call("sim_bridge/reset")
assert answer.success, answer.message
client.wait_until(lambda: len(commands) > 10, what="commands")
joint_state_arrays(commands[-1], JOINT_NAMES)
print(rclpy.get_rmw_implementation_identifier())
client.close()
"""


@pytest.mark.parametrize("middleware", OTHERS)
def test_states_commands_and_services_pass(graph, middleware):
    environment = {"RMW_IMPLEMENTATION": middleware}
    bare = {"mode": "lockstep", "tick_barrier": False}
    nodes = (("np_sim_bridge", "sim_bridge", {**bare, "camera": False}), ("np_control", "joint_impedance", bare))
    graph.start([NodeSpec(package, name, parameters=values) for package, name, values in nodes], environment)
    environment |= {**os.environ, **graph.environment, "RMW_IMPLEMENTATION": middleware}
    done = subprocess.run([sys.executable, "-c", CLIENT], env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == middleware
