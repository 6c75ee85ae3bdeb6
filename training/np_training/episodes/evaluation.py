"""Success of trained policies, their forces, and how they fail: played, counted and put into lines."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NoReturn

import numpy as np
from sim2real.effects.patch import Patch

from np_common.intervals import wilson_interval
from np_description import limit_share
from np_description.contact.depths import DepthHistogram
from np_description.domains import find_domain
from np_description.objects.choice import DEFAULT
from np_description.weights.header import read_metadata
from np_policy.contract import POST_CONTACT, PRE_CONTACT, PolicyContract, damping_floor, weights_file
from np_policy.networks import PreContactNetwork
from np_policy.size_generalization import read_size_range
from np_policy.weights import load
from np_training.checkpoints import read_state
from np_training.contracts import make_trained_contract
from np_training.environment.config import EnvironmentConfig
from np_training.environment.environment import Environment
from np_training.episodes.episodes import MODES, Episodes, concatenate, run_episodes
from np_training.episodes.recording import save_recording
from np_training.physics.config import physics_for
from np_training.ppo.distillation import Student
from np_training.ppo.networks import ActorCritic
from np_training.recipe import Judged, read_recipe
from np_training.setting import chosen, domain_of, setting_of
from np_training.tasks.randomisation import Conditions, find_conditions, parse_changes
from np_training.tasks.registry import find_task


def rate(success: np.ndarray) -> dict:
    """Share, 95 % Wilson interval and number of a mask (n,); the share of none is None."""
    count, hits = len(success), int(success.sum())
    low, high = wilson_interval(hits, count) if count else (0.0, 1.0)
    return {
        "success": hits / count if count else None,
        "ci95": [round(low, 4), round(high, 4)],
        "episodes": count,
    }


def summarise(episodes: Episodes, substeps: int) -> dict:
    """The figures of a set of episodes; a policy step has `substeps` physics steps."""
    success, reached = episodes.of("success"), ~episodes.of("infeasible")
    steps = max(float(episodes.length[reached].sum()) * substeps, 1.0)
    over = episodes.over[:, reached].sum(1) / steps
    failures = {}
    for mode in MODES[1:]:
        mask = episodes.of(mode)
        if mask.any():
            failures[mode] = {"episodes": int(mask.sum())}
            if mode != "infeasible":  # these were not played
                failures[mode] |= {
                    "median_end_distance_mm": round(1e3 * float(np.nanmedian(episodes.distance[mask])), 1),
                    "median_end_angle_rad": round(float(np.nanmedian(episodes.angle[mask])), 3),
                }
    return {
        **rate(success),
        **{mode: int(episodes.of(mode).sum()) for mode in MODES[1:]},
        "mean_steps_to_success": float(episodes.length[success].mean()) if success.any() else None,
        "over_velocity_limit": {
            "largest_joint_share": float(over[0].max()),
            "by_joint": [round(float(x), 6) for x in over[0]],
        },
        "over_torque_limit": {
            "largest_joint_share": float(over[1].max()),
            "by_joint": [round(float(x), 6) for x in over[1]],
        },
        "force": force_figures(episodes, reached),
        "hidden_share": round(float(episodes.hidden[reached].mean()), 4) if reached.any() else None,
        "depth_mm": DepthHistogram.summary([episodes.depths]).as_dict(),
        "limit_share": limit_share.summary(episodes.shares[:, reached].transpose(1, 0, 2)),
        "by_group": {name: rate(success[mask]) for name, mask in episodes.groups.items()},
        "failures": failures,
    }


def force_figures(episodes: Episodes, reached: np.ndarray) -> dict:
    """Forces of the episodes in the mask (n,) whose contact was reached: median, 99 % and largest of each episode's largest."""
    if not reached.any():
        return {}
    filtered, raw, share, speed, stopped = episodes.force[:, reached]

    def figures(values: np.ndarray) -> dict[str, float]:
        median, high = np.quantile(values, (0.5, 0.99))
        return {
            "median": round(float(median), 4),
            "q99": round(float(high), 4),
            "largest": round(float(values.max()), 4),
        }

    touching, bare = episodes.bare[:, reached].sum(1)
    return {
        "filtered_n": figures(filtered),
        "raw_n": figures(raw),
        "threshold_share": figures(share),
        "first_touch_m_s": figures(speed),
        "stopped": int(stopped.sum()),
        "over_25_n": int((filtered > 25).sum()),
        "bare_share": round(float(bare / max(touching, 1.0)), 4),
    }


def evaluate(
    environment: Environment,
    networks: ActorCritic,
    student: Student | None = None,
    conditions: Conditions | None = None,
    seeds: tuple[int | None, ...] = (None,),
    record: Path | None = None,
    scenario: int = 0,
) -> dict:
    """One episode in every world for each seed; conditions: None for the environment's own. record: file for the recording of the
    first seed's. scenario: see `run_episodes`."""
    parts = []
    for number, seed in enumerate(seeds):
        recorded = record is not None and number == 0
        parts.append(run_episodes(environment, networks, networks.pre, student, conditions, seed, recorded, scenario))
        if recorded:
            save_recording(record, environment.domain.name, parts[0])
    figures = summarise(concatenate(parts), environment.config.physics.substeps)
    return figures | {"worlds_over_capacity": int(environment.physics.take_overflowed())}


def read_checkpoint(path: Path) -> tuple[ActorCritic, dict, int]:
    """Networks of a training run, its setting, and its policy steps. Raises CheckpointError."""
    state = read_state(path, "cpu")
    networks = ActorCritic()
    networks.load_state_dict(state["networks"])
    return networks, setting_of(state), state["steps"]


def load_released_networks(domain: str) -> tuple[ActorCritic, dict, None]:
    """Networks whose post-contact policy is the released one of a domain, and its setting; the others, which are not
    released, are untrained. Raises WeightsError where the weights are missing or were trained for something else."""
    networks, task = ActorCritic(), find_task(domain)
    file = weights_file(POST_CONTACT, task.domain)
    load(networks.post, file, PolicyContract.of(POST_CONTACT, task.domain))
    setting = {
        "domain": domain,
        "limit": task.limit,
        "contact": task.domain.contact.name,
        "damping_floor": damping_floor(file),
    }
    return networks, setting_of({"setting": setting}), None


def choose_judged_rows(arguments: argparse.Namespace) -> list[Judged]:
    """What the command line requests: a recipe's rows, or sets of conditions with its changes. Raises ValueError."""
    if arguments.recipe:
        return list(read_recipe(arguments.recipe).judge)
    changes = parse_changes(arguments.set)
    named = "".join(f" {text}" for text in arguments.set)
    return [Judged(name + named, find_conditions(name, changes)) for name in arguments.conditions]


def evaluate_all(arguments: argparse.Namespace, effects: Patch, refuse: Callable[[str], NoReturn]) -> Iterator[str]:
    """The line of JSON of each condition that the command line requests, with an arm that has these effects.

    refuse: called with a line on what checkpoint and command line do not have together.
    """
    networks, setting, steps = (
        load_released_networks(arguments.released) if arguments.released else read_checkpoint(arguments.checkpoint)
    )
    networks.to(arguments.device)
    if arguments.released and not arguments.student:
        arguments.student = weights_file(PRE_CONTACT, find_domain(arguments.released))
    try:
        setting = chosen(setting, **{name: getattr(arguments, name, None) for name in setting})
        domain = domain_of(setting)
        rows = choose_judged_rows(arguments)
    except ValueError as error:
        refuse(str(error))
    if arguments.video and setting["object"] != DEFAULT:
        refuse("--video draws a domain's own object: leave it out with another")
    contract = make_trained_contract(
        PRE_CONTACT, find_domain(setting["domain"]), damping_floor=setting["damping_floor"]
    )
    student = None
    if arguments.student:
        network = load(PreContactNetwork(), arguments.student, contract).to(arguments.device)
        metadata = read_metadata(arguments.student)
        student = Student(network, metadata.get("object", DEFAULT), read_size_range(metadata))
    environment = Environment(
        domain,
        arguments.device,
        EnvironmentConfig(
            worlds=arguments.episodes,
            hold=arguments.hold,
            tolerance=arguments.tolerance,
            reflex=arguments.reflex,
            limit=setting["limit"],
            damping_floor=setting["damping_floor"],
            physics=physics_for(
                setting["contact"],
                contacts=arguments.contacts,
                constraints=arguments.constraints,
                effects=effects,
                supports=any(row.conditions.support is not None for row in rows),
                resizes=any(row.conditions.resizes for row in rows),
            ),
        ),
    )
    for row in rows:
        begin = time.monotonic()
        record = arguments.record if row is rows[-1] else None
        figures = evaluate(
            environment,
            networks,
            student,
            row.conditions,
            tuple(arguments.seeds),
            record,
            arguments.scenario,
        )
        line = json.dumps(
            {
                "conditions": row.name,
                "student": bool(student),
                **setting,
                "scenario": arguments.scenario,
                "effects": [f"{e.effect} at {e.component}" for e in effects.effects],
                "seeds": arguments.seeds,
                "steps": steps,
                **figures,
                "wall_s": round(time.monotonic() - begin, 1),
            }
        )
        if arguments.video and record:
            from np_training.episodes.drawing import draw_recording

            draw_recording(record, record.parent, arguments.video)
        yield line
