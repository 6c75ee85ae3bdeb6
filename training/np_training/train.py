"""Joint training of the pre- and post-contact policies.

    python -m np_training.train --domain card --out runs/card --minutes 20
    torchrun --standalone --nproc-per-node 2 -m np_training.train --domain card --out runs/card --minutes 20

Resumes from `--out/checkpoint.pt` (or `--resume FILE`) as a matter of course, on any machine, with any number of GPUs.
Writes every two minutes and at the end: checkpoint.pt; log.csv (one row an iteration); config.json. The last line
printed is one JSON object.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path

import torch

from np_description.domains import DOMAINS, find_domain
from np_training import distributed
from np_training.curriculum import CurriculumConfig
from np_training.environment import Environment, EnvironmentConfig
from np_training.log import Log
from np_training.physics import CONTROLLERS, PhysicsConfig
from np_training.ppo import PPOConfig
from np_training.randomisation import PAPER
from np_training.rewards import RewardConfig
from np_training.trainer import TrainConfig, Trainer

SAVE_EVERY = 120.0  # s
LIMITS = {"card": 100, "bump": 150, "wall": 100}  # steps an episode
PRACTICE = {"card": 0.0, "bump": 0.6, "wall": 0.5}  # share of practice at the beginning


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--domain", choices=list(DOMAINS), default="card")
    parser.add_argument("--out", type=Path, default=Path("runs/card"))
    parser.add_argument("--resume", type=Path, help="checkpoint to start from; default: OUT/checkpoint.pt where it exists")
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--iterations", type=int, default=10**9)
    parser.add_argument("--worlds", type=int, default=24576, help="of each process")
    parser.add_argument("--rollout", type=int, default=TrainConfig.rollout)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--rate-limit", type=float, default=PPOConfig.rate[1], help="largest learning rate")
    parser.add_argument("--contacts", type=int, default=PhysicsConfig.contacts, help="capacity a world")
    parser.add_argument("--constraints", type=int, default=PhysicsConfig.constraints, help="capacity a world")
    parser.add_argument("--entropy", type=float, default=PPOConfig.entropy, help="weight of the entropy bonus")
    parser.add_argument("--controller", choices=CONTROLLERS, default=PhysicsConfig.controller,
                        help="osc: operational-space control of T_E with gains of its own, in place of joint impedance")
    parser.add_argument("--curriculum", choices=("residual", "none"), default="residual",
                        help="none: residual limits at zeta* from the first step")
    parser.add_argument("--discount", type=float, default=PPOConfig.discount)
    parser.add_argument("--limit", type=int, help=f"steps an episode; default: {LIMITS}")
    parser.add_argument("--practice", type=float, help=f"share of easier tasks at the beginning; default: {PRACTICE}")
    parser.add_argument("--turn", type=float, default=RewardConfig.turn, help="weight of the angle's potential")
    arguments = parser.parse_args()
    for name, defaults in (("limit", LIMITS), ("practice", PRACTICE)):
        if getattr(arguments, name) is None:
            setattr(arguments, name, defaults[arguments.domain])
    return arguments


def run(arguments: argparse.Namespace, device: str) -> dict:
    """Train for the time or the iterations given; returns what the last line says."""
    begin = time.monotonic()
    torch.backends.cuda.matmul.allow_tf32 = True
    environment = Environment(find_domain(arguments.domain), device, EnvironmentConfig(
        worlds=arguments.worlds, seed=arguments.seed, limit=arguments.limit,
        reward=RewardConfig(turn=arguments.turn),
        physics=PhysicsConfig(contacts=arguments.contacts, constraints=arguments.constraints,
                              controller=arguments.controller)))
    config = TrainConfig(rollout=arguments.rollout, curriculum=CurriculumConfig(
        residual=arguments.curriculum == "residual", practice=arguments.practice))
    ppo = PPOConfig(rate=(PPOConfig.rate[0], arguments.rate_limit), entropy=arguments.entropy,
                    discount=arguments.discount)
    trainer = Trainer(environment, config, ppo)
    checkpoint = arguments.out / "checkpoint.pt"
    source = arguments.resume or (checkpoint if checkpoint.exists() else None)
    if source:
        trainer.load_state_dict(torch.load(source, map_location=device, weights_only=True))
    first = distributed.rank() == 0
    if first:
        arguments.out.mkdir(parents=True, exist_ok=True)
        if source:
            print(f"resumed from {source} at {trainer.steps / 1e6:.1f} M steps, stage {trainer.curriculum.stage}", flush=True)
        (arguments.out / "config.json").write_text(json.dumps({
            "command": sys.argv, "processes": distributed.size(), "environment": dataclasses.asdict(environment.config),
            "train": dataclasses.asdict(config), "ppo": dataclasses.asdict(ppo),
            "randomisation": dataclasses.asdict(PAPER)}, indent=1))
        log, saved = Log(arguments.out / "log.csv"), time.monotonic()
    row = {}
    for _ in range(arguments.iterations):
        started, before = time.monotonic(), trainer.steps
        row = trainer.iterate()
        now = time.monotonic()
        trainer.seconds += now - started
        left = arguments.minutes * 60 - (now - begin)
        if first:
            row |= {"steps_per_second": (trainer.steps - before) / (now - started), "elapsed": trainer.seconds}
            log.write(row)
            print(progress_line(row, left), end="" if sys.stdout.isatty() else "\n", flush=True)
            if now - saved > SAVE_EVERY:
                trainer.save(checkpoint)
                saved = now
        if distributed.any_of(left < 0, environment.device):
            break
    if first:
        trainer.save(checkpoint)
    return {"checkpoint": str(checkpoint), "overflow": environment.physics.overflow(), "processes": distributed.size(),
            **{k: row.get(k) for k in ("steps", "stage", "success", "lost", "steps_per_second")},
            "wall_s": round(time.monotonic() - begin, 1)}


def progress_line(row: dict[str, float], left: float) -> str:
    """What the terminal shows of a row of the log, with the seconds that are left."""
    return (f"\r{row['steps'] / 1e6:8.1f} M steps  {row['steps_per_second'] / 1e3:6.1f} k/s  stage {row['stage']:2d}  "
            f"success {row['success']:.3f}  lost {row['lost']:.3f}  length {row['length']:5.1f}  "
            f"tips {row['success_tips0']:.2f} {row['success_tips1']:.2f} {row['success_tips2']:.2f}  "
            f"practice {row['practice']:.2f} {row['success_practice']:.2f}  "
            f"end {1e3 * row['end_distance']:5.1f} mm {row['end_angle']:.2f} rad  feasible {row['pre_feasible']:.2f}  "
            f"std {row['std']:.2f}  kl {row['kl']:.4f}  left {left / 60:5.1f} min")


def main() -> None:
    """Train, show progress, write checkpoints and curves."""
    arguments = parse()
    device = distributed.join(arguments.device)
    try:
        result = run(arguments, device)
        if distributed.rank() == 0:
            print("\n" + json.dumps(result), flush=True)
    finally:
        distributed.leave()


if __name__ == "__main__":
    main()
