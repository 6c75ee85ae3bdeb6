"""Rollouts and updates of both policies, and what a run needs to go on elsewhere."""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path

import torch

from np_description.objects.choice import object_reference
from np_policy.action import STIFFNESS
from np_training.environment.environment import Environment
from np_training.ppo import distributed
from np_training.ppo.config import PPOConfig, TrainConfig
from np_training.ppo.curriculum import Curriculum
from np_training.ppo.learner import Learner, PolicySamples, advantages
from np_training.ppo.networks import LOG_STD, ActorCritic, sample
from np_training.setting import largest_turn
from np_training.tasks.breakdown import groups
from np_training.tasks.registry import find_task


class Trainer:
    """Owns environment, networks, learners, curriculum; `iterate` does one rollout and one update.

    With several processes each has an environment of its own and the same networks: they begin with the same
    seed, and every update is made from gradients summed over all.
    """

    def __init__(
        self, environment: Environment, config: TrainConfig = TrainConfig(), ppo: PPOConfig = PPOConfig()
    ) -> None:
        self.environment, self.config, self.ppo = environment, config, ppo
        torch.manual_seed(environment.config.seed)
        self.networks = ActorCritic().to(environment.device)
        with torch.no_grad():
            self.networks.post.net[-1].bias[STIFFNESS] = math.atanh(config.stiffness)
        distributed.share(self.networks)
        self.post = Learner(self.networks.post, self.networks.post_value, ppo)
        self.pre = Learner(
            self.networks.pre, self.networks.pre_value, dataclasses.replace(ppo, epochs=4, minibatches=4)
        )
        self.iteration, self.steps, self.seconds = 0, 0, 0.0
        self.recipe_stage, self.stage_begun = 0, 0  # of a recipe, and the steps at which it began
        self.kinds = [kind.name for kind in find_task(environment.domain.name).kinds]
        window = distributed.size() * environment.config.worlds
        self.curriculum = Curriculum(window, config.curriculum, len(self.kinds) - 1)
        self._seed()
        self._apply_stage()
        environment.starts = environment.draw_starts(self.networks.pre, 2 * environment.config.worlds)
        environment.reset(torch.arange(environment.config.worlds, device=environment.device))
        # Without this every episode would end in the same step.
        environment.age.random_(0, environment.config.limit, generator=environment.generator)

    @property
    def setting(self) -> dict[str, str | int | float]:
        """What an evaluation has to share with the training."""
        env = self.environment
        return {
            "domain": env.domain.name,
            "object": object_reference(env.domain),
            "limit": env.config.limit,
            "contact": env.config.physics.contact.name,
            "max_opening": env.domain.max_opening,
            "largest_turn": largest_turn(env.domain),
            "damping_floor": env.config.damping_floor,
        }

    def _seed(self) -> None:
        """Random numbers of its own for every process and every resumption, the same in a repeated run."""
        seed = self.environment.config.seed + 10_007 * distributed.rank() + 1_000_003 * self.iteration
        torch.manual_seed(seed)
        self.environment.generator.manual_seed(seed)

    def _apply_stage(self) -> None:
        env, share = self.environment, self.curriculum.randomisation
        env.limits = self.curriculum.limits
        env.config = dataclasses.replace(
            env.config,
            conditions=self.config.conditions.at(share),
            strictness=self.curriculum.strictness,
            hold=round(1 + share * (self.config.hold - 1)),
            tolerance=1 + share * (self.config.tolerance - 1),
            reflex=self.config.reflex and share > 0,
        )

    def iterate(self) -> dict[str, float]:
        """One rollout, one update of both policies; returns a row of the log, over all processes."""
        env, nets, worlds = self.environment, self.networks, self.environment.config.worlds
        env.config = dataclasses.replace(env.config, shares=self.curriculum.shares, explore=self.curriculum.explore)
        env.starts = env.draw_starts(nets.pre, worlds)
        data: dict[str, list[torch.Tensor]] = {
            k: [] for k in ("state", "critic", "action", "logp", "value", "reward", "done")
        }
        ended: list[tuple[torch.Tensor, ...]] = []
        forces: list[torch.Tensor] = []
        sums: dict[str, torch.Tensor] = {}
        for _ in range(self.config.rollout):
            state, critic_state = self._observe()
            with torch.no_grad():
                action, logp = sample(nets.post, state)
                value = nets.post_value(critic_state).flatten()
            out = env.step(action)
            for name, tensor in (
                ("state", state),
                ("critic", critic_state),
                ("action", action),
                ("logp", logp),
                ("value", value),
                ("reward", out["reward"]),
                ("done", out["done"]),
            ):
                data[name].append(tensor)
            where = out["done"].nonzero().flatten()
            ended.append(
                (
                    env.pre_state[where],
                    env.pre_action[where],
                    env.pre_log_probability[where],
                    env.total[where],
                )
            )
            forces.append(env.force[0, out["done"] & (env.kind == 0)])
            counts = self._count(out)
            for name, count in counts.items():
                sums[name] = sums.get(name, 0) + count
            env.reset(where)
        feasible = env.starts.contacts.feasible
        sums |= {
            "drawn": torch.tensor(len(feasible)),
            "pre_feasible": feasible.sum(),
            "overflowed": env.physics.take_overflowed(),
        }
        update = self._update(data, ended)
        self._narrow()
        return self._row(distributed.total(sums, env.device)) | _force_figures(torch.cat(forces)) | update

    def _observe(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Observations of the policy (n, 79) and of its critic (n, 108)."""
        state, privileged = self.environment.observe()
        return state, torch.cat([state, privileged], -1)

    @torch.no_grad()
    def _narrow(self) -> None:
        """Deviations into their range: beyond it `distribution` cuts them, so that no gradient would ever bring them back."""
        for policy in (self.networks.post, self.networks.pre):
            policy.log_std.clamp_(*LOG_STD)
        if self.config.deviation:
            most = self.curriculum.randomisation * math.log(self.config.deviation)
            self.networks.post.log_std.clamp_(max=most)

    def _count(self, out: dict) -> dict[str, torch.Tensor]:
        """Sums over the worlds of what a step gave; those of ended episodes leave practice out."""
        env = self.environment
        own = env.kind == 0
        done, success = out["done"] & own, out["success"] & own
        counts = {"done": done.sum(), "success": success.sum(), "broken": out["broken"].sum()}
        counts |= {name: (out[name] & done).sum() for name in ("lost", "stopped", "pressed", "timeout")}
        touch = out["touch"]
        counts |= {"touching": (touch.finger | touch.bare).sum(), "bare": touch.bare.sum()}
        counts |= {
            name: value[done].sum()
            for name, value in (
                ("length", env.age),
                ("total", env.total),
                ("end_distance", out["distance"]),
                ("end_angle", out["angle"]),
            )
        }
        counts |= {
            f"{name}_{kind}": (out[name] & (env.kind == number)).sum()
            for number, kind in enumerate(self.kinds[1:], 1)
            for name in ("done", "success")
        }
        for name, mask in groups(env.domain, env.tips, env.goals.position).items():
            counts |= {f"done_{name}": (done & mask).sum(), f"success_{name}": (success & mask).sum()}
        return counts | {f"reward_{name}": term.sum() for name, term in out["terms"].items()}

    def _row(self, sums: dict[str, float]) -> dict[str, float]:
        """Means over episodes or steps from sums over the rollout; counts the iteration and moves the
        curriculum."""
        steps = distributed.size() * self.environment.config.worlds * self.config.rollout
        done = max(sums["done"], 1.0)
        means = {
            name: sums[name] / done
            for name in (
                "success",
                "lost",
                "stopped",
                "pressed",
                "timeout",
                "length",
                "total",
                "end_distance",
                "end_angle",
            )
        }
        means |= {
            name: value / max(sums[name.replace("success", "done")], 1.0)
            for name, value in sums.items()
            if name.startswith("success_")
        }
        means |= {name: value / steps for name, value in sums.items() if name.startswith("reward_")}
        means |= {"touching": sums["touching"] / steps, "bare": sums["bare"] / max(sums["touching"], 1.0)}
        self.iteration += 1
        self.steps += steps
        stage, randomisation, shares = self.curriculum.stage, self.curriculum.randomisation, self.curriculum.shares
        for number, kind in enumerate(self.kinds[1:]):
            self.curriculum.practise(number, means[f"success_{kind}"], int(sums[f"done_{kind}"]))
        if self.curriculum.advance(means["success"], int(sums["done"])):
            self._apply_stage()
        return {
            "iteration": self.iteration,
            "steps": self.steps,
            "stage": stage,
            "randomisation": randomisation,
            "episodes": int(sums["done"]),
            "success_mean": self.curriculum.success,
            "practice": 1 - shares[0],
            "broken": sums["broken"],
            "overflowed": sums["overflowed"],
            "pre_feasible": sums["pre_feasible"] / sums["drawn"],
        } | means

    def _update(self, data: dict[str, list[torch.Tensor]], ended: list[tuple[torch.Tensor, ...]]) -> dict[str, float]:
        env, nets = self.environment, self.networks
        stacked = {name: torch.stack(tensors) for name, tensors in data.items()}
        with torch.no_grad():
            last_value = nets.post_value(self._observe()[1]).flatten()
        gain = advantages(self.ppo, stacked["reward"], stacked["done"], stacked["value"], last_value)
        returns = gain + stacked["value"]
        flat = {name: tensor.flatten(0, 1) for name, tensor in stacked.items()}
        post = self.post.update(
            PolicySamples(
                flat["state"], flat["critic"], flat["action"], flat["logp"], gain.flatten(), returns.flatten()
            )
        )
        rejected = env.starts.rejected()
        failure = torch.full((len(rejected),), env.config.reward.failure * env.config.reward.scale, device=env.device)
        parts = [
            *ended,
            (
                env.starts.state[rejected],
                env.starts.action[rejected],
                env.starts.log_probability[rejected],
                failure,
            ),
        ]
        pre_state, pre_action, pre_logp, total = (torch.cat(column) for column in zip(*parts))
        row = {"lr": self.post.rate, "std": float(nets.post.log_std.detach().exp().mean())} | post
        episodes = distributed.total({"episodes": len(pre_state)}, env.device)["episodes"]
        if episodes >= self.config.pre_least:
            with torch.no_grad():
                baseline = nets.pre_value(pre_state).flatten()
            pre = self.pre.update(PolicySamples(pre_state, pre_state, pre_action, pre_logp, total - baseline, total))
            row |= {f"pre_{name}": value for name, value in pre.items()}
            row["pre_std"] = float(nets.pre.log_std.detach().exp().mean())
        return row

    def state_dict(self) -> dict:
        """Everything a run needs to go on elsewhere, with any number of processes, except the episodes under
        way."""
        return {
            "networks": self.networks.state_dict(),
            "post": self.post.state_dict(),
            "pre": self.pre.state_dict(),
            "iteration": self.iteration,
            "steps": self.steps,
            "seconds": self.seconds,
            "stage": self.curriculum.stage,
            "growth": self.curriculum.config.growth,
            "success": self.curriculum.success,
            "episodes": self.curriculum.episodes,
            "practised": self.curriculum.practised,
            "setting": self.setting,
            "recipe_stage": self.recipe_stage,
            "stage_begun": self.stage_begun,
        }

    def load_state_dict(self, state: dict) -> None:
        """Restore what `state_dict` gave."""
        self.networks.load_state_dict(state["networks"])
        self.post.load_state_dict(state["post"])
        self.pre.load_state_dict(state["pre"])
        self.iteration, self.steps = state["iteration"], state["steps"]
        self.seconds = state.get("seconds", 0.0)
        self.curriculum.resume(state["stage"], state.get("growth", 1))
        self.curriculum.success = state.get("success", 0.0)
        # Without their number the mean would begin anew, with what a few first episodes came to.
        self.curriculum.episodes = state.get("episodes", 0)
        if len(state.get("practised", [])) == len(self.curriculum.practised):
            self.curriculum.practised = list(state["practised"])
        self.recipe_stage, self.stage_begun = state.get("recipe_stage", 0), state.get("stage_begun", 0)
        self._apply_stage()
        self._narrow()
        self._seed()

    def go_back(self, stage: int) -> None:
        """Begin a stage of the curriculum anew: of the same world, or of another, in which it has to be won again. Raises ValueError
        for one that there is not."""
        self.curriculum.go_back(stage)
        self._apply_stage()

    def save(self, path: Path) -> None:
        """Write a checkpoint; a kill leaves the old one or the new one."""
        partial = path.with_suffix(".partial")
        torch.save(self.state_dict(), partial)
        os.replace(partial, path)

    def begin_stage(self, number: int) -> None:
        """Begin stage `number` of a recipe; its success counts from its own episodes on."""
        self.recipe_stage, self.stage_begun, self.curriculum.episodes = number, self.steps, 0

    def is_over(self, success: float | None, steps: int) -> bool:
        """Whether a recipe's stage is over: at this success of a window of fully randomised episodes, or after so many steps."""
        curriculum = self.curriculum
        reached = curriculum.stage == curriculum.last and curriculum.episodes >= curriculum.window
        return self.steps - self.stage_begun >= steps or (
            success is not None and reached and curriculum.success >= success
        )


def _force_figures(peaks: torch.Tensor) -> dict[str, float]:
    """Figures of the largest filtered forces (n,) N of episodes that ended in this process."""
    if not len(peaks):
        return {}
    median, high = torch.quantile(peaks, torch.tensor([0.5, 0.99], device=peaks.device)).tolist()
    return {"force_median": median, "force_q99": high, "force_max": float(peaks.max())}
