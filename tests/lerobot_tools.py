"""LeRobot in an environment of its own (docs/guide/lerobot.md), run by tests against a graph."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

LOADER = os.environ.get("NP_LEROBOT_PYTHON", "")
"""The Python of an environment that has lerobot and the plugins."""
ALLOWED = 600  # s; importing LeRobot takes minutes on a busy machine
MARKS = [pytest.mark.slow, pytest.mark.skipif(not LOADER, reason="NP_LEROBOT_PYTHON"), pytest.mark.timeout(1500)]

LOAD = """
import json, sys
from lerobot.datasets import LeRobotDataset
found = LeRobotDataset("local/card", root=sys.argv[1], video_backend="pyav")
columns = {name: [found[i][name].tolist() for i in range(len(found))] for name in ("observation.state", "action")}
print(json.dumps({"fps": found.fps, "episodes": found.num_episodes, **columns}))
"""
RAISE = """
import json, sys
from contextlib import closing
import numpy as np
from lerobot_robot_np_franka import NpFranka, NpFrankaConfig
from sensor_msgs.msg import JointState
from np_common.rotations import quaternion_from_matrix
from np_control.kinematics import forward_kinematics
from np_ros.client.graph_client import GraphClient

with NpFranka(NpFrankaConfig(id="test", keypoints=False, image=False)) as robot, closing(GraphClient("clock")) as clock:
    def hand():
        found = robot.get_observation()
        position, rotation = forward_kinematics(np.array([found[name] for name in list(found)[:7]]))
        return position, quaternion_from_matrix(rotation)
    start, turn = hand()
    values = [*(start + [0, 0, 0.03]), *turn, *[1e4] * 7, *[1.0] * 7]
    action = dict(zip(robot.action_features, map(float, values)))
    def has_risen():
        sent.update(robot.send_action(action))
        return hand()[0][2] - start[2] > 0.02
    sent = {}
    clock.collect("joint_states", JointState)  # an action for each state that comes
    clock.wait_until(has_risen, 60, "a hand 20 mm higher")
    print(json.dumps({"rise": hand()[0][2] - start[2], "stiffness": max(v for k, v in sent.items() if "stiffness" in k)}))
"""


def lerobot(graph, *command):
    """Run in LeRobot's environment and the graph's ROS domain; what it printed last."""
    foreign = ("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH", "PYTHONPATH", "AMENT_PREFIX_PATH", "VIRTUAL_ENV")
    environment = {key: value for key, value in os.environ.items() if key not in foreign}
    environment |= {"ROS_DOMAIN_ID": str(graph.domain_id), "HF_HUB_OFFLINE": "1", "HF_HOME": str(graph.log_directory)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=ALLOWED)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.splitlines()[-1] if done.stdout else ""


def record(graph, folder, seconds, *more):
    """`lerobot-record` of an episode of the card without the camera.

    folder: of the data set; seconds: that LeRobot records, of the machine's clock; more: further arguments.
    """
    lerobot(
        graph,
        str(Path(LOADER).with_name("lerobot-record")),
        *("--robot.type=np_franka", "--robot.id=test", "--robot.command=watch", "--robot.image=false"),
        *("--teleop.type=np_episode", *more, "--dataset.repo_id=local/card", f"--dataset.root={folder}"),
        *("--dataset.num_episodes=1", f"--dataset.episode_time_s={seconds}", "--dataset.fps=10"),
        *("--dataset.single_task=push", "--dataset.push_to_hub=false", "--play_sounds=false"),
    )


def load(graph, folder):
    """What LeRobot's own loader reads: columns `observation.state` (N, 51), `action` (N, 7), and `fps`, `episodes`."""
    found = json.loads(lerobot(graph, LOADER, "-c", LOAD, str(folder)))
    return {**found, "observation.state": np.array(found["observation.state"]), "action": np.array(found["action"])}
