"""LeRobot drives and records the simulated arm through `lerobot_plugins`, in an environment of its own (docs/guide/lerobot.md)."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from graph_tools import card_specs

from np_common.rotations import quaternion_from_matrix
from np_description.domains import CARD, sample_task
from np_description.panda import NOMINAL
from np_perception.pose_estimation import project_keypoints
from np_policy.contract import POST_CONTACT, weights_file
from np_policy.onnx.export import export
from np_policy.policy import PostContactPolicy
from np_ros.processes.graph import NodeSpec

LOADER = os.environ.get("NP_LEROBOT_PYTHON", "")
"""The Python of an environment that has lerobot and the plugins."""
ALLOWED = 400  # s; importing LeRobot takes a minute on a busy machine
pytestmark = [pytest.mark.slow, pytest.mark.skipif(not LOADER, reason="NP_LEROBOT_PYTHON"), pytest.mark.timeout(600)]

LOAD = """
import json, sys
from lerobot.datasets import LeRobotDataset
found = LeRobotDataset("local/card", root=sys.argv[1], video_backend="pyav")
frame = found[len(found) // 2]
moved = float((found[len(found) - 1]["action"] - found[0]["action"]).abs().max())
print(json.dumps({"frames": len(found), "shapes": {k: list(v.shape) for k, v in frame.items() if hasattr(v, "shape")}, "moved": moved}))
"""
RAISE = """
import json, sys, time
import numpy as np
from lerobot_robot_np_franka import NpFranka, NpFrankaConfig
from np_common.rotations import quaternion_from_matrix
from np_control.kinematics import forward_kinematics

with NpFranka(NpFrankaConfig(id="test", keypoints=False, image=False)) as robot:
    def hand():
        found = robot.get_observation()
        position, rotation = forward_kinematics(np.array([found[name] for name in list(found)[:7]]))
        return position, quaternion_from_matrix(rotation)
    start, turn = hand()
    values = [*(start + [0, 0, 0.03]), *turn, *[1e4] * 7, *[1.0] * 7]
    action = dict(zip(robot.action_features, map(float, values)))
    for _ in range(600):
        sent = robot.send_action(action)
        time.sleep(0.1)
        if (rise := hand()[0][2] - start[2]) > 0.02:
            break
print(json.dumps({"rise": rise, "stiffness": max(v for k, v in sent.items() if "stiffness" in k)}))
"""


def lerobot(graph, *command):
    """Run in LeRobot's environment and the graph's ROS domain; what it printed last."""
    foreign = ("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH", "PYTHONPATH", "AMENT_PREFIX_PATH", "VIRTUAL_ENV")
    environment = {key: value for key, value in os.environ.items() if key not in foreign}
    environment |= {"ROS_DOMAIN_ID": str(graph.domain_id), "HF_HUB_OFFLINE": "1", "HF_HOME": str(graph.log_directory)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=ALLOWED)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.splitlines()[-1] if done.stdout else ""


def test_lerobot_record_keeps_an_episode_that_its_own_loader_reads(graph, tmp_path):
    graph.start(card_specs(keypoints="truth"))
    lerobot(
        graph,
        str(Path(LOADER).with_name("lerobot-record")),
        *("--robot.type=np_franka", "--robot.id=test", "--robot.command=watch", "--robot.image=false"),
        *("--teleop.type=np_episode", "--teleop.reset=sim_bridge/reset"),
        *("--dataset.repo_id=local/card", f"--dataset.root={tmp_path / 'card'}", "--dataset.push_to_hub=false"),
        *("--dataset.num_episodes=1", "--dataset.episode_time_s=15", "--dataset.fps=10", "--dataset.single_task=push"),
        "--play_sounds=false",
    )
    found = json.loads(lerobot(graph, LOADER, "-c", LOAD, str(tmp_path / "card")))
    assert found["frames"] > 20 and found["moved"] > 0.1
    assert found["shapes"]["action"] == [7] and found["shapes"]["observation.state"] == [51]


def test_an_action_of_pose_and_gains_moves_the_hand(graph):
    graph.start(
        [
            NodeSpec("np_sim_bridge", "sim_bridge", parameters={"mode": "realtime", "camera": False}),
            NodeSpec("np_control", "joint_impedance", parameters={"mode": "realtime"}),
        ]
    )
    found = json.loads(lerobot(graph, LOADER, "-c", RAISE))
    assert found["rise"] > 0.02 and found["stiffness"] == 400.0


ACT = """
import json, sys
import torch
from lerobot.policies import get_policy_class, make_pre_post_processors
from lerobot.configs import PreTrainedConfig
from lerobot.utils.import_utils import register_third_party_plugins

register_third_party_plugins()
config = PreTrainedConfig.from_pretrained(sys.argv[1])
policy = get_policy_class(config.type).from_pretrained(sys.argv[1], config=config)
before, after = make_pre_post_processors(config, pretrained_path=sys.argv[1])
state = torch.tensor(json.loads(sys.argv[2]), dtype=torch.float32)
policy.reset()
print(json.dumps([after(policy.select_action(before({"observation.state": state})))[0].tolist() for _ in range(2)]))
"""


def test_lerobot_runs_the_policy_as_the_nodes_do(graph, tmp_path):
    file = export(weights_file(POST_CONTACT, CARD), tmp_path)
    lerobot(graph, LOADER, "-m", "lerobot_policy_np", str(file), "card", str(tmp_path / "policy"))
    start, goal = (project_keypoints(CARD, pose) for pose in sample_task(CARD, np.random.default_rng(0)))
    q, dq = np.append(NOMINAL.ready, [0.01, 0.01]), np.linspace(-0.2, 0.2, 9)
    state = [*q, *dq, *np.zeros(9), *start.ravel(), *goal[:, :2].ravel()]
    found = json.loads(lerobot(graph, LOADER, "-c", ACT, str(tmp_path / "policy"), json.dumps(state)))
    policy = PostContactPolicy(file, CARD)
    for action in found:
        target = policy.act(q, dq, start, goal)
        expected = (target.position, quaternion_from_matrix(target.rotation), target.stiffness, target.damping_ratio)
        np.testing.assert_allclose(action, np.concatenate(expected), rtol=1e-4, atol=1e-5)
