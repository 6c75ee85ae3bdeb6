"""A run of the training, as its command line asks for: from its checkpoint where there is one, to the time or the iterations given."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path

import torch

from np_training.checkpoints import CheckpointError, read_state
from np_training.environment.environment import Environment, EnvironmentConfig
from np_training.physics.config import physics_for
from np_training.ppo import distributed
from np_training.ppo.config import PPOConfig, TrainConfig
from np_training.ppo.curriculum import CurriculumConfig
from np_training.ppo.log import Log
from np_training.ppo.progress import Progress
from np_training.ppo.trainer import Trainer
from np_training.setting import setting_of
from np_training.tasks.randomisation import CONDITIONS
from np_training.train_options import CHECKPOINT


def make_trainer(arguments: argparse.Namespace, device: str) -> Trainer:
    """The trainer that the command line asks for, from its checkpoint where there is one. Raises CheckpointError."""
    checkpoint = arguments.out / CHECKPOINT
    source = arguments.resume or (checkpoint if checkpoint.exists() else None)
    state = read_state(source, device if distributed.size() == 1 else "cpu") if source else None
    environment = Environment(
        arguments.played,
        device,
        EnvironmentConfig(
            worlds=arguments.worlds,
            seed=arguments.seed,
            limit=arguments.limit,
            reward=arguments.reward,
            physics=physics_for(
                arguments.contact,
                contacts=arguments.contacts,
                constraints=arguments.constraints,
                controller=arguments.controller,
                effects=arguments.effects,
                supports=CONDITIONS[arguments.conditions].support is not None,
                resizes=CONDITIONS[arguments.conditions].resizes,
            ),
        ),
    )
    curriculum = CurriculumConfig(
        residual=arguments.curriculum == "residual",
        practice=arguments.practice,
        explore=arguments.explore,
        kept=arguments.kept,
    )
    config = TrainConfig(
        rollout=arguments.rollout,
        start=arguments.start,
        stiffness=arguments.stiffness,
        deviation=arguments.deviation,
        tolerance=arguments.tolerance,
        hold=arguments.hold,
        reflex=arguments.reflex,
        conditions=arguments.conditions,
        curriculum=curriculum,
        adaptive_joint_range=arguments.adaptive_joint_range,
        privileged=arguments.privileged,
    )
    ppo = PPOConfig(
        rate=(PPOConfig.rate[0], arguments.rate_limit),
        entropy=arguments.entropy,
        discount=arguments.discount,
        target_kl=arguments.target_kl,
    )
    trainer = Trainer(environment, config, ppo)
    state = distributed.furthest(state, trainer.environment.device)
    if state is not None:
        check_same_run(state, trainer, source if arguments.resume is None else None)
        trainer.load_state_dict(state)
        if arguments.stage is not None:
            trainer.go_back(arguments.stage)
        if arguments.widen is not None:
            trainer.widen(arguments.widen)
        if distributed.rank() == 0:
            print(
                f"resumed from {source} at {trainer.steps / 1e6:.1f} M steps, stage {trainer.curriculum.stage}",
                file=sys.stderr,
                flush=True,
            )
    return trainer


def check_same_run(state: dict, trainer: Trainer, found: Path | None) -> None:
    """Raise CheckpointError where a checkpoint that was found, not named, is of another task: two runs share a
    folder."""
    theirs = setting_of(state)
    names = "domain", "object", "start", "controller", "reward", "max_opening"
    other = [name for name in names if theirs[name] != trainer.setting[name]]
    if found and other:
        raise CheckpointError(
            f"{found}: expected a checkpoint of {trainer.setting}, got one of {theirs}; name another "
            "--out, or start from it with --resume"
        )


def write_config(trainer: Trainer, path: Path) -> None:
    """What a report says of a run beside its log."""
    parts = {
        "environment": trainer.environment.config,
        "train": trainer.config,
        "ppo": trainer.ppo,
        "randomisation": CONDITIONS[trainer.config.conditions],
    }
    device = trainer.environment.device
    path.write_text(
        json.dumps(
            {
                "command": ["np_training.train", *sys.argv[1:]],  # the module, not where it lay
                "setting": trainer.setting,
                "processes": distributed.size(),
                "device": torch.cuda.get_device_name(device) if device.type == "cuda" else "CPU",
                **{name: dataclasses.asdict(part) for name, part in parts.items()},
            },
            indent=1,
        )
    )


def run(arguments: argparse.Namespace, device: str) -> dict:
    """Train for the time or the iterations given; returns what the last line says."""
    begin = time.monotonic()
    torch.backends.cuda.matmul.allow_tf32 = True
    trainer = make_trainer(arguments, device)
    distributed.check_same(trainer.networks)
    counted = begin
    first, checkpoint, row = distributed.rank() == 0, arguments.out / CHECKPOINT, {}
    if first:
        arguments.out.mkdir(parents=True, exist_ok=True)
        write_config(trainer, arguments.out / "config.json")
        log, progress, saved = (
            Log(arguments.out / "log.csv"),
            Progress(every=arguments.show_every),
            time.monotonic(),
        )
    for number in range(1, arguments.iterations + 1):
        started, before = time.monotonic(), trainer.steps
        row = trainer.iterate()
        now = time.monotonic()
        trainer.seconds += now - started
        if number == 1 and arguments.from_first:
            counted = now
        left = min(arguments.minutes * 60 - (now - counted), (arguments.iterations - number) * (now - started))
        if first:
            row |= {
                "steps_per_second": (trainer.steps - before) / (now - started),
                "elapsed": trainer.seconds,
            }
            log.write(row)
            progress.show(row, max(left, 0.0))
            if now - saved >= arguments.save_every:
                trainer.save(checkpoint)
                saved = now
        if distributed.any_of(left < 0, trainer.environment.device):
            break
    distributed.check_same(trainer.networks)
    if first:
        progress.end()
        trainer.save(checkpoint)
    return {
        "checkpoint": str(checkpoint),
        "domain": trainer.setting["domain"],
        "object": trainer.setting["object"],
        "scenario": 0,  # tasks are drawn
        "reward": trainer.setting["reward"],
        "overflow": trainer.environment.physics.overflow(),
        "processes": distributed.size(),
        **{k: row.get(k) for k in ("steps", "stage", "success", "lost", "steps_per_second")},
        "wall_s": round(time.monotonic() - begin, 1),
    }
