"""The curriculum: the paper's constants, its stages, how randomisation and practice follow success."""

import numpy as np
import pytest

from np_policy.action import RESIDUAL_LIMITS_FINAL, RESIDUAL_LIMITS_INITIAL
from np_training.ppo.curriculum import STAGES, Curriculum, CurriculumConfig, stage_limits
from np_training.tasks.randomisation import PAPER as PAPER_CONDITIONS
from np_training.tasks.randomisation import ROBUST, find_conditions
from np_training.tasks.rewards import RewardConfig

PAPER = {
    "N_s": (STAGES, 10),
    "success that tightens": (CurriculumConfig().advance_at, 0.8),
    "zeta_0, m": (RESIDUAL_LIMITS_INITIAL.position, 0.06),
    "zeta_0, rad": (RESIDUAL_LIMITS_INITIAL.rotation, 0.1),
    "zeta*, m": (RESIDUAL_LIMITS_FINAL.position, 0.02),
    "zeta*, rad": (RESIDUAL_LIMITS_FINAL.rotation, 0.03),
    "C1, m": (RewardConfig().distance, 0.02),
    "C2": (RewardConfig().success, 1000.0),
    "C3": (RewardConfig().gains, 0.03),
    "C4": (RewardConfig().failure, -100.0),
}


@pytest.mark.parametrize("name", PAPER)
def test_a_constant_is_the_papers(name):
    ours, papers = PAPER[name]
    assert ours == papers


def test_limits_shrink_by_the_same_factor_every_stage():
    for stage in range(STAGES + 2):
        share = min(stage, 10) / 10
        limits = stage_limits(stage)
        assert limits.position == pytest.approx(0.06 * (0.02 / 0.06) ** share)
        assert limits.rotation == pytest.approx(0.1 * (0.03 / 0.1) ** share)


def advanced(curriculum, success, episodes=100, times=1):
    return [curriculum.advance(success, episodes) for _ in range(times)]


def test_a_stage_is_left_at_the_papers_success_and_not_before():
    below, at = Curriculum(100), Curriculum(100)
    assert advanced(below, 0.79) == [False] and below.stage == 0
    assert advanced(at, 0.8) == [True] and at.stage == 1 and at.episodes == 0
    assert at.randomisation == 0


def test_half_a_window_has_to_end_in_a_stage_before_it_is_left():
    curriculum = Curriculum(100)
    assert advanced(curriculum, 1.0, 49) == [False]
    assert advanced(curriculum, 1.0, 1) == [True]
    assert advanced(curriculum, 1.0, 0) == [False] and curriculum.episodes == 0


def test_randomisation_grows_by_success_after_the_limits_are_tight_and_ends_the_stages():
    curriculum = Curriculum(100, CurriculumConfig(growth=4))
    shares, strict = [], []
    for _ in range(STAGES + 4):
        shares.append(curriculum.randomisation)
        strict.append(curriculum.strictness)
        assert advanced(curriculum, 0.79) == [False] and advanced(curriculum, 1.0) == [True]
    assert shares == [0.0] * (STAGES + 1) + [0.25, 0.5, 0.75]
    assert strict == pytest.approx([stage / 14 for stage in range(14)])
    assert curriculum.randomisation == curriculum.strictness == 1.0
    assert advanced(curriculum, 1.0) == [False] and curriculum.stage == curriculum.last == STAGES + 4


@pytest.mark.parametrize(
    "stage, growth, expected", [(7, 1, 7), (STAGES + 1, 1, STAGES + 4), (STAGES + 5, 10, STAGES + 2)]
)
def test_a_checkpoint_of_other_growth_goes_on_with_as_much_randomisation(stage, growth, expected):
    curriculum = Curriculum(100, CurriculumConfig(growth=4))
    curriculum.resume(stage, growth)
    assert curriculum.stage == expected


def test_conditions_grow_from_nominal_to_their_ranges():
    assert ROBUST.at(1.0) == ROBUST and PAPER_CONDITIONS.at(1.0) == PAPER_CONDITIONS
    none = find_conditions("robust", {"goal_in_image": True}).at(0.0)
    fields = {"goal_in_image": True, "force_margin": ROBUST.force_margin, "support": ROBUST.support[1]}
    assert none == find_conditions("nominal", fields)
    widths = [
        [high - low for low, high in (c.mass, c.stiffness, c.size, c.support, c.image_latency, c.delay)]
        + [c.camera_position, c.torque_noise, c.centre]
        for c in map(ROBUST.at, (0.0, 0.25, 0.5, 0.75, 1.0))
    ]
    assert (np.diff(widths, axis=0) > 0).all()
    assert ROBUST.at(0.5).mass == pytest.approx((0.1**0.5, 3**0.5)) and ROBUST.at(0.5).camera_rotation == 0.0015


def test_success_is_a_running_mean_over_the_window():
    curriculum = Curriculum(100)
    advanced(curriculum, 0.4, 20)
    assert curriculum.success == pytest.approx(0.4), "the first episodes count alone"
    advanced(curriculum, 0.6, 25)
    assert curriculum.success == pytest.approx(0.75 * 0.4 + 0.25 * 0.6)
    advanced(curriculum, 0.1, 500)
    assert curriculum.success == pytest.approx(0.1)


def test_a_policy_that_knows_its_task_has_tight_limits_from_the_beginning():
    assert Curriculum(100, CurriculumConfig(residual=False)).limits == stage_limits(STAGES)
    assert Curriculum(100).limits == stage_limits(0)


def test_success_of_practice_is_a_running_mean_over_its_share_of_the_window():
    curriculum = Curriculum(100, practices=2)
    curriculum.practise(1, 1.0, 10)
    assert curriculum.practised == [0.0, pytest.approx(0.2)]
    curriculum.practise(1, 0.4, 500)
    assert curriculum.practised == [0.0, pytest.approx(0.4)], "no more than a window counts"
    single = Curriculum(100, practices=1)
    single.practise(0, 1.0, 10)
    assert single.practised == [pytest.approx(0.1)]


def test_a_curriculum_without_a_choice_has_no_practice_and_grows_in_ten_stages():
    curriculum = Curriculum(100, practices=2)
    assert curriculum.shares == (1.0, 0.0, 0.0) and curriculum.explore == 0.0
    assert curriculum.last == STAGES + 10
    assert Curriculum(100, CurriculumConfig(practice=0.5)).shares == (1.0,), "there is nothing to practise"
    curriculum = Curriculum(100, CurriculumConfig(practice=0.5, explore=0.5), practices=2)
    curriculum.success, curriculum.practised = 0.3, [0.5, 0.0]
    assert curriculum.shares == pytest.approx((0.75, 0.25 * 0.28 / 0.31, 0.25 * 0.03 / 0.31))
    assert curriculum.explore == pytest.approx(0.25)


def test_practice_and_exploration_end_with_success_and_the_rest_is_the_domains_own():
    config = CurriculumConfig(practice=0.5, explore=0.3, practised_at=0.6, kept=0.1)
    curriculum = Curriculum(100, config, practices=2)
    assert curriculum.explore == pytest.approx(0.3)
    assert curriculum.shares == pytest.approx((0.5, 0.25, 0.25))
    curriculum.success, curriculum.practised = 0.3, [0.5, 0.0]
    assert curriculum.explore == pytest.approx(0.15)
    assert curriculum.shares == pytest.approx((0.75, 0.25 * 0.28 / 0.31, 0.25 * 0.03 / 0.31))
    curriculum.success = 0.9
    assert curriculum.explore == 0.0 and curriculum.shares[0] == pytest.approx(0.9)
