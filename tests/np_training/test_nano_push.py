"""The teaching piece runs on a CPU, and learning from a batch lowers its losses."""

import importlib.util
import os
from pathlib import Path

import torch

PATH = Path(__file__).parents[2] / "experiments" / "nano_push.py"
SPEC = importlib.util.spec_from_file_location("nano_push", PATH)
nano_push = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(nano_push)


def test_a_run_leaves_log_curve_and_policy(tmp_path):
    words = ["--worlds", "8", "--rollout", "2", "--iterations", "2", "--device", "cpu", "--out", str(tmp_path)]
    rows = nano_push.main(words)
    assert [row["steps"] for row in rows] == [16, 32] and all(row["value_loss"] > 0 for row in rows)
    assert sorted(os.listdir(tmp_path)) == ["log.csv", "log.png", "policy.pt"]


def test_learning_lowers_the_losses_of_a_batch_and_makes_better_actions_likelier():
    torch.manual_seed(0)
    model = nano_push.PolicyAndValue(4, 2)
    optimiser = torch.optim.Adam(model.parameters(), lr=1e-3)
    state, action = torch.randn(512, 4), torch.randn(512, 2)
    with torch.no_grad():
        log_probability = model.eval()(state)[0].log_prob(action).sum(-1)
    wanted = action[:, 0]  # the larger the first number, the better
    batch = {
        "state": state,
        "action": action,
        "log_probability": log_probability,
        "advantage": wanted,
        "returns": state[:, 1],
    }
    first, *_, last = (nano_push.learn(model, optimiser, batch) for _ in range(6))
    assert last["value_loss"] < 0.5 * first["value_loss"] and last["policy_loss"] < first["policy_loss"]
    assert model(state)[0].mean[:, 0].mean() > 0.02 + model(state)[0].mean[:, 1].mean()


def test_advantages_by_hand():
    reward, done = torch.tensor([[1.0], [2.0]]), torch.tensor([[False], [True]])
    value, last = torch.tensor([[0.5], [0.25]]), torch.tensor([9.0])
    first = 1 + 0.99 * 0.25 - 0.5 + 0.99 * 0.95 * 1.75
    found = nano_push.estimate_advantages(reward, done, value, last)
    torch.testing.assert_close(found, torch.tensor([[first], [1.75]]))
