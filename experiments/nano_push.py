"""The card from nothing in one file: a policy that pushes a card to a goal pose, learned by PPO. A teaching piece.

    python experiments/nano_push.py --minutes 10 --out runs/nano_push

The packages give what a robot shares with training: scene, physics, task, action, impedance law, kinematics. This file has the
rest: episodes, observation, reward, curriculum, PPO. It leaves out what np_training adds for the real arm: a learned pre-contact
policy, images, randomisation, force limits, several GPUs. Every hand starts over a random point of the card's upper face.

Read it from top to bottom: PushWorlds is the environment, PolicyAndValue the networks, learn() one update, main() the loop.
"""

from __future__ import annotations

import argparse
import csv
import time
from math import pi
from pathlib import Path

import torch
from torch import nn
from torch.distributions import Normal

from np_description.domains import CARD, is_lost, is_success, pose_error
from np_description.keypoints import box_keypoints
from np_policy import action as actions
from np_training.environment import contact
from np_training.physics.batched import ARM, OBJECT_POSITION, OBJECT_QUATERNION, BatchedPhysics
from np_training.physics.batched_kinematics import forward_kinematics, solve_ik
from np_training.physics.config import physics_for
from np_training.tasks.poses import Poses, sample_tasks

# --- The task: episode, observation and reward --------------------------------------------------------------------------

EPISODE = 100  # policy steps, 10 s
STAGES, ADVANCE_AT = 10, 0.8  # the residual limits shrink in ten steps, each at a success of .8 (paper)
SCALE = 0.02  # of the whole reward, so that the critic's targets are of order one


def residual_limits(stage: int) -> actions.ResidualLimits:
    """zeta of a stage: geometric from 6 cm and 0.1 rad to 2 cm and 0.03 rad a step."""
    first, last = actions.RESIDUAL_LIMITS_INITIAL, actions.RESIDUAL_LIMITS_FINAL
    share = stage / STAGES
    return actions.ResidualLimits(
        first.position * (last.position / first.position) ** share,
        first.rotation * (last.rotation / first.rotation) ** share,
    )


class PushWorlds:
    """Many cards on many tables, one policy step at a time."""

    def __init__(self, worlds: int, device: str, seed: int) -> None:
        self.worlds, self.device = worlds, torch.device(device)
        self.physics = BatchedPhysics(CARD, worlds, device, physics_for("growing"))
        self.generator = torch.Generator(device=device).manual_seed(seed)
        self.half_size = torch.tensor(CARD.half_size, device=device)
        self.limits = residual_limits(0)
        self.goal = Poses(torch.zeros(worlds, 3, device=device), torch.zeros(worlds, 4, device=device))
        self.age = torch.zeros(worlds, dtype=torch.long, device=device)
        self.last_action = torch.zeros(worlds, actions.SIZE, device=device)
        self.draw_starts()
        self.reset(torch.arange(worlds, device=device))
        self.age.random_(0, EPISODE, generator=self.generator)  # else all episodes would end at once

    @property
    def card(self) -> Poses:
        """Where the cards are now."""
        return Poses(self.physics.qpos[:, OBJECT_POSITION], self.physics.qpos[:, OBJECT_QUATERNION])

    def corners(self, poses: Poses) -> torch.Tensor:
        """Corners (worlds, 8, 3) m of cards at these poses."""
        return box_keypoints(self.half_size, poses.position, poses.quaternion)

    def draw_starts(self) -> None:
        """A pool of tasks with a hand pose each. Inverse kinematics of one large batch is cheaper than of many small ones."""
        tasks = sample_tasks(CARD, self.worlds, self.generator)
        # A contact action (np_training.environment.contact): hand down, fingers closed, over a point of the upper face.
        choice = torch.zeros(self.worlds, contact.SIZE, device=self.device)
        choice[:, 0] = torch.rand(self.worlds, generator=self.generator, device=self.device) - 0.5
        choice[:, 3] = -1
        choice[:, 6:8] = torch.rand(self.worlds, 2, generator=self.generator, device=self.device) - 0.5
        choice[:, 8] = 1
        hands = contact.resolve(CARD, choice, tasks[0])
        usable = hands.feasible.nonzero()[:, 0]
        self.pool = [Poses(p.position[usable], p.quaternion[usable]) for p in tasks], hands.q[usable]
        self.next = 0

    def reset(self, where: torch.Tensor) -> None:
        """Begin new episodes in these worlds."""
        (starts, goals), q = self.pool
        rows = (torch.arange(len(where), device=self.device) + self.next) % len(q)
        self.next += len(where)
        fingers = torch.zeros(len(where), 2, device=self.device)
        start = torch.cat([q[rows], fingers, starts.position[rows], starts.quaternion[rows]], -1)
        self.physics.place(where, start)
        self.physics.fingers[where] = fingers
        self.physics.hold(where, q[rows])
        self.goal.position[where], self.goal.quaternion[where] = goals.position[rows], goals.quaternion[rows]
        self.age[where], self.last_action[where] = 0, 0.0

    def observe(self) -> torch.Tensor:
        """The policy's observation (worlds, 87): joints, hand, the card's corners from the hand and from the goal, last action, time."""
        q, dq = self.physics.qpos[:, ARM], self.physics.qvel[:, :7]
        hand, _ = forward_kinematics(q)
        corners = self.corners(self.card)
        to_hand = 10 * (corners - hand[:, None]).flatten(1)
        to_goal = 10 * (self.corners(self.goal) - corners).flatten(1)
        left = 1 - self.age[:, None] / EPISODE
        return torch.cat([q, dq, hand, to_hand, to_goal, self.last_action, left], -1)

    def potential(self) -> torch.Tensor:
        """Higher (worlds,) the nearer the card is to its goal and the hand to the card."""
        apart = (self.corners(self.card) - self.corners(self.goal)).norm(dim=-1).mean(-1)
        _, angle = pose_error(self.card.position, self.card.quaternion, self.goal.position, self.goal.quaternion)
        hand, _ = forward_kinematics(self.physics.qpos[:, ARM])
        reach = (hand - self.card.position).norm(dim=-1)
        return 10 / (0.02 + apart) - 150 * angle / pi - 100 * reach

    def step(self, action: torch.Tensor) -> dict[str, torch.Tensor]:
        """A policy step (0.1 s) under actions (worlds, 20): reward, done, success (worlds,). Ended worlds are not reset."""
        before = self.potential()
        q = self.physics.qpos[:, ARM].clone()
        target = actions.decode(action, *forward_kinematics(q), self.limits)
        self.physics.aim(solve_ik(q, target.position, target.rotation), target)
        self.physics.advance()
        self.age += 1
        self.last_action = action.clamp(-1, 1)
        card = self.card
        success = is_success(
            CARD, *pose_error(card.position, card.quaternion, self.goal.position, self.goal.quaternion)
        )
        broken = ~torch.isfinite(self.physics.qpos).all(-1)
        lost = (is_lost(CARD, card.position) | broken) & ~success
        # Only progress pays: a policy that rests beside the goal earns nothing, one that finishes earns 1000.
        progress = torch.where(broken, 0.0, self.potential() - before)
        reward = SCALE * (progress + 1000 * success - 100 * lost)
        return {"reward": reward, "done": success | lost | (self.age >= EPISODE), "success": success}


# --- The learner: proximal policy optimisation (Schulman et al., 2017) --------------------------------------------------------

DISCOUNT, TRACE = 0.99, 0.95  # of the return, and lambda of the advantage estimate
CLIP, ENTROPY = 0.2, 0.0005
EPOCHS, MINIBATCHES = 5, 8
TARGET_KL, RATES = (
    0.015,
    (2e-5, 1e-3),
)  # how far an update may move the policy, and between what its learning rate adapts


def mlp(inputs: int, outputs: int) -> nn.Sequential:
    """Three hidden layers."""
    sizes, layers = (inputs, 256, 256, 128), []
    for one, two in zip(sizes, sizes[1:]):
        layers += [nn.Linear(one, two), nn.ELU()]
    return nn.Sequential(*layers, nn.Linear(sizes[-1], outputs))


class PolicyAndValue(nn.Module):
    """A Gaussian policy and a value function, with inputs normalised by what has been seen."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.norm = nn.BatchNorm1d(inputs, affine=False, momentum=0.01)
        self.actor, self.critic = mlp(inputs, outputs), mlp(inputs, 1)
        self.log_std = nn.Parameter(torch.full((outputs,), -0.7))
        with torch.no_grad():  # a first policy that hardly moves
            self.actor[-1].weight.mul_(0.01)

    def forward(self, state: torch.Tensor) -> tuple[Normal, torch.Tensor]:
        """The distribution of actions (n, 20) and the value (n,) of states (n, k)."""
        state = self.norm(state)
        std = self.log_std.clamp(-3.0, 0.5).exp()
        return Normal(torch.tanh(self.actor(state)), std, validate_args=False), self.critic(state)[:, 0]


def estimate_advantages(
    reward: torch.Tensor, done: torch.Tensor, value: torch.Tensor, last_value: torch.Tensor
) -> torch.Tensor:
    """Generalised advantage estimates (t, n) of rewards, ends and values (t, n), and the value (n,) after the last step."""
    result, running = torch.zeros_like(reward), torch.zeros_like(last_value)
    following = last_value
    for t in reversed(range(len(reward))):
        alive = (~done[t]).float()
        delta = reward[t] + DISCOUNT * following * alive - value[t]
        running = delta + DISCOUNT * TRACE * alive * running
        result[t], following = running, value[t]
    return result


def learn(model: PolicyAndValue, optimiser: torch.optim.Adam, batch: dict[str, torch.Tensor]) -> dict[str, float]:
    """Several epochs of PPO over one batch of (n, ...) tensors; the mean losses and divergence of the last epoch."""
    model.eval()  # the normalisation stays as it was in the rollout: else the ratio would not begin at one
    advantage = batch["advantage"]
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-6)
    count = len(advantage)
    for _ in range(EPOCHS):
        sums = torch.zeros(3)
        for rows in torch.randperm(count, device=advantage.device).chunk(MINIBATCHES):
            chosen, value = model(batch["state"][rows])
            log_ratio = chosen.log_prob(batch["action"][rows]).sum(-1) - batch["log_probability"][rows]
            ratio = log_ratio.clamp(-20, 20).exp()
            gain = torch.minimum(ratio * advantage[rows], ratio.clamp(1 - CLIP, 1 + CLIP) * advantage[rows])
            policy_loss = -gain.mean() - ENTROPY * chosen.entropy().sum(-1).mean()
            value_loss = (value - batch["returns"][rows]).square().mean()
            optimiser.zero_grad()
            (policy_loss + value_loss).backward()
            nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            optimiser.step()
            kl = (ratio - 1 - log_ratio).mean()
            sums += torch.stack([policy_loss, value_loss, kl]).detach().cpu() / MINIBATCHES
    # An update that went too far is followed by a smaller one, and one that hardly moved by a larger one.
    rate = optimiser.param_groups[0]["lr"] * (
        1 / 1.5 if sums[2] > 2 * TARGET_KL else 1.5 if sums[2] < TARGET_KL / 2 else 1
    )
    optimiser.param_groups[0]["lr"] = min(max(rate, RATES[0]), RATES[1])
    return dict(zip(("policy_loss", "value_loss", "kl"), sums.tolist()))


# --- The loop: collect, learn, tighten ----------------------------------------------------------------------------------------


def collect(env: PushWorlds, model: PolicyAndValue, steps: int) -> tuple[dict[str, torch.Tensor], int, int]:
    """A rollout as one batch for `learn`; how many episodes ended in it, and how many of them in success."""
    names = ("state", "action", "log_probability", "value", "reward", "done")
    data: dict[str, list[torch.Tensor]] = {name: [] for name in names}
    ended = won = 0
    env.draw_starts()
    model.eval()
    with torch.no_grad():
        for _ in range(steps):
            state = env.observe().nan_to_num()
            chosen, value = model(state)
            action = chosen.sample()
            out = env.step(action)
            log_probability = chosen.log_prob(action).sum(-1)
            for name, tensor in zip(names, (state, action, log_probability, value, out["reward"], out["done"])):
                data[name].append(tensor)
            ended, won = ended + int(out["done"].sum()), won + int(out["success"].sum())
            env.reset(out["done"].nonzero()[:, 0])
        _, last_value = model(env.observe().nan_to_num())
        stacked = {name: torch.stack(tensors) for name, tensors in data.items()}
        advantage = estimate_advantages(stacked["reward"], stacked["done"], stacked["value"], last_value)
        batch = {name: tensor.flatten(0, 1) for name, tensor in stacked.items()}
        batch |= {"advantage": advantage.flatten(), "returns": (advantage + stacked["value"]).flatten()}
    return batch, ended, won


def draw_curve(log: Path) -> None:
    """A picture of the log beside it: success and stage against policy steps."""
    from matplotlib.figure import Figure

    rows = list(csv.DictReader(log.open()))
    steps, success, stage = ([float(row[name]) for row in rows] for name in ("steps", "success", "stage"))
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    axes.plot([n / 1e6 for n in steps], success)
    axes.set(xlabel="million policy steps", ylabel="success", ylim=(0, 1.02))
    other = axes.twinx()
    other.step([n / 1e6 for n in steps], stage, color="0.6", where="post")
    other.set_ylabel("stage (10: residual limits of deployment)")
    figure.savefig(log.with_suffix(".png"), dpi=110)


def main(words: list[str] | None = None) -> list[dict[str, float]]:
    """Train; the rows of the log."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=24576)
    parser.add_argument("--rollout", type=int, default=12, help="policy steps between updates")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--iterations", type=int, default=10**9)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/nano_push"))
    options = parser.parse_args(words)
    options.out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(options.seed)
    env = PushWorlds(options.worlds, options.device, options.seed)
    model = PolicyAndValue(env.observe().shape[1], actions.SIZE).to(options.device)
    optimiser = torch.optim.Adam(model.parameters(), lr=3e-4, eps=1e-5)
    stage, success, counted, steps, rows = 0, 0.0, 0, 0, []
    begin = time.monotonic()
    with (options.out / "log.csv").open("w", newline="") as file:
        writer = None
        while len(rows) < options.iterations and time.monotonic() - begin < 60 * options.minutes:
            batch, ended, won = collect(env, model, options.rollout)
            figures = learn(model, optimiser, batch)
            model.train()  # what was seen moves the normalisation, between updates
            model.norm(batch["state"])
            steps += len(batch["state"])
            if ended:  # a running mean over about as many episodes as there are worlds
                weight = min(ended / options.worlds, 1.0)
                success = won / ended if counted == 0 else success + weight * (won / ended - success)
                counted += ended
            if stage < STAGES and counted > options.worlds // 2 and success >= ADVANCE_AT:
                stage, counted = stage + 1, 0
                env.limits = residual_limits(stage)
            seconds = time.monotonic() - begin
            row = {"steps": steps, "seconds": round(seconds, 1), "stage": stage, "success": success, **figures}
            writer = writer or csv.DictWriter(file, list(row))
            if not rows:
                writer.writeheader()
            writer.writerow(row)
            file.flush()
            rows.append(row)
            print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), flush=True)
    torch.save(model.state_dict(), options.out / "policy.pt")
    draw_curve(options.out / "log.csv")
    return rows


if __name__ == "__main__":
    main()
