"""The task graph, for every domain: ros2 launch np_bringup task.launch.py [name:=value ...]; --show-args lists arguments."""

from np_bringup.task_graph import ARGUMENTS
from np_bringup.task_graph import check_and_build_graph as graph
from np_ros.processes.graph import launch_description


def generate_launch_description():
    """The same table of nodes, for the launch system of a full ROS 2 installation."""
    return launch_description(ARGUMENTS, graph)


__all__ = ["ARGUMENTS", "generate_launch_description", "graph"]
