"""LeRobot drives and records the simulated arm through `lerobot_plugins`, in an environment of its own (docs/guide/lerobot.md)."""

import json

import numpy as np
from graph_tools import card_specs
from lerobot_tools import LOADER, MARKS, RAISE, lerobot, load, record

from np_common.rotations import quaternion_from_matrix
from np_description.domains import CARD, sample_task
from np_description.panda import NOMINAL
from np_perception.pose_estimation import project_keypoints
from np_policy.contract import POST_CONTACT, weights_file
from np_policy.onnx.export import export
from np_policy.policy import PostContactPolicy
from np_ros.processes.graph import NodeSpec

pytestmark = MARKS


def test_lerobot_record_keeps_an_episode_that_its_own_loader_reads(graph, tmp_path):
    graph.start(card_specs(keypoints="truth"))
    record(graph, tmp_path / "card", 15, "--teleop.reset=sim_bridge/reset")
    found = load(graph, tmp_path / "card")
    action = found["action"]
    assert found["episodes"] == 1 and found["fps"] == 10
    assert len(action) > 20 and np.abs(action[-1] - action[0]).max() > 0.1
    assert action.shape[1:] == (7,) and found["observation.state"].shape == (len(action), 51)


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
