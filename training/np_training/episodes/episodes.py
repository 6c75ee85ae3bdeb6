"""Episodes of trained policies, one in every world, with mean actions at zeta*; what became of each."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch

from np_description.contact.depths import DepthHistogram
from np_description.objects.scenarios import make_fixed_task
from np_description.panda import NOMINAL
from np_description.scene import SUPPORT_SHARE
from np_policy.action import RESIDUAL_LIMITS_FINAL
from np_training.environment import contact
from np_training.environment.environment import Environment
from np_training.environment.object_poses import canonical_poses, pre_contact_state
from np_training.physics.batched import ARM
from np_training.physics.batched_forces import FORCE, RAW, SHARE, SPEED
from np_training.ppo.distillation import Student
from np_training.ppo.networks import ActorCritic
from np_training.tasks.breakdown import groups_of_tasks
from np_training.tasks.poses import Poses, edges, sample_tasks
from np_training.tasks.practice import Tasks, scale_poses
from np_training.tasks.randomisation import Conditions

MODES = ("success", "infeasible", "broken", "lost", "stopped", "timeout")
"""How an episode ends: at the goal; without a contact that can be reached; in numbers that are not finite;
with the object off the table; by the robot's reflex; when the time is over."""


@dataclass(frozen=True)
class Episodes:
    """Ended episodes (n,), arrays of NumPy.

    mode: index into MODES; length: policy steps; distance m, angle rad: to the goal at the end; over (2, n,
    7): physics steps beyond the limits of joint velocity and torque; shares (3, n, 7): the largest share of each limit (`np_description.limit_share`)
    that a joint came to; depths: of contact, at the end of each policy step; hidden (n,): how much of its time the arm hid the object from
    the camera (mean of `Sight.hidden`); force (5, n): largest filtered and raw force N, largest share of the force reflex's thresholds, speed of
    a first touch m/s, and 1 where the force reflex stopped it; bare (2, n): policy steps in which the robot, and in which housing or links touched the object; groups: masks (n,) by kind of task (`breakdown.groups`); goals (n, 7): position and quaternion; qpos (steps + 1, n, 16), held still from each
    end on, where it was recorded.
    """

    mode: np.ndarray
    length: np.ndarray
    distance: np.ndarray
    angle: np.ndarray
    over: np.ndarray
    shares: np.ndarray
    depths: DepthHistogram
    hidden: np.ndarray
    force: np.ndarray
    bare: np.ndarray
    groups: dict[str, np.ndarray]
    goals: np.ndarray
    qpos: np.ndarray | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return len(self.mode)

    def of(self, mode: str) -> np.ndarray:
        """Mask (n,) of the episodes that ended so."""
        return self.mode == MODES.index(mode)


def concatenate(parts: list[Episodes]) -> Episodes:
    """All episodes of several runs, without their recordings."""

    def join(name: str, axis: int = 0) -> np.ndarray:
        return np.concatenate([getattr(part, name) for part in parts], axis=axis)

    groups = {name: np.concatenate([part.groups[name] for part in parts]) for name in parts[0].groups}
    return Episodes(
        *(join(name) for name in ("mode", "length", "distance", "angle")),
        join("over", 1),
        join("shares", 1),
        DepthHistogram.joined(part.depths for part in parts),
        join("hidden"),
        join("force", 1),
        join("bare", 1),
        groups,
        join("goals"),
    )


def run_episodes(
    env: Environment,
    networks: ActorCritic,
    chooser: Callable[[torch.Tensor], torch.Tensor],
    student: Student | None = None,
    conditions: Conditions | None = None,
    seed: int | None = None,
    record: bool = False,
    scenario: int = 0,
) -> Episodes:
    """One episode in every world of tasks drawn with `seed`, under conditions (both the environment's, where
    None). scenario: 1 to 3, that fixed task in every world, its start scattered (`np_description.objects.scenarios`); 0: none.

    chooser: the pre-contact policy, state (n, 18) to action (n, 9); a student takes its place. An episode
    whose contact cannot be reached is counted as such and not as what became of it.
    """
    worlds, device = env.config.worlds, env.device
    everyone = torch.arange(worlds, device=device)
    if seed is not None:
        env.generator.manual_seed(seed)
        torch.manual_seed(seed)
    env.config = dataclasses.replace(env.config, conditions=conditions or env.config.conditions, strictness=1.0)
    env.limits = RESIDUAL_LIMITS_FINAL
    one = torch.ones(worlds, device=device)
    # What an earlier run may have left.
    env.physics.varied.resize(everyone, one[:, None].expand(worlds, 3))
    env.physics.varied.shift_centre(everyone, torch.zeros(worlds, 3, device=device))
    env.physics.varied.wear(everyone, *3 * [one[:, None].expand(worlds, 7)])
    env.physics.varied.randomise(everyone, one, one, one, one)
    env.physics.varied.stiffen(everyone, one, one)
    env.physics.varied.bend(everyone, torch.zeros(worlds, 2, device=device), torch.zeros(worlds, 2, 3, device=device))
    env.physics.varied.support(everyone, SUPPORT_SHARE * one[:, None].expand(worlds, 3))
    env.draws.factors.fill_(1.0)
    objects, goals = (
        make_fixed_tasks(env, scenario, seed) if scenario else sample_tasks(env.domain, worlds, env.generator)
    )
    drawn = env.config.conditions
    if drawn.resizes:
        scale = edges(worlds, drawn.size, env.generator)
        objects, goals = (scale_poses(env.domain, poses, scale) for poses in (objects, goals))
    feasible = _start(env, objects, goals, chooser, student)
    env.reset(everyone)

    alive = torch.ones(worlds, dtype=torch.bool, device=device)
    mode = torch.full((worlds,), MODES.index("timeout"), device=device)
    length, distance, angle, hidden = (torch.zeros(worlds, device=device) for _ in range(4))
    over = torch.zeros(2, worlds, 7, device=device)
    shares, tally = torch.zeros(3, worlds, 7, device=device), DepthHistogram()
    force, bare = torch.zeros(5, worlds, device=device), torch.zeros(2, worlds, device=device)
    lower, upper = (torch.tensor(list(end)).to(over) for end in (NOMINAL.position_lower, NOMINAL.position_upper))
    frames = [env.physics.qpos.clone()] if record else []
    for _ in range(env.config.limit):
        with torch.no_grad():
            out = env.step(networks.post(env.observe()[0]))
        over += env.physics.over * alive[:, None]
        hidden += out["hidden"] * alive
        touch, peaks = out["touch"], env.physics.forces.peaks.nan_to_num()
        felt = torch.stack([*peaks[[FORCE, RAW, SHARE, SPEED]], out["pressed"].float()])
        force = torch.where(alive & feasible, force.maximum(felt), force)
        bare += torch.stack([touch.finger | touch.bare, touch.bare]) * (alive & feasible)
        from_middle = (env.physics.qpos[:, ARM] - (lower + upper) / 2).abs() / ((upper - lower) / 2)
        share = torch.cat([env.physics.peak, from_middle[None]])
        shares = torch.where(alive[:, None] & share.isfinite(), shares.maximum(share), shares)
        tally.add_moments(env.physics.contacts.depths()[alive & feasible].cpu().numpy())
        ends = out["done"] & alive
        for name in ("lost", "stopped", "broken", "success"):
            mode[ends & out[name]] = MODES.index(name)
        length[ends] = env.age[ends].float()
        distance[ends], angle[ends] = out["distance"][ends], out["angle"][ends]
        if record:
            frames.append(torch.where(alive[:, None], env.physics.qpos, frames[-1]))
        alive &= ~ends
        if not alive.any():
            break
    mode[~feasible] = MODES.index("infeasible")
    masks = {name: mask.cpu().numpy() for name, mask in groups_of_tasks(env.domain, objects, goals).items()}
    return Episodes(
        *(a.cpu().numpy() for a in (mode, length, distance, angle, over, shares)),
        tally,
        (hidden / length).cpu().numpy(),
        force.cpu().numpy(),
        bare.cpu().numpy(),
        masks,
        torch.cat([goals.position, goals.quaternion], -1).cpu().numpy(),
        torch.stack(frames).cpu().numpy() if record else None,
    )


def make_fixed_tasks(env: Environment, scenario: int, seed: int | None) -> tuple[Poses, Poses]:
    """Starts and goals (worlds,) of a scenario of the domain. Raises ValueError for one that there is not."""
    rng = np.random.default_rng(seed)
    tasks = [make_fixed_task(env.domain, scenario, rng) for _ in range(env.config.worlds)]

    def stacked(name: str, end: int) -> torch.Tensor:
        return torch.tensor(
            np.stack([getattr(task[end], name) for task in tasks]), dtype=torch.float32, device=env.device
        )

    starts, goals = (Poses(stacked("position", end), stacked("quaternion", end)) for end in (0, 1))
    return starts, goals


def _start(
    env: Environment,
    objects: Poses,
    goals: Poses,
    chooser: Callable[[torch.Tensor], torch.Tensor],
    student: Student | None,
) -> torch.Tensor:
    """Put the contacts chosen for the tasks into the pool, all of them; returns which can be reached (n,)."""
    state = pre_contact_state(*canonical_poses(env.domain, objects, goals))
    with torch.no_grad():
        action = chooser(state)
        if student is None:
            contacts = contact.resolve(env.domain, action, objects, hand=env.hand)
        else:
            noise = env.config.conditions.keypoint_noise
            position, rotation, width = student.hand_poses(env.domain, objects, goals, noise, env.view)
            position = contact.draw_out(env.domain, position, rotation, width, objects, env.hand)
            contacts = contact.reach(env.domain, position, rotation, width, objects, hand=env.hand)
    everyone = dataclasses.replace(contacts, feasible=torch.ones_like(contacts.feasible))
    none = torch.zeros(len(state), device=env.device)
    env.starts = env.pool(Tasks(objects, goals, none.long(), none), state, action, none, everyone)
    return contacts.feasible
