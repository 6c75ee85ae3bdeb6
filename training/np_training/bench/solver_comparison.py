"""The fused contact solver beside the library's in one process: agreement, speed, success of episodes, capacities."""

from __future__ import annotations

import argparse
import dataclasses
import gc
from collections.abc import Iterator

import numpy as np
import torch
import warp as wp
from mujoco_warp._src import solver as library

from np_training.bench.measuring import advance_from, make_trainer, measure, parts, record_states, rollout
from np_training.bench.solver_rows import device_data, solve_in_c
from np_training.environment.config import EnvironmentConfig
from np_training.environment.environment import Environment
from np_training.episodes.episodes import run_episodes
from np_training.episodes.evaluation import rate, read_checkpoint
from np_training.physics.batched import OBJECT_POSITION, BatchedPhysics
from np_training.physics.config import PhysicsConfig, physics_for
from np_training.physics.fused_solver.solve import SIZES, misfit, solve
from np_training.ppo.trainer import Trainer
from np_training.setting import domain_of
from np_training.tasks.randomisation import NOMINAL_CONDITIONS

SOLVERS = {"library": library.solve, "fused": solve}
COMPARED = 256  # states, whose solutions and futures are compared
AHEAD = 3  # policy periods of the compared futures: .3 s
DEPTHS = {"as trained": (None, None), "converged": (100, 50)}  # iterations, line search iterations


def compare_solvers(arguments: argparse.Namespace) -> Iterator[dict]:
    """The requested figures, a dictionary after each part, so that a run cut short keeps what it had."""
    setups = {name: setup(arguments, name == "fused") for name in SOLVERS}
    if "agreement" in arguments.parts:
        trainer = make_trainer(
            arguments.domain, arguments.device, COMPARED, 8, 0, arguments.checkpoint, setups["fused"]
        )
        physics = trainer.environment.physics
        if why := misfit(physics.model, physics.data):
            raise ValueError(f"contact {arguments.contact}: the fused solver does not fit: {why}")
        states = record_states(trainer)
        yield {"agreement": agreement(physics)}
        yield {"divergence_mm": divergence(arguments, setups, physics, states)}
        del trainer, physics, states
        release()
    if "speed" in arguments.parts:
        for name, physics_config in setups.items():
            trainer = make_trainer(
                arguments.domain,
                arguments.device,
                arguments.worlds,
                arguments.rollout,
                arguments.seed,
                arguments.checkpoint,
                physics_config,
            )
            yield {f"speed_{name}": speed(trainer, arguments.seconds)}
            if name == "fused":
                yield {"capacity": capacity(trainer)}
            del trainer
            release()
    if "success" in arguments.parts:
        for name, physics_config in setups.items():
            yield {f"success_{name}": success(arguments, physics_config)}
            release()


def setup(arguments: argparse.Namespace, fused: bool) -> PhysicsConfig:
    """The physics of one side."""
    config = physics_for(arguments.contact, contacts=arguments.contacts, constraints=arguments.constraints)
    return dataclasses.replace(config, fused=fused)


def release() -> None:
    """Give the memory of what was deleted back to the device."""
    gc.collect()
    if torch.cuda.is_available():
        torch.cuda.empty_cache()


def agreement(physics: BatchedPhysics) -> dict:
    """Of the physics' states now: relative errors of accelerations against MuJoCo in C (float64, exact) on its own rows.

    error: largest of a world over its largest acceleration, at least 1 m/s^2; slip: error of the object's velocity after a step, m/s.
    """
    names = ("qpos", "qvel", "ctrl", "qacc_warmstart")
    solved = solve_in_c(physics.host_model, {name: getattr(physics.data, name).numpy() for name in names})
    exact = np.stack([rows.acceleration for rows in solved])
    m, found = physics.model, {}
    kept = m.opt.iterations, m.opt.ls_iterations
    for depth, (iterations, ls_iterations) in DEPTHS.items():
        m.opt.iterations, m.opt.ls_iterations = iterations or kept[0], ls_iterations or kept[1]
        for name, method in SOLVERS.items():
            with wp.ScopedDevice(physics.data.qacc.device):
                d = device_data(physics.host_model, solved)
                method(m, d)
            away = np.abs(d.qacc.numpy() - exact)
            error = away.max(1) / np.maximum(1.0, np.abs(exact).max(1))
            found[f"{name}, {depth}"] = {
                "error": spread(error),
                "slip": spread(physics.config.timestep * away[:, 9:12].max(1)),
                "iterations": float(d.solver_niter.numpy().mean()),
                "most_iterations": int(d.solver_niter.numpy().max()),
            }
    m.opt.iterations, m.opt.ls_iterations = kept
    rows = [len(s.wanted) for s in solved]
    return {"states": len(solved), "rows": [min(rows), max(rows)], **found}


def spread(values: np.ndarray) -> dict[str, float]:
    """Median, 99th percentile and largest."""
    median, high, most = np.quantile(values, (0.5, 0.99, 1.0))
    return {"median": float(f"{median:.3g}"), "p99": float(f"{high:.3g}"), "max": float(f"{most:.3g}")}


def divergence(arguments: argparse.Namespace, setups: dict, physics: BatchedPhysics, states: list) -> dict:
    """Distance of the object, mm, between the two solvers' futures of the same states: positions, velocities, commands."""
    ends = {}
    domain = domain_of(read_checkpoint(arguments.checkpoint)[1])
    for name, config in setups.items():
        copy = BatchedPhysics(domain, physics.worlds, arguments.device, config)
        advance_from(copy, states[-1:])
        for _ in range(AHEAD - 1):
            copy.advance()
        ends[name] = copy.qpos[:, OBJECT_POSITION].cpu().numpy()
    return {"seconds": AHEAD / 10, **spread(1e3 * np.linalg.norm(ends["fused"] - ends["library"], axis=1))}


def speed(trainer: Trainer, seconds: float) -> dict:
    """Policy steps a second of rollouts and of whole iterations, physics steps from visited states, and an iteration's parts."""
    physics = trainer.environment.physics

    def iterate() -> int:
        trainer.iterate()
        return trainer.config.rollout

    states = record_states(trainer)
    rates = {
        "trainer": measure(physics, iterate, seconds),
        "rollout": measure(physics, lambda: rollout(trainer), seconds),
        "physics": measure(physics, lambda: advance_from(physics, states), seconds),
    }
    return {
        "worlds": physics.worlds,
        "policy_steps_per_second": {
            name: round(rates[name].steps_per_second / physics.config.substeps) for name in ("trainer", "rollout")
        },
        "physics_steps_per_second": round(rates["physics"].steps_per_second),
        "parts_ms": parts(trainer),
    }


def capacity(trainer: Trainer) -> dict:
    """What a rollout uses: most rows of a world, contacts a world over all worlds, share of worlds for the larger kernels."""
    physics, rows, contacts = trainer.environment.physics, [], []

    def look() -> None:
        rows.append(wp.to_torch(physics.data.nefc).clone())
        contacts.append(wp.to_torch(physics.data.nacon).clone())

    physics.take_overflowed()
    rollout(trainer, look)
    every = torch.cat(rows).float()
    return {
        "most_rows": int(every.max()),
        "mean_rows": round(float(every.mean()), 2),
        "most_contacts_a_world": round(float(torch.cat(contacts).max()) / physics.worlds, 3),
        **{f"share_over_{size}": float((every > size).float().mean()) for size in SIZES},
        "worlds_without_room": int(physics.take_overflowed()),
    }


def success(arguments: argparse.Namespace, physics: PhysicsConfig) -> dict:
    """Success of nominal episodes with the same tasks for both solvers."""
    networks, setting, _ = read_checkpoint(arguments.checkpoint)
    networks.to(arguments.device)
    config = EnvironmentConfig(
        worlds=arguments.episodes,
        limit=setting["limit"],
        damping_floor=setting["damping_floor"],
        force_reflex=False,  # what the policies were trained for shall not count here
        physics=physics,
    )
    environment = Environment(domain_of(setting), arguments.device, config)
    episodes = run_episodes(environment, networks, networks.pre, None, NOMINAL_CONDITIONS, seed=arguments.seed)
    return rate(episodes.of("success"))
