"""Joint training of the pre- and post-contact policies.

    python -m np_training.train --domain card --out runs/card --minutes 20

Resumes from `--out/checkpoint.pt` (or `--resume FILE`) as a matter of course, on any machine. Writes every two minutes
and at the end: checkpoint.pt, log.csv (one row an iteration), config.json. The last line printed is one JSON object.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import json
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import torch

from np_description.domains import DOMAINS, find_domain
from np_policy.action import LOOSE, TIGHT, ResidualLimits
from np_training.environment import Environment, EnvironmentConfig
from np_training.networks import ActorCritic, sample
from np_training.physics import PhysicsConfig
from np_training.ppo import Learner, PPOConfig, advantages
from np_training.randomisation import NOMINAL_CONDITIONS, PAPER

STAGES = 10  # geometric steps from LOOSE to TIGHT (paper)


@dataclass(frozen=True)
class TrainConfig:
    """rollout: steps between updates; advance_at: success that tightens the residual limits (paper); randomise_at:
    success at the tightest limits that switches domain randomisation on, with `hold` steps at the goal."""

    rollout: int = 12
    advance_at: float = 0.8
    randomise_at: float = 0.9
    hold: int = 3


def stage_limits(stage: int) -> ResidualLimits:
    """Residual limits of a curriculum stage, 0 (loose) to STAGES (tight), geometric in between (paper)."""
    share = min(stage, STAGES) / STAGES
    return ResidualLimits(*(a * (b / a) ** share for a, b in ((LOOSE.position, TIGHT.position),
                                                              (LOOSE.rotation, TIGHT.rotation))))


class Trainer:
    """Owns environment, networks, learners, curriculum; `iterate` does one rollout and one update."""

    def __init__(self, environment: Environment, config: TrainConfig = TrainConfig(), ppo: PPOConfig = PPOConfig()) -> None:
        self.environment, self.config, self.ppo = environment, config, ppo
        torch.manual_seed(environment.config.seed)
        self.networks = ActorCritic().to(environment.device)
        self.post = Learner(self.networks.post, self.networks.post_value, ppo)
        self.pre = Learner(self.networks.pre, self.networks.pre_value, dataclasses.replace(ppo, epochs=4, minibatches=4))
        self.iteration, self.steps, self.stage, self.episodes = 0, 0, 0, 0
        self.success = 0.0
        self._set_stage(0)
        environment.starts = environment.draw_starts(self.networks.pre, 2 * environment.config.worlds)
        environment.reset(torch.arange(environment.config.worlds, device=environment.device))
        # Without this every episode would end in the same step.
        environment.age.random_(0, environment.config.limit, generator=environment.generator)

    @property
    def randomised(self) -> bool:
        """Whether domain randomisation is on."""
        return self.stage > STAGES

    def _set_stage(self, stage: int) -> None:
        self.stage, self.episodes = stage, 0
        self.environment.limits = stage_limits(stage)
        on = stage > STAGES
        self.environment.config = dataclasses.replace(
            self.environment.config, conditions=PAPER if on else NOMINAL_CONDITIONS, hold=self.config.hold if on else 1)

    def iterate(self) -> dict[str, float]:
        """One rollout, one update of both policies; returns a row of the log."""
        env, nets, worlds = self.environment, self.networks, self.environment.config.worlds
        env.starts = env.draw_starts(nets.pre, worlds)
        data: dict[str, list[torch.Tensor]] = {k: [] for k in ("state", "critic", "action", "logp", "value", "reward", "done")}
        ended: list[tuple[torch.Tensor, ...]] = []
        sums: dict[str, torch.Tensor] = {}
        for _ in range(self.config.rollout):
            state, privileged = env.observe()
            critic_state = torch.cat([state, privileged], -1)
            with torch.no_grad():
                action, logp = sample(nets.post, state)
                value = nets.post_value(critic_state)[:, 0]
            out = env.step(action)
            for name, tensor in (("state", state), ("critic", critic_state), ("action", action), ("logp", logp),
                                 ("value", value), ("reward", out["reward"]), ("done", out["done"])):
                data[name].append(tensor)
            where = out["done"].nonzero()[:, 0]
            ended.append((env.pre_state[where], env.pre_action[where], env.pre_log_probability[where], env.total[where]))
            counts = {name: out[name].sum() for name in ("success", "lost", "timeout", "broken", "done")}
            counts |= {f"reward_{name}": term.sum() for name, term in out["terms"].items()}
            counts |= {"length": env.age[where].sum(), "total": env.total[where].sum(),
                       "end_distance": out["distance"][where].sum(), "end_angle": out["angle"][where].sum()}
            for name, count in counts.items():
                sums[name] = sums.get(name, 0) + count
            env.reset(where)
        row = self._update(data, ended)
        done = max(float(sums["done"]), 1.0)
        row |= {name: float(sums[name]) / done for name in ("success", "lost", "timeout", "length", "total",
                                                            "end_distance", "end_angle")}
        row |= {name: float(value) / (worlds * self.config.rollout) for name, value in sums.items() if "reward_" in name}
        self.iteration += 1
        self.steps += worlds * self.config.rollout
        self._advance(row["success"], int(done))
        return {"iteration": self.iteration, "steps": self.steps, "stage": self.stage, "episodes": done,
                "success_mean": self.success, "broken": float(sums["broken"])} | row

    def _update(self, data: dict[str, list[torch.Tensor]], ended: list[tuple[torch.Tensor, ...]]) -> dict[str, float]:
        env, nets = self.environment, self.networks
        stacked = {name: torch.stack(tensors) for name, tensors in data.items()}
        with torch.no_grad():
            state, privileged = env.observe()
            last_value = nets.post_value(torch.cat([state, privileged], -1))[:, 0]
        gain = advantages(self.ppo, stacked["reward"], stacked["done"], stacked["value"], last_value)
        returns = gain + stacked["value"]
        flat = {name: tensor.flatten(0, 1) for name, tensor in stacked.items()}
        post = self.post.update(flat["state"], flat["critic"], flat["action"], flat["logp"], gain.flatten(), returns.flatten())
        rejected = env.starts.rejected()
        failure = torch.full((len(rejected),), env.config.reward.failure * env.config.reward.scale, device=env.device)
        groups = [*ended, (env.starts.state[rejected], env.starts.action[rejected],
                           env.starts.log_probability[rejected], failure)]
        pre_state, pre_action, pre_logp, total = (torch.cat(parts) for parts in zip(*groups))
        row = {"lr": self.post.rate, "std": float(nets.post.log_std.exp().mean()),
               "pre_feasible": float(env.starts.contacts.feasible.float().mean())} | post
        if len(pre_state) >= 64:
            with torch.no_grad():
                baseline = nets.pre_value(pre_state)[:, 0]
            pre = self.pre.update(pre_state, pre_state, pre_action, pre_logp, total - baseline, total)
            row |= {f"pre_{name}": value for name, value in pre.items()}
            row["pre_std"] = float(nets.pre.log_std.exp().mean())
        return row

    def _advance(self, success: float, episodes: int) -> None:
        weight = min(episodes / self.environment.config.worlds, 1.0)
        self.success = success if self.episodes == 0 else (1 - weight) * self.success + weight * success
        self.episodes += episodes
        if self.episodes < self.environment.config.worlds // 2 or self.stage > STAGES:
            return
        if self.success >= (self.config.advance_at if self.stage < STAGES else self.config.randomise_at):
            self._set_stage(self.stage + 1)

    def state_dict(self) -> dict:
        """Everything a run needs to go on elsewhere, except the episodes under way."""
        return {"networks": self.networks.state_dict(), "post": self.post.state_dict(), "pre": self.pre.state_dict(),
                "iteration": self.iteration, "steps": self.steps, "stage": self.stage}

    def load_state_dict(self, state: dict) -> None:
        """Restore what `state_dict` gave."""
        self.networks.load_state_dict(state["networks"])
        self.post.load_state_dict(state["post"])
        self.pre.load_state_dict(state["pre"])
        self.iteration, self.steps = state["iteration"], state["steps"]
        self._set_stage(state["stage"])


class Log:
    """A CSV file that gets one row an iteration and survives a kill; columns of the first row are the file's."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def write(self, row: dict[str, float]) -> None:
        """Append a row."""
        fresh = not self.path.exists()
        with self.path.open("a", newline="") as file:
            if fresh:
                csv.writer(file).writerow(row)
            names = list(row) if fresh else next(csv.reader(self.path.open()))
            csv.writer(file).writerow([f"{row[n]:.6g}" if isinstance(row.get(n), float) else row.get(n, "") for n in names])


def save_checkpoint(trainer: Trainer, path: Path) -> None:
    """Write atomically: a kill leaves the old checkpoint or the new one."""
    partial = path.with_suffix(".partial")
    torch.save(trainer.state_dict(), partial)
    os.replace(partial, path)


def main() -> None:
    """Train, print a progress line an iteration, write checkpoints and curves."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--domain", choices=list(DOMAINS), default="card")
    parser.add_argument("--out", type=Path, default=Path("runs/card"))
    parser.add_argument("--resume", type=Path, help="checkpoint to start from; default: OUT/checkpoint.pt where it exists")
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--iterations", type=int, default=10**9)
    parser.add_argument("--worlds", type=int, default=24576)
    parser.add_argument("--rollout", type=int, default=TrainConfig.rollout)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--rate-limit", type=float, default=PPOConfig.rate[1], help="largest learning rate")
    parser.add_argument("--contacts", type=int, default=PhysicsConfig.contacts, help="capacity a world")
    parser.add_argument("--constraints", type=int, default=PhysicsConfig.constraints, help="capacity a world")
    parser.add_argument("--entropy", type=float, default=PPOConfig.entropy, help="weight of the entropy bonus")
    arguments = parser.parse_args()
    begin = time.monotonic()
    torch.backends.cuda.matmul.allow_tf32 = True
    arguments.out.mkdir(parents=True, exist_ok=True)
    environment = Environment(find_domain(arguments.domain), arguments.device, EnvironmentConfig(
        worlds=arguments.worlds, seed=arguments.seed,
        physics=PhysicsConfig(contacts=arguments.contacts, constraints=arguments.constraints)))
    config = TrainConfig(rollout=arguments.rollout)
    ppo = PPOConfig(rate=(PPOConfig.rate[0], arguments.rate_limit), entropy=arguments.entropy)
    trainer = Trainer(environment, config, ppo)
    checkpoint = arguments.out / "checkpoint.pt"
    source = arguments.resume or (checkpoint if checkpoint.exists() else None)
    if source:
        trainer.load_state_dict(torch.load(source, map_location=arguments.device, weights_only=True))
        print(f"resumed from {source} at {trainer.steps / 1e6:.1f} M steps, stage {trainer.stage}", flush=True)
    (arguments.out / "config.json").write_text(json.dumps({
        "command": sys.argv, "environment": dataclasses.asdict(environment.config), "train": dataclasses.asdict(config),
        "ppo": dataclasses.asdict(ppo), "randomisation": dataclasses.asdict(PAPER)}, indent=1))
    log, saved, row = Log(arguments.out / "log.csv"), time.monotonic(), {}
    for _ in range(arguments.iterations):
        started = time.monotonic()
        row = trainer.iterate()
        now = time.monotonic()
        row["steps_per_second"] = environment.config.worlds * config.rollout / (now - started)
        row["elapsed"] = now - begin
        log.write(row)
        left = arguments.minutes * 60 - (now - begin)
        print(f"\r{row['steps'] / 1e6:8.1f} M steps  {row['steps_per_second'] / 1e3:6.1f} k/s  stage {row['stage']:2d}  "
              f"success {row['success']:.3f}  lost {row['lost']:.3f}  length {row['length']:5.1f}  "
              f"end {1e3 * row['end_distance']:5.1f} mm {row['end_angle']:.2f} rad  feasible {row['pre_feasible']:.2f}  "
              f"std {row['std']:.2f}  kl {row['kl']:.4f}  left {left / 60:5.1f} min", end="" if sys.stdout.isatty() else "\n",
              flush=True)
        if now - saved > 120:
            save_checkpoint(trainer, checkpoint)
            saved = now
        if left < 0:
            break
    save_checkpoint(trainer, checkpoint)
    print("\n" + json.dumps({"checkpoint": str(checkpoint), "overflow": environment.physics.overflow(),
                             **{k: row.get(k) for k in ("steps", "stage", "success", "lost", "steps_per_second")},
                             "wall_s": round(time.monotonic() - begin, 1)}))


if __name__ == "__main__":
    main()
