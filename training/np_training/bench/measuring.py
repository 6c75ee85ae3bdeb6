"""Physics steps a second of a whole iteration and of its parts: one process, one device, one scene."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import torch
import warp as wp

from np_training.checkpoints import read_state
from np_training.environment import environment as environment_module
from np_training.environment.config import EnvironmentConfig
from np_training.environment.environment import Environment
from np_training.physics.batched import BatchedPhysics
from np_training.physics.config import PhysicsConfig
from np_training.ppo.config import TrainConfig
from np_training.ppo.curriculum import CurriculumConfig
from np_training.ppo.networks import sample
from np_training.ppo.trainer import Trainer
from np_training.tasks.registry import find_task

LEAST_ROUNDS = 2


@dataclass(frozen=True)
class Rate:
    """steps: physics steps of all worlds a second; rounds: measured; contacts: of a world, mean over the
    rounds."""

    steps_per_second: float
    rounds: int
    contacts: float


def measure(physics: BatchedPhysics, one: Callable[[], int], seconds: float) -> Rate:
    """Rate of `one`, which returns the policy periods that it took; called once before the clock starts."""
    one()
    _wait(physics)
    begin, periods, rounds, contacts = time.perf_counter(), 0, 0, 0.0
    spent = 0.0
    while rounds < LEAST_ROUNDS or spent < seconds:
        periods += one()
        rounds += 1
        _wait(physics)
        spent = time.perf_counter() - begin
        # Read between the clock's stops: the read waits for the device.
        contacts += physics.overflow()["contacts"] / physics.worlds
        begin = time.perf_counter() - spent
    return Rate(periods * physics.config.substeps * physics.worlds / spent, rounds, contacts / rounds)


def rollout(trainer: Trainer, visit: Callable[[], None] = lambda: None) -> int:
    """One rollout of the trainer's policies without learning; `visit` is called before each period."""
    env, policy = trainer.environment, trainer.networks.post
    env.starts = env.draw_starts(trainer.networks.pre, env.config.worlds)
    for _ in range(trainer.config.rollout):
        state, _ = env.observe()
        with torch.no_grad():
            action, _ = sample(policy, state)
        visit()
        env.reset(env.step(action)["done"].nonzero()[:, 0])
    return trainer.config.rollout


def record_states(trainer: Trainer) -> list[tuple[torch.Tensor, ...]]:
    """Positions, velocities and commands at each period of a rollout."""
    physics, states = trainer.environment.physics, []
    rollout(
        trainer,
        lambda: states.append(tuple(a.clone() for a in (physics.qpos, physics.qvel, physics.command))),
    )
    return states


def advance_from(physics: BatchedPhysics, states: list[tuple[torch.Tensor, ...]]) -> int:
    """One period from each of the states; two copies of a state cost next to nothing beside it."""
    for qpos, qvel, command in states:
        physics.qpos.copy_(qpos)
        physics.qvel.copy_(qvel)
        physics.command.copy_(command)
        physics.advance()
    return len(states)


def parts(trainer: Trainer) -> dict[str, float]:
    """ms a policy period that the parts of an iteration take, over one iteration, each without what it calls of the
    others, but for inverse kinematics, which stays part of its callers; and the iteration as a whole."""
    env, physics = trainer.environment, trainer.environment.physics
    spent: dict[str, float] = {}
    inside: list[float] = []  # s of the parts called so far by each part under way

    def timed(name: str, function: Callable) -> Callable:
        def call(*arguments):
            _wait(physics)
            inside.append(0.0)
            begin = time.perf_counter()
            answer = function(*arguments)
            _wait(physics)
            whole = time.perf_counter() - begin
            own = whole - inside.pop()
            spent[name] = spent.get(name, 0.0) + (whole if name == "iteration" else own)
            if inside and name != "inverse_kinematics":
                inside[-1] += whole
            return answer

        return call

    places = {
        "draw_starts": (env, "draw_starts"),
        "observe": (env, "observe"),
        "step": (env, "step"),
        "physics": (physics, "advance"),
        "inverse_kinematics": (environment_module, "solve_ik"),
        "reset": (env, "reset"),
        "update": (trainer, "_update"),
    }
    with ExitStack() as stack:
        for name, (owner, attribute) in places.items():
            stack.enter_context(patch.object(owner, attribute, timed(name, getattr(owner, attribute))))
        timed("iteration", trainer.iterate)()
    return {name: round(1e3 * seconds / trainer.config.rollout, 3) for name, seconds in spent.items()}


def make_trainer(
    domain: str,
    device: str,
    worlds: int,
    rollout_steps: int,
    seed: int,
    checkpoint: Path | None,
    physics: PhysicsConfig = PhysicsConfig(),
) -> Trainer:
    """A trainer with the task's own settings, from a checkpoint if there is one."""
    task = find_task(domain)
    config = EnvironmentConfig(worlds=worlds, seed=seed, limit=task.limit, physics=physics)
    curriculum = CurriculumConfig(practice=task.practice, explore=task.explore)
    environment = Environment(task.domain, device, config)
    trainer = Trainer(environment, TrainConfig(rollout=rollout_steps, curriculum=curriculum))
    if checkpoint:
        trainer.load_state_dict(read_state(checkpoint, device))
    return trainer


def _wait(physics: BatchedPhysics) -> None:
    if physics.device.type == "cuda":
        torch.cuda.synchronize(physics.device)
    wp.synchronize_device(wp.get_device(str(physics.device)))
