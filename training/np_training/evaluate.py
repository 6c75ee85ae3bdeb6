"""Success of trained policies in the batched simulator: deterministic actions, one episode a world, tightest limits.

    python -m np_training.evaluate --checkpoint runs/card/checkpoint.pt [--student FILE] --episodes 1000 --conditions paper
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from pathlib import Path

import torch

from np_bringup.intervals import wilson_interval
from np_description.domains import DOMAINS, find_domain
from np_description.panda import NOMINAL
from np_policy import hand_pose
from np_policy.action import TIGHT
from np_policy.networks import PreContactStudent
from np_policy.weights import load
from np_training import contact
from np_training.distill import student_input
from np_training.environment import Environment, EnvironmentConfig, Starts, pre_contact_state
from np_training.networks import ActorCritic
from np_training.physics import PhysicsConfig
from np_training.randomisation import NOMINAL_CONDITIONS, PAPER, Conditions
from np_training.tasks import sample_tasks


def evaluate(environment: Environment, networks: ActorCritic, student: PreContactStudent | None = None) -> dict:
    """One episode in every world; an episode whose contact is infeasible counts as failed."""
    env, worlds = environment, environment.config.worlds
    env.limits = TIGHT
    objects, goals = sample_tasks(env.domain, worlds, env.generator)
    state = pre_contact_state(objects, goals)
    with torch.no_grad():
        action = networks.pre(state)
        if student is None:
            contacts = contact.resolve(env.domain, action, objects)
        else:
            noise = env.config.conditions.keypoint_noise
            pose = hand_pose.decode(student(student_input(env.domain, objects, goals, noise)))
            contacts = contact.reach(env.domain, *pose, objects)
    feasible = contacts.feasible
    everyone = dataclasses.replace(contacts, feasible=torch.ones_like(feasible))
    env.starts = Starts(objects, goals, state, action, torch.zeros(worlds, device=env.device), everyone,
                        torch.zeros_like(feasible))
    env.reset(torch.arange(worlds, device=env.device))
    ended = torch.zeros(worlds, dtype=torch.bool, device=env.device)
    result = {name: torch.zeros(worlds, dtype=torch.bool, device=env.device) for name in ("success", "lost", "timeout")}
    length = torch.zeros(worlds, device=env.device)
    fast, strong, steps = 0.0, 0.0, 0
    speed_limit = torch.tensor(NOMINAL.velocity_limit, device=env.device)
    torque_limit = torch.tensor(NOMINAL.torque_limit, device=env.device)
    for _ in range(env.config.limit):
        with torch.no_grad():
            out = env.step(networks.post(env.observe()[0]))
        alive = ~ended
        fast += float(((env.physics.qvel[:, :7].abs() > speed_limit).any(-1) & alive).sum())
        strong += float(((env.physics.ctrl[:, :7].abs() >= torque_limit).any(-1) & alive).sum())
        steps += int(alive.sum())
        for name, mask in result.items():
            mask |= out[name] & alive
        length = torch.where(out["done"] & alive, env.age.float(), length)
        ended |= out["done"]
    success = int((result["success"] & feasible).sum())
    low, high = wilson_interval(success, worlds)
    return {"success": success / worlds, "ci95": [round(low, 4), round(high, 4)], "episodes": worlds,
            "infeasible": int((~feasible).sum()), "lost": int((result["lost"] & feasible).sum()),
            "timeout": int((result["timeout"] & feasible).sum()),
            "mean_steps_to_success": float(length[result["success"]].mean()),
            "share_of_steps_over_velocity_limit": fast / steps, "share_of_steps_at_torque_limit": strong / steps}


def main() -> None:
    """Evaluate a checkpoint; the last line is one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--domain", choices=list(DOMAINS), default="card")
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--student", type=Path)
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--conditions", choices=("nominal", "paper"), default="nominal")
    parser.add_argument("--hold", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--contacts", type=int, default=PhysicsConfig.contacts, help="capacity a world")
    parser.add_argument("--constraints", type=int, default=PhysicsConfig.constraints, help="capacity a world")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    arguments = parser.parse_args()
    begin = time.monotonic()
    conditions: Conditions = PAPER if arguments.conditions == "paper" else NOMINAL_CONDITIONS
    environment = Environment(find_domain(arguments.domain), arguments.device, EnvironmentConfig(
        worlds=arguments.episodes, hold=arguments.hold, seed=arguments.seed, conditions=conditions,
        physics=PhysicsConfig(contacts=arguments.contacts, constraints=arguments.constraints)))
    networks = ActorCritic().to(arguments.device)
    networks.load_state_dict(torch.load(arguments.checkpoint, map_location=arguments.device, weights_only=True)["networks"])
    student = load(PreContactStudent(), arguments.student).to(arguments.device) if arguments.student else None
    figures = evaluate(environment, networks, student)
    print(json.dumps({"conditions": arguments.conditions, "student": bool(student), "seed": arguments.seed, **figures,
                      "wall_s": round(time.monotonic() - begin, 1)}))


if __name__ == "__main__":
    main()
