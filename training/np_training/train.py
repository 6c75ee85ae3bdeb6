"""Joint training of the pre- and post-contact policies.

    python -m np_training.train --domain card --out runs/card --minutes 20
    torchrun --standalone --nproc-per-node 2 -m np_training.train --domain card --out runs/card --minutes 20

Resumes from `--out/checkpoint.pt` (or `--resume FILE`) as a matter of course, on any machine, with any number
of GPUs. Writes config.json; log.csv, a row an iteration; checkpoint.pt, every --save-every seconds and at the
end. The last line printed is one JSON object.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path

import torch

from np_control.operational_space import CartesianGains, uniform_gains
from np_description.contact import IN_FORCE
from np_training.environment.environment import Environment, EnvironmentConfig
from np_training.environment.fixed_contact import STARTS
from np_training.physics.batched import CONTROLLERS, STEPPING, PhysicsConfig, physics_for
from np_training.physics.carried_effects import load_effects
from np_training.ppo import distributed
from np_training.ppo.curriculum import STAGES, CurriculumConfig
from np_training.ppo.learner import PPOConfig
from np_training.ppo.log import Log
from np_training.ppo.progress import Progress
from np_training.ppo.trainer import TrainConfig, Trainer
from np_training.tasks.randomisation import CONDITIONS
from np_training.tasks.registry import TASKS, find_task
from np_training.tasks.rewards import RewardConfig

CHECKPOINT = "checkpoint.pt"


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--domain", choices=list(TASKS), default="card")
    parser.add_argument("--out", type=Path, help="default: runs/DOMAIN")
    parser.add_argument("--resume", type=Path, help="checkpoint to start from; default: OUT/checkpoint.pt, if any")
    parser.add_argument(
        "--stage", type=int, help=f"of the curriculum, at which what is resumed begins again (0 to {STAGES})"
    )
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--iterations", type=int, default=10**9)
    parser.add_argument("--save-every", type=float, default=120.0, help="seconds between checkpoints")
    parser.add_argument(
        "--show-every", type=float, default=60.0, help="seconds between lines where there is no terminal"
    )
    parser.add_argument("--worlds", type=int, default=24576, help="of each process")
    parser.add_argument("--rollout", type=int, default=TrainConfig.rollout)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--rate-limit", type=float, default=PPOConfig.rate[1], help="largest learning rate")
    parser.add_argument("--contacts", type=int, default=PhysicsConfig.contacts, help="capacity a world")
    parser.add_argument("--constraints", type=int, default=PhysicsConfig.constraints, help="capacity a world")
    parser.add_argument("--entropy", type=float, default=PPOConfig.entropy, help="weight of the entropy bonus")
    parser.add_argument(
        "--controller",
        choices=CONTROLLERS,
        default=PhysicsConfig.controller,
        help="osc: operational-space control of T_E with gains of its own",
    )
    parser.add_argument(
        "--cartesian-stiffness",
        type=float,
        default=CartesianGains.position,
        help="of --controller osc, 1/s^2, of position and rotation",
    )
    parser.add_argument(
        "--start",
        choices=list(STARTS),
        default=TrainConfig.start,
        help="where episodes begin: contact: where the pre-contact policy says",
    )
    parser.add_argument(
        "--effects", type=Path, help="patch.yaml of the gap doctor: what the arm has besides the nominal one"
    )
    parser.add_argument("--contact", choices=list(STEPPING), default=IN_FORCE.name, help="see np_description.contact")
    parser.add_argument(
        "--conditions",
        choices=("paper", "robust"),
        default=TrainConfig.conditions,
        help="what is randomised at the end: paper; robust: also stiffness of contacts, housing, limits of speed",
    )
    parser.add_argument("--adaptive-joint-range", action="store_true", help="see np_training.tasks.joint_range")
    parser.add_argument(
        "--curriculum",
        choices=("residual", "none"),
        default="residual",
        help="none: residual limits at zeta* from the first step",
    )
    parser.add_argument("--discount", type=float, default=PPOConfig.discount)
    parser.add_argument(
        "--target-kl", type=float, default=PPOConfig.target_kl, help="divergence that steers the learning rate"
    )
    parser.add_argument("--limit", type=int, help="steps an episode; default: the task's")
    parser.add_argument("--explore", type=float, help="share of random contacts at the beginning; default: the task's")
    parser.add_argument("--practice", type=float, help="share of easier tasks at the beginning; default: the task's")
    parser.add_argument("--far", type=float, help="weight of the distance's own potential; default: the task's")
    parser.add_argument(
        "--stiffness",
        type=float,
        default=0.0,
        help="stiffness that an untrained policy commands, -1 to 1 of its range",
    )
    parser.add_argument(
        "--deviation",
        type=float,
        help="largest standard deviation of the actions drawn, for a run's end; default: none",
    )
    parser.add_argument(
        "--tolerance",
        type=float,
        help="share of the domain's tolerance that counts as success once randomised; default: what the domain aims at",
    )
    parser.add_argument(
        "--reflex",
        action=argparse.BooleanOptionalAction,
        default=TrainConfig.reflex,
        help="whether joints beyond their limits of speed or position end an episode once randomised",
    )
    parser.add_argument("--turn", type=float, default=RewardConfig.turn, help="weight of the angle's potential")
    arguments = parser.parse_args()
    try:
        arguments.effects = load_effects(arguments.effects)
    except ValueError as error:
        parser.error(str(error))
    task = find_task(arguments.domain)
    if arguments.tolerance is None:
        arguments.tolerance = task.domain.aim
    arguments.out = arguments.out or Path("runs") / arguments.domain
    for name in ("limit", "practice", "explore", "far"):
        if getattr(arguments, name) is None:
            setattr(arguments, name, getattr(task, name))
    return arguments


def make_trainer(arguments: argparse.Namespace, device: str) -> Trainer:
    """The trainer that the command line asks for, from its checkpoint where there is one."""
    environment = Environment(
        find_task(arguments.domain).domain,
        device,
        EnvironmentConfig(
            worlds=arguments.worlds,
            seed=arguments.seed,
            limit=arguments.limit,
            reward=RewardConfig(turn=arguments.turn, far=arguments.far),
            physics=physics_for(
                arguments.contact,
                contacts=arguments.contacts,
                constraints=arguments.constraints,
                controller=arguments.controller,
                cartesian=uniform_gains(arguments.cartesian_stiffness),
                effects=arguments.effects,
                supports=CONDITIONS[arguments.conditions].support is not None,
            ),
        ),
    )
    curriculum = CurriculumConfig(
        residual=arguments.curriculum == "residual", practice=arguments.practice, explore=arguments.explore
    )
    config = TrainConfig(
        rollout=arguments.rollout,
        start=arguments.start,
        stiffness=arguments.stiffness,
        deviation=arguments.deviation,
        tolerance=arguments.tolerance,
        reflex=arguments.reflex,
        conditions=arguments.conditions,
        curriculum=curriculum,
        adaptive_joint_range=arguments.adaptive_joint_range,
    )
    ppo = PPOConfig(
        rate=(PPOConfig.rate[0], arguments.rate_limit),
        entropy=arguments.entropy,
        discount=arguments.discount,
        target_kl=arguments.target_kl,
    )
    trainer = Trainer(environment, config, ppo)
    checkpoint = arguments.out / CHECKPOINT
    source = arguments.resume or (checkpoint if checkpoint.exists() else None)
    if source:
        state = torch.load(source, map_location=device, weights_only=True)
        check_same_run(state, trainer, source if arguments.resume is None else None)
        trainer.load_state_dict(state)
        if arguments.stage is not None:
            trainer.go_back(arguments.stage)
        if distributed.rank() == 0:
            print(
                f"resumed from {source} at {trainer.steps / 1e6:.1f} M steps, stage {trainer.curriculum.stage}",
                file=sys.stderr,
                flush=True,
            )
    return trainer


def check_same_run(state: dict, trainer: Trainer, found: Path | None) -> None:
    """Raise ValueError where a checkpoint that was found, not named, is of another task: two runs share a
    folder."""
    theirs = state.get("setting", {})
    names = "domain", "start", "controller", "cartesian_stiffness"
    other = [name for name in names if theirs.get(name, trainer.setting[name]) != trainer.setting[name]]
    if found and other:
        raise ValueError(
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
        left = min(arguments.minutes * 60 - (now - begin), (arguments.iterations - number) * (now - started))
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
    if first:
        progress.end()
        trainer.save(checkpoint)
    return {
        "checkpoint": str(checkpoint),
        "overflow": trainer.environment.physics.overflow(),
        "processes": distributed.size(),
        **{k: row.get(k) for k in ("steps", "stage", "success", "lost", "steps_per_second")},
        "wall_s": round(time.monotonic() - begin, 1),
    }


def main() -> None:
    """Train, show progress, write checkpoints and curves."""
    arguments = parse()
    device = distributed.join(arguments.device)
    try:
        result = run(arguments, device)
        if distributed.rank() == 0:
            print(json.dumps(result), flush=True)
    finally:
        distributed.leave()


if __name__ == "__main__":
    main()
