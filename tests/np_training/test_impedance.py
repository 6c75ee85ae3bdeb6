"""Training, node and driver: the same inputs give the same torque, to 1e-5 Nm."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from np_control import impedance
from np_control.controller import Controller, ControllerConfig
from np_control.dynamics import Dynamics
from np_control.realtime_input import RealtimeCommandInput
from np_control.safety import LIMITS, SafetyFilter, limit_torque
from np_control.trajectory import Trajectory
from np_description.domains import CARD
from np_description.panda import NOMINAL
from np_description.scene import load_model
from np_franka.limits import cycle_limits
from np_franka.onboard import Onboard

TOLERANCE = 1e-5  # Nm
# Only the torque limit is left: what the other guards do to a torque is theirs to test.
UNGUARDED = replace(LIMITS, velocity=np.full(7, 1e12), torque_rate=1e12, wall_rate=1e15, press=np.inf)
GUARDED = [replace(LIMITS, period_ns=milliseconds * 1_000_000) for milliseconds in (2, 4, 5)]
DYNAMICS = Dynamics()
# What is the same input to all must be a number in single precision, in which training keeps its states.
unit = arrays(np.float32, 7, elements=st.floats(0, 1, width=32))
signed = arrays(np.float32, 7, elements=st.floats(-1, 1, width=32))


@st.composite
def inputs(draw):
    """q (7,), dq (7,), joint target (7,), stiffness (7,), damping ratio, in single precision, within the
    robot's limits.
    """
    lower, upper = NOMINAL.position_lower + 0.1, NOMINAL.position_upper - 0.1
    q = np.float32(lower + draw(unit) * (upper - lower))
    dq = np.float32(draw(signed) * NOMINAL.velocity_limit)
    target = np.float32(q + 0.099 * draw(signed))
    span = impedance.STIFFNESS_MAX - impedance.STIFFNESS_MIN
    stiffness = np.float32(impedance.STIFFNESS_MIN + draw(unit) * span)
    ratio = draw(st.floats(impedance.DAMPING_RATIO_MIN, impedance.DAMPING_RATIO_MAX, width=32))
    return q, dq, target, stiffness, ratio


@cache
def training(limits):
    """The kernel of training with these limits, for one world on the CPU."""
    wp = pytest.importorskip("warp")
    from np_training.physics.batched_impedance import impedance_kernel, make_guards

    guards = make_guards(limits, "cpu")
    over = wp.zeros((2, 1, 7), dtype=int, device="cpu")
    peak = wp.zeros((2, 1, 7), dtype=float, device="cpu")
    none = wp.zeros((1, 7), dtype=float, device="cpu")
    delay = wp.zeros(1, dtype=int, device="cpu")

    def torque(q, dq, target, stiffness, ratio, coriolis, previous):
        def world(values):
            return wp.array(np.float32(values)[None], dtype=float, device="cpu")

        command = np.zeros((6, 1, 7), np.float32)
        command[3:, 0] = target, stiffness, np.full(7, ratio)
        out = wp.zeros((1, 7), dtype=float, device="cpu")
        wp.launch(
            impedance_kernel,
            dim=(1, 7),
            device="cpu",
            outputs=[world(previous), out, over, peak],
            inputs=[
                0,
                guards,
                world(q),
                world(dq),
                world(coriolis),
                none,
                wp.array(command, dtype=float, device="cpu"),
                delay,
                none,
                wp.full(1, 1.0, dtype=float, device="cpu"),
            ],
        )
        return out.numpy()[0].astype(float)

    return torque


def node(q, dq, target, stiffness, ratio):
    """What `joint_impedance` answers with."""
    controller = Controller(ControllerConfig(stiffness.astype(float), ratio), UNGUARDED, DYNAMICS)
    controller.observe(0, q, dq)
    RealtimeCommandInput(controller).trajectory(Trajectory(np.zeros(1), target[None].astype(float), np.zeros((1, 7))))
    controller.observe(LIMITS.period_ns, q, dq)
    return controller.answer().torque


def driver(q, dq, target, stiffness, ratio):
    """What `franka_driver` applies with the controller on board, behind its own guards."""
    limits = cycle_limits(UNGUARDED)
    onboard = Onboard(ControllerConfig(stiffness.astype(float), ratio), limits, 300_000_000)
    guards = SafetyFilter(limits)
    guards.start(q.astype(float))
    assert onboard.answer(0, q, dq) is None  # nothing to follow yet
    onboard.trajectory(Trajectory(np.zeros(1), target[None].astype(float), np.zeros((1, 7))))
    for cycle in (1, 2):  # the first asks for the measured posture
        now = cycle * limits.period_ns
        answer = onboard.answer(now, q, dq)
        guards.offer(answer.stamp, limits.joints, answer.position, answer.velocity, answer.torque, now)
    return guards.apply(now, q.astype(float), dq.astype(float)).torque


@settings(max_examples=300)
@given(inputs())
def test_training_node_and_driver_give_the_same_torque(given_inputs):
    q, dq, target, stiffness, ratio = given_inputs
    coriolis = DYNAMICS.coriolis(q.astype(float), dq.astype(float))
    learned = training(UNGUARDED)(q, dq, target, stiffness, ratio, coriolis, np.zeros(7))
    answered = node(q, dq, target, stiffness, ratio)
    applied = driver(q, dq, target, stiffness, ratio)
    np.testing.assert_allclose(learned, answered, rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(applied, answered, rtol=0, atol=TOLERANCE)


@settings(max_examples=300)
@given(inputs(), signed, st.sampled_from(GUARDED))
def test_training_guards_torque_as_the_controller_does(given_inputs, share, limits):
    """Walls, speed, torque and torque rate, at postures and speeds up to the limits and beyond the walls."""
    q, dq, target, stiffness, ratio = given_inputs
    span = NOMINAL.position_upper - NOMINAL.position_lower
    q = np.float32(NOMINAL.position_lower + (q - NOMINAL.position_lower - 0.1) / (span - 0.2) * span)
    previous = np.float32(share * NOMINAL.torque_limit)
    wanted = impedance.torque(*(np.float64(x) for x in (q, dq, target, stiffness, np.full(7, ratio))), np.zeros(7))
    expected, _ = limit_torque(limits, wanted, previous.astype(float), q.astype(float), dq.astype(float))
    got = training(limits)(q, dq, target, stiffness, ratio, np.zeros(7), previous)
    np.testing.assert_allclose(got, expected, rtol=0, atol=TOLERANCE)


@settings(max_examples=100)
@given(inputs())
def test_training_and_control_know_the_same_coriolis_torque(given_inputs):
    q, dq, *_ = given_inputs
    model = scene()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[:7], data.qvel[:7] = q, dq
    mujoco.mj_forward(model, data)
    expected = DYNAMICS.coriolis(q.astype(float), dq.astype(float))
    np.testing.assert_allclose((data.qfrc_bias - data.qfrc_gravcomp)[:7], expected, rtol=0, atol=TOLERANCE)


@cache
def scene():
    """The model that training steps."""
    return load_model(CARD, timestep=0.005, arm_collision=False)
