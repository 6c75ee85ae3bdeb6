"""Training of the policies, tiny, on the CPU: the same code as on a GPU."""

import csv
import dataclasses
import json

import numpy as np
import pytest
import torch

from np_common.rotations import matrix_from_quaternion, rotation_angle
from np_control.impedance import torque
from np_control.kinematics import forward_kinematics, pose_distance
from np_description.domains import BUMP, CARD, DOMAINS, WALL
from np_description.hand import FLAT_HAND, ROUND_HAND
from np_description.panda import NOMINAL
from np_policy import hand_pose
from np_policy.networks import PreContactNetwork
from np_training import train
from np_training.environment import contact
from np_training.environment.config import EnvironmentConfig
from np_training.environment.environment import Environment
from np_training.environment.object_poses import PRE_STATE_SIZE, pre_contact_state
from np_training.episodes.evaluation import evaluate
from np_training.physics.batched import BatchedPhysics
from np_training.physics.config import PhysicsConfig
from np_training.ppo import curriculum
from np_training.ppo import learner as ppo
from np_training.ppo.config import TrainConfig
from np_training.ppo.distillation import Student, distil, shares_with
from np_training.ppo.networks import ActorCritic, PreContactActor, sample
from np_training.ppo.trainer import Trainer
from np_training.reports.releasing import without_optimisers
from np_training.tasks import kinds, practice
from np_training.tasks.bump import YAWS
from np_training.tasks.poses import quarter_tips, sample_tasks
from np_training.tasks.randomisation import PAPER
from np_training.tasks.registry import find_task

WORLDS = 16


@pytest.fixture(scope="module")
def environment() -> Environment:
    """A small environment; its kernels compile once and stay in Warp's cache."""
    env = Environment(CARD, "cpu", EnvironmentConfig(worlds=WORLDS, limit=6))
    torch.manual_seed(0)
    env.starts = env.draw_starts(PreContactActor(), 128)
    env.reset(torch.arange(WORLDS))
    return env


def test_kernel_and_controller_compute_the_same_torque():
    physics = BatchedPhysics(CARD, WORLDS, "cpu", PhysicsConfig(substeps=1))
    generator = torch.Generator().manual_seed(1)
    physics.qpos[:, :7] += 0.2 * torch.randn(WORLDS, 7, generator=generator)
    physics.qvel[:, :7] = 0.5 * torch.randn(WORLDS, 7, generator=generator)
    command = physics.command
    command[0::3] = physics.qpos[:, :7] + 0.02 * torch.randn(2, WORLDS, 7, generator=generator)
    command[1::3] = 10 + 90 * torch.rand(2, WORLDS, 7, generator=generator)
    command[2::3] = 0.5 + 1.5 * torch.rand(2, WORLDS, 7, generator=generator)
    physics.delay[: WORLDS // 2] = 1  # these still follow the command of the period before
    q, dq = physics.qpos[:, :7].clone(), physics.qvel[:, :7].clone()
    bias, gravity = (
        torch.from_numpy(getattr(physics.data, name).numpy()[:, :7].copy()) for name in ("qfrc_bias", "qfrc_gravcomp")
    )
    new = (torch.arange(WORLDS) >= WORLDS // 2)[:, None]
    target, stiffness, ratio = (torch.where(new, command[i + 3], command[i]) for i in range(3))
    expected = torque(*(a.double().numpy() for a in (q, dq, target, stiffness, ratio, bias - gravity)))
    expected = np.clip(expected, -NOMINAL.torque_limit, NOMINAL.torque_limit)
    physics.applied[:] = torch.from_numpy(expected)  # the torque rate is asked of test_impedance
    physics.advance()
    assert np.abs(physics.ctrl[:, :7].numpy() - expected).max() < 1e-5


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=lambda d: d.name)
def test_batched_tasks_keep_to_the_domain(domain):
    starts, goals = sample_tasks(domain, 2000, torch.Generator().manual_seed(2))
    assert ((starts.position - goals.position).norm(dim=-1) >= domain.min_distance).all()
    for axis, bounds in enumerate((domain.start.x, domain.start.y)):
        assert (starts.position[:, axis] >= bounds[0] - 1e-6).all() and (
            starts.position[:, axis] <= bounds[1] + 1e-6
        ).all()
    lowest = min(domain.half_size) + domain.start.surface
    assert (starts.position[:, 2] >= lowest - 1e-6).all()
    assert torch.allclose(goals.quaternion.norm(dim=-1), torch.ones(2000), atol=1e-5)


def test_contacts_put_the_fingertip_over_the_chosen_point():
    objects, _ = sample_tasks(CARD, 500, torch.Generator().manual_seed(3))
    action = torch.zeros(500, contact.SIZE)
    action[:, 0] = torch.linspace(-0.9, 0.9, 500)
    action[:, 3], action[:, 8] = -1.0, 1.0  # closed fingers, centre of the upper face
    contacts = contact.resolve(CARD, action, objects)
    assert contacts.feasible.all()
    distance, angle = pose_distance(contacts.q, contacts.position, contacts.rotation)
    assert distance.max() < 1e-3 and angle.max() < 1e-2
    depth = (
        NOMINAL.frames["hand_finger1"].position[2] + CARD.contact.hand.tip.centre[2]
    )  # of the middle of the fingertips
    tip = contacts.position + contacts.rotation[:, :, 2] * (depth - NOMINAL.frames["hand_tcp"].position[2])
    top = objects.position + torch.tensor([0, 0, CARD.half_size[2]])
    assert (tip - top)[:, :2].norm(dim=-1).max() < 1e-6
    clearance = contact.gripper_clearance(CARD, contacts.q, contacts.width, objects)
    assert torch.allclose(clearance, torch.full_like(clearance, contact.CLEARANCE), atol=1e-3)


@pytest.mark.parametrize("hand", (ROUND_HAND, FLAT_HAND), ids=("round", "flat"))
@pytest.mark.parametrize("domain", DOMAINS.values(), ids=lambda d: d.name)
def test_contacts_keep_the_fingers_off_the_chosen_face(domain, hand):
    generator = torch.Generator().manual_seed(5)
    objects, _ = sample_tasks(domain, 1000, generator)
    action = 2 * torch.rand(1000, contact.SIZE, generator=generator) - 1
    point, normal = contact.surface_point(domain, action[:, 6:], objects)
    local = (matrix_from_quaternion(objects.quaternion).mT @ (point - objects.position)[..., None])[..., 0].abs()
    half_size = torch.tensor(domain.half_size)
    assert (local <= half_size + 1e-6).all() and ((local - half_size).abs() < 1e-6).any(-1).all()
    assert ((point - objects.position) * action[:, 6:]).sum(
        -1
    ).min() > 0  # in the base frame, whatever the object's yaw
    position, rotation, width = contact.contact_pose(domain, action, objects, hand)
    centres, radii = contact.gripper_spheres(position, rotation, width, hand, with_housing=False)
    height = (((centres - point[:, None]) * normal[:, None]).sum(-1) - radii).amin(-1)
    assert torch.allclose(height, torch.full_like(height, contact.CLEARANCE), atol=1e-6)


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.2])
def test_contacts_that_a_student_puts_into_the_object_come_out_before_the_same_face(factor):
    generator = torch.Generator().manual_seed(8)
    objects, _ = sample_tasks(BUMP, 500, generator)
    objects = practice.scale_poses(BUMP, objects, torch.full((500, 3), factor))
    action = 2 * torch.rand(500, contact.SIZE, generator=generator) - 1
    action[:, 6:8] *= 0.3  # near the middle of an upper face
    action[:, 8] = 1.0
    position, rotation, width = contact.contact_pose(BUMP, action, objects)
    assert torch.equal(contact.draw_out(BUMP, position, rotation, width, objects), position)
    _, normal = contact.surface_point(BUMP, action[:, 6:], objects)
    depth = 0.005 + 0.005 * torch.rand(500, generator=generator)
    out = contact.draw_out(BUMP, position - depth[:, None] * normal, rotation, width, objects)
    assert torch.allclose(out, position, atol=1e-6)


@pytest.mark.parametrize("domain", [BUMP, WALL], ids=lambda d: d.name)
def test_most_contacts_of_an_untrained_policy_can_be_reached(domain):
    torch.manual_seed(0)
    objects, goals = sample_tasks(domain, 2000, torch.Generator().manual_seed(6))
    action, _ = PreContactActor().act(pre_contact_state(objects, goals))
    _, normal = contact.surface_point(domain, action.clamp(-1, 1)[:, 6:], objects)
    feasible, side = contact.resolve(domain, action, objects).feasible, normal[:, 2].abs() < 0.5
    assert 0.2 < side.float().mean() < 0.6
    assert feasible[~side].float().mean() > 0.9
    # The wide hand has no room between the wall and the sides of a box that stands before it.
    assert feasible[side].float().mean() > (0.8 if domain is BUMP else 0.25)


def top_of(domain):
    return max(box.centre[2] + box.half_size[2] for box in domain.obstacles)


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=lambda d: d.name)
def test_tasks_of_every_kind_rest_beside_or_on_obstacles_and_come_in_their_shares(domain):
    names = find_task(domain.name).kinds
    shares = tuple(torch.softmax(torch.arange(float(len(names))), 0).tolist())
    tasks = practice.draw_tasks(domain, shares, 4000, torch.Generator().manual_seed(7))
    counts = torch.bincount(tasks.kind, minlength=len(names)) / 4000
    assert torch.allclose(counts, torch.tensor(shares), atol=1e-3)
    half_size = torch.tensor(domain.half_size)
    for poses in (tasks.starts, tasks.goals):
        turned = matrix_from_quaternion(poses.quaternion).abs() @ half_size  # half the box around the object
        bottom = poses.position[:, 2] - turned[:, 2]
        for box in domain.obstacles:
            apart = (
                (poses.position - torch.tensor(box.centre))[:, :2].abs()
                - torch.tensor(box.half_size)[:2]
                - turned[:, :2]
            )
            surface = torch.where((apart > -1e-6).any(-1), 0.0, top_of(domain) - tasks.sunk)
            assert torch.allclose(bottom, surface, atol=1e-6)
        if not domain.obstacles:
            assert torch.allclose(bottom, torch.zeros(()), atol=1e-6)


def test_a_kind_says_how_far_obstacles_are_lowered():
    for domain in (BUMP, WALL):
        names = find_task(domain.name).kinds
        tasks = practice.draw_tasks(domain, (1 / len(names),) * len(names), 3000, torch.Generator().manual_seed(8))
        for number, kind in enumerate(names):
            share = tasks.sunk[tasks.kind == number] / top_of(domain)
            assert (share >= kind.lowered[0] - 1e-6).all() and (share <= kind.lowered[1] + 1e-6).all()
    assert [kind.lowered for kind in names if kind.name.startswith("low")] == [
        (0.75, 1),
        (0.5, 0.75),
        (0.25, 0.5),
        (0, 0.25),
    ]


def test_practice_on_the_bump_turns_little_and_its_own_tasks_turn_much():
    generator = torch.Generator().manual_seed(7)
    for number, kind in enumerate(find_task("bump").kinds):
        shares = tuple(float(k == number) for k in range(len(find_task("bump").kinds)))
        tasks = practice.draw_tasks(BUMP, shares, 3000, generator)
        tips = torch.bincount(quarter_tips(tasks.starts, tasks.goals), minlength=3) / 3000
        if kind.name in ("own", "again"):
            assert tips.min() > 0.1
        elif kind.name.startswith("turn"):
            assert tips[2] == 0 and 0.4 < tips[1] < 0.5  # axes 1 and 2 of 3, two of three turns
        else:
            assert tips[int(kind.name.startswith("roll"))] == 1


def test_what_is_to_be_mended_lies_beside_its_goal_turned_about_the_vertical():
    starts, goals = kinds.mends(BUMP, 2000, torch.Generator().manual_seed(7))
    angle = rotation_angle(starts.quaternion, goals.quaternion)
    assert kinds.LEFT - 1e-3 < angle.min() and angle.max() > 0.95 * torch.pi
    away = (starts.position - goals.position).abs()
    assert (away[:, :2] <= kinds.NEAR + 1e-6).all() and torch.allclose(away[:, 2], torch.zeros(()), atol=1e-6)
    assert (away.norm(dim=-1) < BUMP.min_distance).float().mean() > 0.3  # some where they have to be, but for the turn


def test_practice_is_kept_where_one_says_so():
    configs = (curriculum.CurriculumConfig(practice=0.75, kept=share) for share in (0.4, 0.0))
    kept, gone = (curriculum.Curriculum(10, config, practices=2) for config in configs)
    for one in (kept, gone):
        assert 1 - one.shares[0] == pytest.approx(0.75)
        one.advance(1.0, 100)
    assert 1 - kept.shares[0] == pytest.approx(0.4) and 1 - gone.shares[0] == pytest.approx(0.0)


@pytest.mark.parametrize("name", ["slide", "cross"])
def test_the_grades_of_practice_turn_the_cube_further_and_further(name):
    for grade, yaw in enumerate(YAWS, 1):
        shares = tuple(float(kind.name == f"{name}{grade}") for kind in find_task("bump").kinds)
        tasks = practice.draw_tasks(BUMP, shares, 1000, torch.Generator().manual_seed(9))
        angle = rotation_angle(tasks.starts.quaternion, tasks.goals.quaternion)
        assert 0.9 * yaw < angle.max() <= yaw + 1e-3


def test_a_cube_rolls_the_way_it_moves(monkeypatch):
    monkeypatch.setattr(kinds, "SQUARE", 0.0)
    starts, goals = kinds.rolls(BUMP, 500, torch.Generator().manual_seed(8), yaw=0.0)
    towards = (goals.position - starts.position)[:, 1].sign()
    top = matrix_from_quaternion(starts.quaternion)[:, 2]  # the upward direction, in the object's frame
    now = (matrix_from_quaternion(goals.quaternion) @ top[..., None])[..., 0]
    assert torch.allclose(now, torch.stack([0 * towards, towards, 0 * towards], -1), atol=1e-5)


def test_practice_is_drawn_where_success_varies_and_ends_with_success():
    own = curriculum.Curriculum(100, curriculum.CurriculumConfig(practice=0.75, explore=0.3), practices=3)
    assert own.shares == pytest.approx((0.25, 0.25, 0.25, 0.25)) and own.explore == 0.3
    for _ in range(30):
        for number, success in enumerate((0.0, 0.5, 1.0)):
            own.practise(number, success, 50)
    assert sum(own.shares) == pytest.approx(1) and own.shares[0] == pytest.approx(0.25)
    assert own.shares[2] > 5 * own.shares[1] and own.shares[1] == pytest.approx(own.shares[3], rel=0.01)
    own.advance(0.3, 1000)
    assert own.shares[0] == pytest.approx(1 - 0.75 / 2) and own.explore == pytest.approx(0.15)
    own.advance(0.7, 1000)
    assert own.shares == (1, 0, 0, 0) and own.explore == 0


def test_a_contact_inside_the_table_is_refused():
    objects, _ = sample_tasks(CARD, 50, torch.Generator().manual_seed(4))
    action = torch.zeros(50, contact.SIZE)
    action[:, 8] = -1.0  # the face the card lies on
    assert not contact.resolve(CARD, action, objects).feasible.any()


def test_a_pool_without_contacts_says_so(environment):
    environment_starts = environment.draw_starts(PreContactActor(), 16)
    nowhere = dataclasses.replace(environment_starts.contacts, feasible=torch.zeros(16, dtype=torch.bool))
    with pytest.raises(ValueError, match="at least one feasible contact among 16, found none"):
        dataclasses.replace(environment_starts, contacts=nowhere).take(3)


def test_mass_randomisation_leaves_the_object_where_it_is(environment):
    everyone = torch.arange(WORLDS)
    environment.reset(everyone)
    before = environment.objects.position.clone()
    one = torch.ones(WORLDS)
    environment.physics.varied.randomise(everyone, one, one, torch.linspace(0.7, 1.3, WORLDS))
    environment.physics.advance()
    environment.physics.varied.randomise(everyone, one, one, one)
    assert (environment.objects.position - before).norm(dim=-1).max() < 1e-3


def test_a_tighter_tolerance_asks_for_more(environment):
    before = environment.config
    environment.reset(torch.arange(WORLDS))
    goal, turn = environment.objects.position.clone(), environment.objects.quaternion.clone()
    environment.goals.position[:] = goal + torch.tensor([0.0, 0.8 * CARD.tolerance_position, 0.0])
    environment.goals.quaternion[:] = turn
    succeeded = {}
    for tolerance in (0.5, 1.0):
        environment.config = dataclasses.replace(before, tolerance=tolerance)
        environment.held[:] = 0
        still = torch.zeros(WORLDS, 20)
        succeeded[tolerance] = environment.step(still)["success"].float().mean().item()
    environment.config = before
    assert succeeded[0.5] == 0.0 and succeeded[1.0] > 0.5


def test_a_joint_beyond_its_speed_ends_the_episode_where_the_reflex_is_on(environment):
    before = environment.config
    for reflex in (False, True):
        environment.config = dataclasses.replace(before, reflex=reflex)
        environment.reset(torch.arange(WORLDS))
        environment.physics.qvel[: WORLDS // 2, 0] = 1.2 * NOMINAL.velocity_limit[0]
        out = environment.step(torch.zeros(WORLDS, 20))
        assert out["stopped"][: WORLDS // 2].all() == reflex and not out["stopped"][WORLDS // 2 :].any()
        assert out["done"][out["stopped"]].all() and not (out["stopped"] & (out["lost"] | out["timeout"])).any()
        assert (out["terms"]["failure"] < 0)[out["stopped"]].all()
    environment.config = before


def test_randomised_episodes_stay_sound(environment):
    environment.config = dataclasses.replace(environment.config, conditions=PAPER)
    environment.reset(torch.arange(WORLDS))
    for _ in range(5):
        out = environment.step(torch.randn(WORLDS, 20).clamp(-1, 1))
        assert not out["broken"].any() and torch.isfinite(out["reward"]).all()
        assert all(torch.isfinite(part).all() for part in environment.observe())
        environment.reset(out["done"].nonzero()[:, 0])


def test_advantages_are_the_returns_where_lambda_and_the_values_say_so():
    config = ppo.PPOConfig(discount=0.9, trace=1.0)
    reward = torch.tensor([[1.0], [2.0], [3.0]])
    done = torch.tensor([[False], [True], [False]])
    gain = ppo.advantages(config, reward, done, torch.zeros(3, 1), torch.tensor([10.0]))
    assert torch.allclose(gain[:, 0], torch.tensor([1 + 0.9 * 2, 2.0, 3 + 0.9 * 10]))


def test_a_stage_begun_anew_is_won_anew():
    own = curriculum.Curriculum(100, curriculum.CurriculumConfig(practice=0.75), practices=2)
    own.stage, own.success, own.episodes, own.practised = own.last, 0.99, 5000, [1.0, 0.9]
    own.go_back(curriculum.STAGES)
    assert own.randomisation == 0 and own.shares[0] == pytest.approx(0.25) and own.practised == [0.5, 0.5]
    assert not own.advance(0.5, 60) and own.advance(1.0, 1000) and own.randomisation > 0
    for stage in (-1, curriculum.STAGES + 1):
        with pytest.raises(ValueError, match=f"stage: expected 0 to {curriculum.STAGES}, got {stage}"):
            own.go_back(stage)


def test_curriculum_is_geometric_from_loose_to_tight():
    limits = [curriculum.stage_limits(stage) for stage in range(curriculum.STAGES + 2)]
    ratios = [b.position / a.position for a, b in zip(limits[:-2], limits[1:-1])]
    assert np.allclose(ratios, ratios[0]) and limits[-1] == limits[-2]
    assert np.allclose((limits[0].rotation, limits[-1].rotation), (0.1, 0.03))


def test_training_runs_and_goes_on_where_it_stopped(tmp_path, monkeypatch, capsys):
    command = ["train", "--worlds", "8", "--set", "rollout=3", "--device", "cpu", "--out", str(tmp_path)]
    for iterations, total in ((2, 2), (1, 3)):
        monkeypatch.setattr("sys.argv", [*command, "--iterations", str(iterations)])
        train.main()
        last = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
        assert last["steps"] == total * 8 * 3
    rows = list(csv.DictReader((tmp_path / "log.csv").open()))
    assert [row["iteration"] for row in rows] == ["1", "2", "3"]
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    fresh = ActorCritic()
    fresh.load_state_dict(state["networks"])
    assert state["iteration"] == 3


def test_a_resumed_run_keeps_its_mean_success_and_so_its_practice(environment):
    before = Trainer(environment, TrainConfig(rollout=1))
    before.curriculum.advance(0.5, 3 * before.curriculum.window)
    after = Trainer(environment, TrainConfig(rollout=1))
    after.load_state_dict(before.state_dict())
    after.curriculum.advance(0.0, after.curriculum.window // 4)
    assert after.curriculum.success == pytest.approx(0.375)


def test_both_learners_get_returns_against_their_critics_and_contacts_out_of_reach_count_as_failures(
    environment, monkeypatch
):
    trainer, seen = Trainer(environment, TrainConfig(rollout=3, pre_least=1)), {}
    for name in ("post", "pre"):
        monkeypatch.setattr(
            getattr(trainer, name), "update", lambda samples, name=name: seen.update({name: samples}) or {}
        )
    trainer.iterate()
    for name, critic in (("post", trainer.networks.post_value), ("pre", trainer.networks.pre_value)):
        with torch.no_grad():
            value = critic(seen[name].critic_state)[:, 0]
        torch.testing.assert_close(seen[name].returns - seen[name].advantage, value, atol=1e-4, rtol=1e-4)
    rejected = environment.starts.rejected()
    assert len(rejected) and (seen["pre"].returns[-len(rejected) :] == 0.02 * -100).all()
    assert torch.equal(seen["pre"].state[-len(rejected) :], environment.starts.state[rejected])


def test_a_run_goes_on_from_a_released_checkpoint_at_its_learning_rate(environment):
    before = Trainer(environment, TrainConfig(rollout=1))
    before.post.rate = 7e-5
    released = without_optimisers(before.state_dict())
    assert set(released["post"]) == {"rate"}
    after = Trainer(environment, TrainConfig(rollout=1))
    after.load_state_dict(released)
    assert after.post.rate == pytest.approx(7e-5)
    theirs = before.networks.state_dict()
    assert all(torch.equal(value, theirs[name]) for name, value in after.networks.state_dict().items())
    after.iterate()


def test_rows_that_fill_a_minibatch_up_count_for_nothing():
    def updated(filled: bool) -> tuple[list[torch.Tensor], dict[str, float]]:
        torch.manual_seed(3)
        networks = ActorCritic()
        learner = ppo.Learner(networks.pre, networks.pre_value, ppo.PPOConfig(epochs=2, minibatches=3))
        learner._captures = filled  # as on a GPU, where shapes have to be few
        state = torch.randn(100, PRE_STATE_SIZE)
        action, log_probability = sample(networks.pre, state)
        figures = learner.update(
            ppo.PolicySamples(
                state, state, action.detach(), log_probability.detach(), torch.randn(100), torch.randn(100)
            )
        )
        return [p.detach() for p in networks.parameters()], figures

    (plain, figures), (filled, same) = updated(False), updated(True)
    assert all((a - b).abs().max() < 1e-5 for a, b in zip(plain, filled))
    assert same == pytest.approx(figures, rel=1e-3, abs=1e-6)


def test_actions_are_drawn_no_wider_than_the_setting_once_randomised(environment):
    wide = Trainer(environment, TrainConfig(rollout=1))
    narrow = Trainer(environment, TrainConfig(rollout=1, deviation=0.1))
    narrow.load_state_dict(wide.state_dict())
    narrow.iterate()
    assert narrow.networks.post.log_std.exp().min() > 0.4
    for stage, most in ((curriculum.STAGES + 5, 0.1**0.5), (narrow.curriculum.last, 0.1)):
        narrow.curriculum.stage = stage
        narrow.iterate()
        assert narrow.networks.post.log_std.exp().max() <= most + 1e-6
    assert wide.networks.post.log_std.exp().min() > 0.4


def test_student_output_and_pose_are_inverse():
    q = torch.tensor(NOMINAL.ready) + 0.2 * torch.randn(20, 7, dtype=torch.float64)
    position, rotation = forward_kinematics(q)
    width = torch.linspace(0, 0.04, 20, dtype=torch.float64)
    p, r, w = hand_pose.decode(hand_pose.encode(position, rotation, width))
    assert (p - position).abs().max() < 1e-6 and (r - rotation).abs().max() < 1e-6 and (w - width).abs().max() < 1e-6


def test_distillation_brings_the_student_to_the_teacher():
    torch.manual_seed(5)
    teacher = PreContactActor()
    _, start = distil(CARD, teacher, "cpu", minutes=0, batch=256, steps=5)
    _, end = distil(CARD, teacher, "cpu", minutes=0, batch=256, steps=100)
    assert end["position_mm"] < 0.6 * start["position_mm"]


@pytest.mark.slow
def test_a_student_may_learn_of_practice_that_sinks_no_obstacle():
    shares = shares_with(BUMP, 0.4)
    assert sum(shares) == pytest.approx(1.0) and shares[0] == pytest.approx(0.6)
    kinds = find_task("bump").kinds
    assert {kind.name for kind, share in zip(kinds, shares) if share} == {
        "own",
        "roll1",
        "roll2",
        "roll3",
        "turn2",
        "mend",
        "again",
    }
    assert shares_with(CARD, 0.4) == (1.0,)  # which has no practice
    assert shares_with(BUMP, 0.0) == (1.0,) + (0.0,) * (len(kinds) - 1)
    torch.manual_seed(6)
    teacher = PreContactActor()
    _, start = distil(BUMP, teacher, "cpu", minutes=0, batch=128, steps=5, practice=0.4)
    _, end = distil(BUMP, teacher, "cpu", minutes=0, batch=128, steps=400, practice=0.4)
    assert end["position_mm"] < 0.6 * start["position_mm"]


def test_evaluation_counts_every_episode(environment):
    environment.config = dataclasses.replace(environment.config, limit=3)
    figures = evaluate(environment, ActorCritic(), Student(PreContactNetwork()))
    assert figures["episodes"] == WORLDS
    assert (
        round(figures["success"] * WORLDS)
        + figures["infeasible"]
        + figures["lost"]
        + figures["stopped"]
        + figures["timeout"]
        == WORLDS
    )


def test_a_deviation_at_its_edge_has_a_gradient(environment):
    """Beyond what is drawn it would have none, and a resumed run could not search again."""
    narrow = Trainer(environment, TrainConfig(rollout=1))
    with torch.no_grad():
        narrow.networks.pre.log_std.fill_(-4.0)
    resumed = Trainer(environment, TrainConfig(rollout=1))
    resumed.load_state_dict(narrow.state_dict())
    log_probability = sample(resumed.networks.pre, torch.randn(8, PRE_STATE_SIZE))[1].sum()
    (gradient,) = torch.autograd.grad(log_probability, resumed.networks.pre.log_std)
    assert (gradient != 0).all()
