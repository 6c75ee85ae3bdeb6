"""The simulated arm, its integer clock, and what lockstep waits for."""

from fractions import Fraction

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from np_control.safety import SafetyFilter, State
from np_description.domains import BUMP, CARD, DOMAINS, WALL
from np_description.panda import FINGER_SPEED, JOINT_NAMES, NOMINAL, STATE_NAMES
from np_description.scene import load_model
from np_sim_bridge.barrier import LockstepBarrier
from np_sim_bridge.schedule import PERIOD, SECOND, Schedule
from np_sim_bridge.simulation import Simulation

ZERO = np.zeros(7)


def state_bytes(simulation):
    return b"".join(
        a.tobytes()
        for a in (*vars(simulation.measure()).values(), simulation.configuration())
        if isinstance(a, np.ndarray)
    )


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=DOMAINS)
def test_arm_and_object_rest_without_torque(domain):
    simulation = Simulation(domain, seed=1)
    start = simulation.task.start
    for _ in range(250):
        simulation.step(ZERO)
    measured = simulation.measure()
    assert measured.stamp == 250 * PERIOD
    assert np.abs(measured.position[:7] - NOMINAL.ready).max() < 1e-6
    assert np.linalg.norm(simulation.object_pose().position - start.position) < 1e-3


def test_measured_effort_is_the_applied_torque_and_friction_resists_it():
    simulation = Simulation(CARD)
    torque = np.zeros(7)
    torque[6] = 0.9 * NOMINAL.frictionloss[6]
    for _ in range(100):
        simulation.step(torque)
    assert np.allclose(simulation.measure().effort[:7], torque)
    assert abs(simulation.measure().position[6] - NOMINAL.ready[6]) < 1e-3
    torque[6] = 2 * NOMINAL.frictionloss[6]
    for _ in range(100):
        simulation.step(torque)
    assert simulation.measure().position[6] - NOMINAL.ready[6] > 5e-3


@settings(max_examples=5)
@given(st.integers(0, 2**31 - 1), st.integers(0, 1000))
def test_state_is_a_function_of_seed_episode_and_torques(seed, episode):
    fresh = Simulation(WALL, seed=seed, first_episode=episode)
    used = Simulation(WALL, seed=seed, first_episode=episode + 1)
    for i in range(20):
        used.set_fingers(0.03)
        used.step(np.sin(np.arange(7) + i))
    used.reset(episode, used.stamp)
    for i in range(20):
        assert state_bytes(fresh) == state_bytes(used)
        fresh.step(5 * np.cos(np.arange(7) * i))
        used.step(5 * np.cos(np.arange(7) * i))
    assert np.array_equal(fresh.task.goal.position, used.task.goal.position)


def test_time_never_runs_backwards():
    simulation = Simulation(CARD)
    simulation.step(ZERO)
    with pytest.raises(ValueError, match="backwards"):
        simulation.reset(0, 0)


def test_measurements_do_not_change_afterwards():
    simulation = Simulation(CARD)
    measured, configuration = simulation.measure(), simulation.configuration()
    before = measured.position.copy(), configuration.copy()
    simulation.step(np.full(7, 5.0))
    assert np.array_equal(measured.position, before[0]) and np.array_equal(configuration, before[1])


@pytest.mark.parametrize("opening", [-0.001, 0.0401, np.nan, np.inf])
def test_openings_out_of_range_are_refused(opening):
    with pytest.raises(ValueError, match="gripper opening: expected 0"):
        Simulation(CARD).set_fingers(opening)


def test_fingers_open_as_told_and_no_faster_than_they_can():
    simulation = Simulation(CARD)
    simulation.set_fingers(0.03)
    before = simulation.measure().position[7:].copy()
    for _ in range(350):
        simulation.step(ZERO)
        measured = simulation.measure()
        assert (np.abs(measured.position[7:] - before) <= 1.5 * FINGER_SPEED * PERIOD / SECOND).all()
        before = measured.position[7:].copy()
    assert np.allclose(measured.position[7:], 0.03, atol=1e-4)


def test_a_finger_hardly_gives_way():
    model = load_model(CARD, timestep=0.002)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    fingers = [model.joint(name).qposadr[0] for name in STATE_NAMES[7:]]
    data.qpos[fingers], data.ctrl[7:9] = 0.02, 0.02
    data.qfrc_applied[model.joint(STATE_NAMES[7]).dofadr[0]] = 20.0  # N
    arm = data.qpos[:7].copy()
    for _ in range(300):
        data.qpos[:7], data.qvel[:7] = arm, 0
        mujoco.mj_step(model, data)
    assert np.allclose(data.qpos[fingers], [0.021, 0.02], atol=1e-4)


def test_substeps_keep_the_period():
    coarse, fine = Simulation(BUMP), Simulation(BUMP, substeps=4)
    torque = np.array([0, 0, 0, 0, 0, 0, 1.0])
    for _ in range(100):
        coarse.step(torque)
        fine.step(torque)
    assert fine.stamp == coarse.stamp == 100 * PERIOD
    assert np.allclose(fine.measure().position, coarse.measure().position, atol=2e-3)


def test_divergence_is_an_error():
    simulation = Simulation(CARD)
    simulation.engine.data.qvel[:] = 1e12
    with pytest.raises(FloatingPointError, match="diverged"):
        simulation.step(ZERO)


def test_the_safety_filter_brings_the_swinging_arm_to_rest():
    simulation, guard = Simulation(CARD), SafetyFilter()
    guard.start(simulation.measure().position[:7])

    def step():
        measured = simulation.measure()
        simulation.step(guard.apply(measured.stamp, measured.position[:7], measured.velocity[:7]).torque)
        return simulation.measure()

    ready = NOMINAL.ready
    while np.abs(simulation.measure().velocity[:7]).max() < 0.5:
        guard.offer(simulation.stamp, JOINT_NAMES, ready, ZERO, [0, 0, 0, 0, 0, 0, 3.0], now=simulation.stamp)
        step()
    guard.stop()
    periods = next(i for i in range(500) if (np.abs(step().velocity[:7]) < guard.limits.rest_speed).all())
    assert guard.state is State.STOPPED and periods > 0


@given(st.integers(1, 500), st.sampled_from([1, 2, 4, 5, 10, 20, 25, 50, 100, 125, 250, 500]))
def test_images_are_taken_at_their_rate_and_at_policy_ticks(image_rate, policy_rate):
    schedule = Schedule(policy_rate, image_rate)
    due = {t for t in range(0, SECOND, PERIOD) if schedule.is_image_due(t)}
    expected = {round(Fraction(k * SECOND, image_rate * PERIOD)) * PERIOD for k in range(image_rate)}
    ticks = {t for t in range(0, SECOND, PERIOD) if schedule.is_policy_tick(t)}
    assert due == {t for t in expected | ticks if t < SECOND}
    assert len(ticks) == policy_rate


@given(st.integers(0, 10**12))
def test_the_next_policy_tick_is_the_first_one_later(stamp):
    schedule = Schedule()
    tick = schedule.next_policy_tick(stamp)
    assert schedule.is_policy_tick(tick) and stamp < tick <= stamp + schedule.policy_period


@pytest.mark.parametrize("rates", [(3, 30), (0, 30), (10, 0), (10, 501)])
def test_rates_that_the_period_cannot_carry_are_refused(rates):
    with pytest.raises(ValueError, match="rate: expected"):
        Schedule(*rates)


def test_the_barrier_names_the_earliest_missing_answer():
    barrier = LockstepBarrier(Schedule(), tick_barrier=True)
    tick = Schedule().policy_period
    barrier.begin(tick)
    assert barrier.missing() == "episode/tick"
    barrier.command(tick)
    barrier.tick(tick, "post")
    assert barrier.missing() == "target_pose"
    barrier.target(tick)
    assert barrier.missing() is None
    barrier.begin(tick)  # again, after a recovery: only the controller's answer has lost its worth
    assert barrier.missing() == "effort_command"
    barrier.begin(tick + PERIOD)
    assert barrier.missing() == "effort_command"
    barrier.command(tick)
    assert barrier.missing() == "effort_command"
    barrier.command(tick + PERIOD)
    assert barrier.missing() is None


def test_without_the_tick_barrier_only_the_controller_is_waited_for():
    barrier = LockstepBarrier(Schedule(), tick_barrier=False)
    barrier.begin(0)
    assert barrier.missing() == "effort_command"
    barrier.command(0)
    assert barrier.missing() is None
