"""A run of the training through the stages of a recipe, from its checkpoint where there is one."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path

import torch

from np_training.checkpoints import CheckpointError, read_state
from np_training.environment.config import EnvironmentConfig
from np_training.environment.environment import Environment
from np_training.physics.config import physics_for
from np_training.ppo import distributed
from np_training.ppo.config import PPOConfig, TrainConfig
from np_training.ppo.curriculum import CurriculumConfig
from np_training.ppo.log import TrainingLog
from np_training.ppo.progress import TrainingProgress
from np_training.ppo.trainer import Trainer
from np_training.setting import setting_of
from np_training.tasks.rewards import RewardConfig
from np_training.train_options import CHECKPOINT, choose_played_domain


def make_trainer(arguments: argparse.Namespace, device: str, number: int, state: dict | None) -> Trainer:
    """The trainer of stage `number` of the recipe, gone on from a checkpoint's state (None: from nothing). Raises CheckpointError."""
    settings = arguments.stages[number]
    drawn = settings.drawn
    environment = Environment(
        choose_played_domain(arguments.domain, arguments.object, settings),
        device,
        EnvironmentConfig(
            worlds=arguments.worlds // distributed.size(),
            seed=arguments.seed,
            limit=settings.limit,
            reward=RewardConfig(**settings.reward),
            damping_floor=settings.damping_floor,
            physics=physics_for(
                settings.contact,
                contacts=settings.contacts,
                constraints=settings.constraints,
                effects=arguments.effects,
                supports=drawn.support is not None,
                resizes=drawn.resizes,
            ),
        ),
    )
    config = TrainConfig(
        rollout=settings.rollout,
        stiffness=settings.stiffness,
        deviation=settings.deviation,
        tolerance=settings.tolerance,
        hold=settings.hold,
        conditions=drawn,
        curriculum=CurriculumConfig(
            residual=settings.residual,
            growth=settings.growth,
            practice=settings.practice,
            explore=settings.explore,
            kept=settings.kept,
        ),
    )
    ppo = PPOConfig(
        rate=(PPOConfig.rate[0], settings.rate_limit),
        entropy=settings.entropy,
        discount=settings.discount,
        target_kl=settings.target_kl,
    )
    trainer = Trainer(environment, config, ppo)
    if state is not None:
        trainer.load_state_dict(state)
    return trainer


def find_state(arguments: argparse.Namespace, device: str) -> tuple[dict | None, Path | None]:
    """The state to go on from, of the process that has the furthest, and its file. Raises CheckpointError."""
    checkpoint = arguments.out / CHECKPOINT
    own = checkpoint if checkpoint.exists() else None
    source = own or arguments.resume
    if arguments.resume and own and arguments.resume.resolve() != own.resolve():
        source = arguments.resume
    state = read_state(source, device if distributed.size() == 1 else "cpu") if source else None
    if source and source != own:  # another run's: its stages are none of this recipe
        state |= {"recipe_stage": 0, "stage_begun": state["steps"]}
    return distributed.furthest(state, torch.device(device)), source


def check_same_run(state: dict, trainer: Trainer, found: Path | None) -> None:
    """Raise CheckpointError where a checkpoint is of another domain, or one that was found, not named, is of another
    object: two runs share a folder."""
    theirs = setting_of(state)
    if theirs["domain"] != trainer.setting["domain"]:
        raise CheckpointError(
            f"checkpoint: expected one of the domain {trainer.setting['domain']}, got one of {theirs['domain']}"
        )
    names = "object", "max_opening"
    other = [name for name in names if theirs[name] != trainer.setting[name]]
    if found and other:
        raise CheckpointError(
            f"{found}: expected a checkpoint of {trainer.setting}, got one of {theirs}; name another "
            "--out, or start from it with --resume"
        )


def write_config(trainer: Trainer, path: Path) -> None:
    """Write what a report needs of a run beside its log."""
    parts = {
        "environment": trainer.environment.config,
        "train": trainer.config,
        "ppo": trainer.ppo,
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
    """Train through the recipe's stages, for the time or the iterations given at most; returns the content of the last line."""
    begin = time.monotonic()
    torch.backends.cuda.matmul.allow_tf32 = True
    state, source = find_state(arguments, device)
    number = state.get("recipe_stage", 0) if state else 0
    if number >= len(arguments.stages):
        return {"checkpoint": str(source), "done": True}
    clock, resumed = Clock(arguments), state is not None
    while True:
        trainer = make_trainer(arguments, device, number, state)
        if resumed:
            check_same_run(state, trainer, source if arguments.resume is None else None)
            if arguments.stage is not None:
                trainer.go_back(arguments.stage)
            if distributed.rank() == 0:
                print(
                    f"resumed from {source} at {trainer.steps / 1e6:.1f} M steps, stage {trainer.curriculum.stage}",
                    file=sys.stderr,
                )
        resumed = False
        row, over, spent = train_stage(trainer, arguments, number, clock)
        if not over:
            break
        number += 1
        trainer.begin_stage(number)
        if distributed.rank() == 0:
            trainer.save(arguments.out / CHECKPOINT)
        if spent or number == len(arguments.stages):
            break
        state = trainer.state_dict()
        del trainer  # before the next one takes as much of the device's memory
    overflow, setting = trainer.environment.physics.overflow(), trainer.setting
    return {
        "checkpoint": str(arguments.out / CHECKPOINT),
        "domain": setting["domain"],
        "object": setting["object"],
        "scenario": 0,  # tasks are drawn
        "done": number == len(arguments.stages),
        "overflow": overflow,
        "processes": distributed.size(),
        **{k: row.get(k) for k in ("steps", "stage", "success", "lost", "steps_per_second")},
        "wall_s": round(time.monotonic() - begin, 1),
    }


class Clock:
    """Time and iterations that are left to a call."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.minutes, self.iterations, self.from_first = arguments.minutes, arguments.iterations, arguments.from_first
        self.begun, self.compiles = time.monotonic(), True

    def count(self, took: float) -> float:
        """Count an iteration that took so many s; s that are left, at most 0 where the call is over."""
        now = time.monotonic()
        self.iterations -= 1
        if self.from_first:
            self.begun, self.from_first = now, False
        return min(self.minutes * 60 - (now - self.begun), self.iterations * took)


def train_stage(
    trainer: Trainer, arguments: argparse.Namespace, number: int, clock: Clock
) -> tuple[dict[str, float], bool, bool]:
    """Train until the stage or the call is over; the last row of the log, and whether the stage is over, and the call."""
    distributed.check_same(trainer.networks)
    settings, checkpoint = arguments.stages[number], arguments.out / CHECKPOINT
    first, saved = distributed.rank() == 0, time.monotonic()
    if first:
        arguments.out.mkdir(parents=True, exist_ok=True)
        write_config(trainer, arguments.out / "config.json")
        log, progress = TrainingLog(arguments.out / "log.csv"), TrainingProgress(every=arguments.show_every)
    while True:
        started, before = time.monotonic(), trainer.steps
        row = trainer.iterate()
        now = time.monotonic()
        if first and clock.compiles:
            print(f"kernels ready after {now - started:.0f} s, with the first iteration", file=sys.stderr)
        clock.compiles = False
        trainer.seconds += now - started
        left = clock.count(now - started)
        rate = (trainer.steps - before) / (now - started)
        if first:
            of_stage = (settings.steps * 1e6 + trainer.stage_begun - trainer.steps) / rate
            row |= {"recipe_stage": number, "steps_per_second": rate, "elapsed": trainer.seconds}
            log.write(row)
            progress.show(row, max(min(left, of_stage), 0.0))
            if now - saved >= arguments.save_every:
                trainer.save(checkpoint)
                saved = now
        over = trainer.is_over(settings.success, settings.steps * 1e6)
        spent = distributed.any_of(left <= 0, trainer.environment.device)
        if over or spent:
            break
    distributed.check_same(trainer.networks)
    if first:
        progress.end()
        trainer.save(checkpoint)
    return row, over, spent
