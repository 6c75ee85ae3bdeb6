"""The two rewards: ours by potentials, and the paper's, held to a computation of its own."""

import json
import sys

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from np_common.rotations import matrix_from_quaternion
from np_control.impedance import STIFFNESS_MAX, STIFFNESS_MIN
from np_control.kinematics import forward_kinematics
from np_description.domains import BUMP, CARD, DOMAINS, WALL
from np_description.keypoints import box_keypoints
from np_description.panda import NOMINAL
from np_description.scene import load_model
from np_training import train
from np_training.environment.environment import Environment, EnvironmentConfig
from np_training.physics.batched import ARM, OBJECT_POSITION, OBJECT_QUATERNION
from np_training.ppo.config import PPOConfig
from np_training.ppo.networks import PreContactPolicy
from np_training.tasks.paper_reward import PaperReward
from np_training.tasks.registry import REWARDS, find_task
from np_training.tasks.rewards import Measures, RewardConfig

NO, YES = torch.tensor([False]), torch.tensor([True])
STILL, SEEN = torch.zeros(1, 6), torch.zeros(1)


def measures(distance, angle=0.0, hand=0.1, dtype=torch.float32):
    """Of one episode whose corners are all as far from the goal as their mean."""
    one = [torch.tensor([x], dtype=dtype) for x in (distance, angle, hand)]
    return Measures(*one, one[0][:, None].expand(1, 8))


def stiffness(share):
    """Of one episode, (1, 7) Nm/rad, at a share of each joint's range."""
    return torch.tensor((STIFFNESS_MIN + share * (STIFFNESS_MAX - STIFFNESS_MIN))[None])


def test_a_reward_is_found_by_the_name_that_it_has():
    assert {name: kind.name for name, kind in REWARDS.items()} == {"potentials": "potentials", "paper": "paper"}


def test_an_action_that_goes_from_one_end_to_the_other_is_paid_for_where_it_has_a_price():
    at, ends = measures(0.1), torch.full((1, 6), 2.0)
    prices = [
        reward.terms(at, at, NO, NO, stiffness(0.0), NO, ends, SEEN).get("change", torch.zeros(1)).item()
        for reward in (RewardConfig(), RewardConfig(change=0.5, scale=1.0), PaperReward())
    ]
    assert prices == [0.0, -12.0, 0.0]


def test_what_hides_the_object_from_the_camera_is_paid_for_where_it_has_a_price():
    at = measures(0.1)
    prices = [
        reward.terms(at, at, NO, NO, stiffness(0.0), NO, STILL, torch.tensor([0.5]))
        .get("hidden", torch.zeros(1))
        .item()
        for reward in (RewardConfig(), RewardConfig(hidden=3.0, scale=1.0), PaperReward())
    ]
    assert prices == [0.0, -1.5, 0.0]


@pytest.mark.parametrize("reward", [RewardConfig(), PaperReward()], ids=lambda r: r.name)
@pytest.mark.parametrize("domain", DOMAINS.values(), ids=lambda d: d.name)
def test_finishing_pays_more_than_hovering_at_the_tolerance(reward, domain):
    """By either reward, for as long as an episode lasts, with the softest gains and the hand as near as a fingertip can be."""
    discount, limit = PPOConfig().discount, find_task(domain.name).limit
    closest = min(domain.half_size) + 0.0072  # m: half a fingertip, flat on the object's thinnest side
    # A card whose middle is at the goal, turned a little more than the tolerance: its corners are 5 mm off.
    near, goal = measures(0.005, hand=closest), measures(0.010, hand=closest)
    soft = stiffness(0.0)
    hover = (
        sum(reward.terms(near, near, NO, NO, soft, NO, STILL, SEEN).values()) * (1 - discount**limit) / (1 - discount)
    )
    finish = sum(reward.terms(near, goal, YES, NO, soft, NO, STILL, SEEN).values())
    assert finish > hover + 1


@given(st.lists(st.tuples(st.floats(0, 0.5), st.floats(0, np.pi), st.floats(0, 0.5)), min_size=2, max_size=6))
def test_a_way_back_to_where_it_began_earns_nothing(stations):
    config, soft = RewardConfig(far=500.0), torch.full((1, 7), 10.0)
    path = [measures(*s, dtype=torch.float64) for s in (*stations, stations[0])]
    terms = [config.terms(a, b, NO, NO, soft, NO, STILL, SEEN) for a, b in zip(path, path[1:])]
    for name in ("progress", "far", "turn", "reach"):
        assert abs(float(sum(t[name] for t in terms))) < 1e-9


def box_corners(half_size, position, quaternion):
    """(8, 3): the corners of a box, in any order that is the same for all poses."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    return position + (signs * half_size) @ matrix_from_quaternion(quaternion).T


def paper_reward(domain, qpos, goal_position, goal_quaternion, success, gains):
    """The paper's sum for one world, from its joints, in NumPy and without what the training computes it of."""
    position, quaternion = qpos[OBJECT_POSITION], qpos[OBJECT_QUATERNION]
    apart = np.linalg.norm(
        box_corners(domain.half_size, position, quaternion)
        - box_corners(domain.half_size, goal_position, goal_quaternion),
        axis=1,
    )
    share = [(k - low) / (high - low) for k, low, high in zip(gains, STIFFNESS_MIN, STIFFNESS_MAX)]
    fingers, _ = forward_kinematics(qpos[ARM])
    total = sum(0.02 / (d + 0.02) for d in apart) - np.sqrt(sum(s * s for s in share))
    return total + 1000 * success + 0.03 / np.linalg.norm(fingers - position)


@pytest.mark.parametrize("domain", [CARD, WALL], ids=lambda d: d.name)
def test_the_papers_reward_is_its_sum_at_the_end_of_the_step(domain):
    worlds = 16
    environment = Environment(domain, "cpu", EnvironmentConfig(worlds=worlds, limit=6, reward=PaperReward()))
    torch.manual_seed(3)
    environment.starts = environment.draw_starts(PreContactPolicy(), 400)
    environment.reset(torch.arange(worlds))
    # Half of the goals are where the object is already: these succeed.
    objects = environment.objects
    for mine, theirs in (
        (environment.goals.position, objects.position),
        (environment.goals.quaternion, objects.quaternion),
    ):
        mine[::2] = theirs[::2]
    environment.goal_corners[::2] = torch.tensor(
        np.array([box_keypoints_of(domain, objects, k) for k in range(0, worlds, 2)]), dtype=torch.float32
    )
    action = 0.3 * torch.randn(worlds, 20)
    out = environment.step(action)
    assert set(out["terms"]) == {"corners", "gains", "success", "fingers"}
    assert out["success"].any() and not out["success"].all()
    share = (action.clamp(-1, 1)[:, 6:13].double().numpy() + 1) / 2
    gains = STIFFNESS_MIN * (STIFFNESS_MAX / STIFFNESS_MIN) ** share
    expected = [
        paper_reward(
            domain,
            environment.physics.qpos[k].double().numpy(),
            environment.goals.position[k].double().numpy(),
            environment.goals.quaternion[k].double().numpy(),
            bool(out["success"][k]),
            gains[k],
        )
        for k in range(worlds)
    ]
    np.testing.assert_allclose(out["reward"].numpy() / PaperReward().scale, expected, rtol=1e-4)


def box_keypoints_of(domain, objects, world):
    return box_keypoints(
        np.asarray(domain.half_size),
        objects.position[world].double().numpy(),
        objects.quaternion[world].double().numpy(),
    )


def test_of_the_papers_reward_only_the_contact_out_of_reach_is_c4():
    before, after, soft = measures(0.2), measures(0.1), stiffness(0.5)
    plain = PaperReward().terms(before, after, NO, NO, soft, NO, STILL, SEEN)
    for lost, bare in ((YES, NO), (NO, YES)):
        assert PaperReward().terms(measures(0.01), after, NO, lost, soft, bare, STILL, SEEN) == plain
    assert PaperReward.failure == -100


def test_the_norm_of_the_stiffnesses_is_of_shares_of_their_ranges():
    at = measures(0.1)
    for share in (0.0, 0.5, 1.0):
        gains = PaperReward(scale=1.0).terms(at, at, NO, NO, stiffness(share), NO, STILL, SEEN)["gains"]
        assert gains.item() == pytest.approx(-share * 7**0.5)


def test_the_middle_between_the_fingertips_is_the_point_that_counts_as_the_fingers():
    model = load_model(CARD)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[:7], data.qpos[7:9] = NOMINAL.ready, 0.004
    mujoco.mj_kinematics(model, data)
    tips = [data.geom(k).xpos for k in range(model.ngeom) if model.geom(k).name.endswith("_tip")]
    assert len(tips) == 2
    assert np.linalg.norm(np.mean(tips, axis=0) - forward_kinematics(data.qpos[:7])[0]) < 1e-3


def test_a_run_with_the_papers_reward_says_so(tmp_path, monkeypatch, capsys):
    options = ["train", "--worlds", "8", "--rollout", "3", "--device", "cpu", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", [*options, "--reward", "paper", "--iterations", "2"])
    train.main()
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["reward"] == "paper"
    config = json.loads((tmp_path / "config.json").read_text())
    assert config["setting"]["reward"] == "paper"
    assert config["environment"]["reward"]["distance"] == 0.02 and config["environment"]["reward"]["fingers"] == 0.03
    assert torch.load(tmp_path / "checkpoint.pt", weights_only=True)["setting"]["reward"] == "paper"
    header = (tmp_path / "log.csv").read_text().splitlines()[0].split(",")
    assert {"reward_corners", "reward_fingers"} < set(header) and "reward_turn" not in header
    monkeypatch.setattr(sys, "argv", [*options, "--iterations", "1"])
    with pytest.raises(SystemExit, match="expected a checkpoint of .*'reward': 'potentials'.* got one of .*'paper'"):
        train.main()


@pytest.mark.parametrize("weight", ["far", "turn"])
def test_weights_of_potentials_are_refused_with_the_papers_reward(weight, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["train", "--reward", "paper", f"--{weight}", "7"])
    with pytest.raises(SystemExit):
        train.parse()
    assert f"{weight}: expected --reward potentials" in capsys.readouterr().err
    monkeypatch.setattr(sys, "argv", ["train", "--domain", "bump", f"--{weight}", "7"])
    chosen = train.parse().reward
    assert getattr(chosen, weight) == 7 and chosen.far == (7 if weight == "far" else find_task(BUMP.name).far)
