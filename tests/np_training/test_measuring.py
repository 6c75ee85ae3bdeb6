"""Measurements of speed, tiny, on the CPU."""

import pytest
import torch

from np_training.bench import measuring

WORLDS, ROLLOUT = 8, 2


@pytest.fixture(scope="module")
def trainer():
    return measuring.make_trainer("card", "cpu", WORLDS, ROLLOUT, 0, None)


def test_the_parts_of_an_iteration_are_less_than_the_whole_and_leave_the_trainer_as_it_was(trainer):
    env, before = trainer.environment, trainer.iteration
    solve, bound = measuring.environment_module.solve_ik, dict(vars(env))
    found = measuring.parts(trainer)
    assert trainer.iteration == before + 1
    alone = ("draw_starts", "observe", "step", "physics", "reset", "update")
    rounding = 0.001 * len(found)
    assert min(found.values()) >= 0 and sum(found[name] for name in alone) <= found["iteration"] + rounding
    assert found["inverse_kinematics"] <= found["step"] + found["reset"]
    assert measuring.environment_module.solve_ik is solve and set(vars(env)) == set(bound)


def test_bare_physics_goes_through_the_states_of_the_rollout(trainer):
    physics, seen = trainer.environment.physics, []
    states = measuring.record_states(trainer)
    assert len(states) == ROLLOUT
    assert not torch.equal(states[0][0], states[1][0])
    advance, physics.advance = (
        physics.advance,
        lambda: seen.append((physics.qpos.clone(), physics.command.clone())),
    )
    try:
        assert measuring.advance_from(physics, states) == ROLLOUT
    finally:
        physics.advance = advance
    for (qpos, command), (wanted, _, commanded) in zip(seen, states):
        assert torch.equal(qpos, wanted) and torch.equal(command, commanded)


def test_the_rate_counts_periods_worlds_and_substeps(trainer, monkeypatch):
    clock = iter(range(100))
    monkeypatch.setattr(measuring.time, "perf_counter", lambda: float(next(clock)))
    rate = measuring.measure(trainer.environment.physics, lambda: 3, 2.0)
    substeps = trainer.environment.physics.config.substeps
    # Of every two readings of the clock one second belongs to the round.
    assert rate.rounds == 2 and rate.steps_per_second == pytest.approx(3 * 2 * substeps * WORLDS / 2)
