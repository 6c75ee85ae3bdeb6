"""The reward: finishing pays, a way back earns nothing, and every touch that a robot must not make has its price."""

from dataclasses import fields

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from np_control.impedance import STIFFNESS_MAX, STIFFNESS_MIN
from np_control.kinematics import forward_kinematics
from np_description.domains import CARD, DOMAINS
from np_description.panda import NOMINAL
from np_description.scene import load_model
from np_training.ppo.config import PPOConfig
from np_training.tasks.registry import find_task
from np_training.tasks.rewards import Measures, PeriodTouch, RewardConfig

NO, YES = torch.tensor([False]), torch.tensor([True])
STILL, SEEN = torch.zeros(1, 6), torch.zeros(1)
GENTLE = PeriodTouch(torch.full((1,), 5.0), torch.zeros(1), NO, YES)


def measures(distance, angle=0.0, hand=0.1, dtype=torch.float32):
    """Of one episode whose corners are all as far from the goal as their mean."""
    one = [torch.tensor([x], dtype=dtype) for x in (distance, angle, hand)]
    return Measures(*one, one[0][:, None].expand(1, 8))


def stiffness(share):
    """Of one episode, (1, 7) Nm/rad, at a share of each joint's range."""
    return torch.tensor((STIFFNESS_MIN + share * (STIFFNESS_MAX - STIFFNESS_MIN))[None])


def test_an_action_that_goes_from_one_end_to_the_other_is_paid_for_where_it_has_a_price():
    at, ends = measures(0.1), torch.full((1, 6), 2.0)
    prices = [
        reward.terms(at, at, NO, NO, stiffness(0.0), GENTLE, ends, SEEN).get("change", torch.zeros(1)).item()
        for reward in (RewardConfig(), RewardConfig(change=0.5, scale=1.0))
    ]
    assert prices == [0.0, -12.0]


def test_what_hides_the_object_from_the_camera_is_paid_for_where_it_has_a_price():
    at = measures(0.1)
    prices = [
        reward.terms(at, at, NO, NO, stiffness(0.0), GENTLE, STILL, torch.tensor([0.5]))
        .get("hidden", torch.zeros(1))
        .item()
        for reward in (RewardConfig(), RewardConfig(hidden=3.0, scale=1.0))
    ]
    assert prices == [0.0, -1.5]


def test_every_term_of_a_step_by_hand():
    """A step from 80 to 30 mm, one radian to a half, the hand from 50 to 20 mm, at half stiffness, with a blow of the housing."""
    reward = RewardConfig(far=500.0, change=2.0, hidden=3.0, scale=0.5)
    touch = PeriodTouch(torch.tensor([45.0]), torch.tensor([0.16]), YES, NO, strictness=0.8)
    step = [measures(0.08, 1.0, 0.05), measures(0.03, 0.5, 0.02)]
    middle = torch.tensor((STIFFNESS_MIN + 0.5 * (STIFFNESS_MAX - STIFFNESS_MIN))[None])
    terms = reward.terms(*step, YES, NO, middle, touch, torch.full((1, 6), 0.5), torch.tensor([0.25]))
    expected = {
        "progress": 10 / 0.05 - 10 / 0.1,
        "far": 500 * 0.05,
        "turn": 150 * 0.5 / np.pi,
        "reach": 10 * 0.3,
        "success": 1000,
        "gains": -0.03 * 7 * 0.5,
        "failure": 0,
        "bare": -10 * (0.25 + 0.75 * 0.8),
        "force": -10 * 0.8 * 4 / 5,  # twice the span beyond what is free
        "touch": -20 * 0.8 * 4 / 5,  # twice the speed
        "change": -2 * 0.8 * 6 * 0.25,
        "hidden": -3 * 0.8 * 0.25,
    }
    assert {name: term.item() for name, term in terms.items()} == pytest.approx(
        {k: 0.5 * v for k, v in expected.items()}
    )
    lost = reward.terms(*step, NO, YES, middle, GENTLE, STILL, SEEN)
    assert lost["failure"].item() == -50 and lost["success"].item() == 0
    assert [lost[name].item() for name in ("bare", "force", "touch")] == [0, 0, 0]


def test_the_reward_of_several_steps_at_once_is_that_of_each():
    generator, reward = torch.Generator().manual_seed(0), RewardConfig(far=500.0, change=2.0, hidden=3.0)

    def drawn(*shape):
        return torch.rand(4, 5, *shape, generator=generator)

    before, after = (Measures(drawn(), drawn(), drawn(), drawn(8)) for _ in range(2))
    touch = PeriodTouch(60 * drawn(), drawn(), drawn() > 0.5, drawn() > 0.5)
    rest = drawn() > 0.5, drawn() > 0.5, 10 + 90 * drawn(7), touch, 4 * drawn(6) - 2, drawn()
    together = reward.terms(before, after, *rest)

    def at(step, part):
        if isinstance(part, torch.Tensor):
            return part[step]
        return type(part)(*(getattr(part, f.name)[step] for f in fields(part) if f.name != "strictness"))

    for step in range(4):
        alone = reward.terms(*(at(step, part) for part in (before, after, *rest)))
        for name, term in alone.items():
            assert term.shape == (5,)
            torch.testing.assert_close(together[name][step], term)


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=lambda d: d.name)
def test_finishing_pays_more_than_hovering_at_the_tolerance(domain):
    """For as long as an episode lasts, with the softest gains and the hand as near as a fingertip can be."""
    reward = RewardConfig()
    discount, limit = PPOConfig().discount, find_task(domain.name).limit
    closest = min(domain.half_size) + 0.0072  # m: half a fingertip, flat on the object's thinnest side
    # A card whose middle is at the goal, turned a little more than the tolerance: its corners are 5 mm off.
    near, goal = measures(0.005, hand=closest), measures(0.010, hand=closest)
    soft = stiffness(0.0)
    hover = (
        sum(reward.terms(near, near, NO, NO, soft, GENTLE, STILL, SEEN).values())
        * (1 - discount**limit)
        / (1 - discount)
    )
    finish = sum(reward.terms(near, goal, YES, NO, soft, GENTLE, STILL, SEEN).values())
    assert finish > hover + 1


@given(st.lists(st.tuples(st.floats(0, 0.5), st.floats(0, np.pi), st.floats(0, 0.5)), min_size=2, max_size=6))
def test_a_way_back_to_where_it_began_earns_nothing(stations):
    config, soft = RewardConfig(far=500.0), torch.full((1, 7), 10.0)
    path = [measures(*s, dtype=torch.float64) for s in (*stations, stations[0])]
    terms = [config.terms(a, b, NO, NO, soft, GENTLE, STILL, SEEN) for a, b in zip(path, path[1:])]
    for name in ("progress", "far", "turn", "reach"):
        assert abs(float(sum(t[name] for t in terms))) < 1e-9


def test_the_middle_between_the_fingertips_is_the_point_that_counts_as_the_fingers():
    model = load_model(CARD)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[:7], data.qpos[7:9] = NOMINAL.ready, 0.004
    mujoco.mj_kinematics(model, data)
    tips = [data.geom(k).xpos for k in range(model.ngeom) if model.geom(k).name.endswith("_tip")]
    assert len(tips) == 2
    assert np.linalg.norm(np.mean(tips, axis=0) - forward_kinematics(data.qpos[:7])[0]) < 1e-3


@pytest.mark.parametrize("strictness, share", [(0.0, 0.25), (0.5, 0.625), (1.0, 1.0)])
def test_prices_on_touches_rise_with_strictness_and_housing_costs_from_the_beginning(strictness, share):
    at, reward = measures(0.1), RewardConfig(scale=1.0)
    blow = PeriodTouch(torch.full((1,), 1e6), torch.full((1,), 1e6), YES, NO, strictness)
    terms = reward.terms(at, at, NO, NO, stiffness(0.0), blow, STILL, SEEN)
    assert terms["bare"].item() == pytest.approx(share * reward.bare)
    assert terms["force"].item() == pytest.approx(strictness * reward.force, rel=1e-4)
    assert terms["touch"].item() == pytest.approx(strictness * reward.touch, rel=1e-4)


def test_a_touch_is_charged_in_full_where_nothing_else_is_said_and_distance_alone_is_not_paid():
    reward, blow = RewardConfig(), (torch.tensor([45.0]), torch.tensor([0.08]), YES, NO)
    steps = [
        reward.terms(measures(0.2), measures(0.1), NO, NO, stiffness(0.0), touch, STILL, SEEN)
        for touch in (PeriodTouch(*blow), PeriodTouch(*blow, strictness=1.0))
    ]
    assert steps[0] == steps[1]
    assert [steps[0][name].item() for name in ("force", "touch", "bare", "far")] == pytest.approx(
        [0.02 * -8, 0.02 * -10, 0.02 * -10, 0]
    )


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=lambda d: d.name)
def test_finishing_with_a_fast_touch_and_hard_pressing_pays_more_than_staying_away(domain):
    """A touch at .3 m/s and a hundred steps at 30 N, then the goal: what it is charged is less than what the goal pays."""
    reward, limit = RewardConfig(), find_task(domain.name).limit
    far, goal, soft = measures(0.15), measures(0.01), stiffness(0.0)
    first = PeriodTouch(torch.full((1,), 60.0), torch.full((1,), 0.3), NO, YES)
    press = PeriodTouch(torch.full((1,), 30.0), torch.zeros(1), NO, YES)
    steps = min(limit, 100)
    earned = (
        sum(reward.terms(far, far, NO, NO, soft, first, STILL, SEEN).values())
        + (steps - 1) * sum(reward.terms(far, far, NO, NO, soft, press, STILL, SEEN).values())
        + sum(reward.terms(far, goal, YES, NO, soft, press, STILL, SEEN).values())
    )
    assert earned > 0.25 * reward.scale * reward.success
