"""The suite on the project's own simulated arm and controller, in one process: a log as a recording would give."""

from __future__ import annotations

import numpy as np
from sim2real.effects.patch import Patch
from sim2real.excitation.suite import make_suite, schedule_starts
from sim2real.recordings.signals import Commands, Log

from np_control.controller import Controller
from np_control.impedance import STIFFNESS_MAX, damping
from np_control.safety import SafetyFilter
from np_description.domains import CARD
from np_description.panda import JOINT_NAMES
from np_sim_bridge.simulation import Simulation

PERIOD = 0.002


def record(only, patch: Patch = Patch(), name: str = "own") -> Log:
    """Experiments of the suite (names or families) that keep the controller's own gains."""
    plan = make_suite(only)
    starts = dict(zip(schedule_starts(plan), plan))
    end = max(starts) + round(plan[-1].duration * 1e9) + 300_000_000
    simulation, controller, guard = Simulation(CARD, patch=patch), Controller(), SafetyFilter()
    guard.start(simulation.measure().position[:7])
    rows, answers = [], []
    while simulation.stamp < end:
        measured = simulation.measure()
        q, dq = measured.position[:7], measured.velocity[:7]
        controller.observe(measured.stamp, q, dq)
        if measured.stamp in starts:
            controller.follow(starts[measured.stamp].trajectory, measured.stamp)
        answer = controller.answer()
        guard.offer(answer.stamp, JOINT_NAMES, answer.position, answer.velocity, answer.torque, now=measured.stamp)
        rows.append((q.copy(), dq.copy(), measured.effort[:7].copy()))
        answers.append((answer.position.copy(), answer.velocity.copy(), answer.torque.copy()))
        simulation.step(guard.apply(measured.stamp, q, dq).torque)
    position, velocity, effort = (np.array(part) for part in zip(*rows))
    target, target_velocity, torque = (np.array(part) for part in zip(*answers))
    time = np.arange(len(rows)) * PERIOD
    stiffness = np.tile(STIFFNESS_MAX, (len(rows), 1))
    commands = Commands(
        np.arange(len(rows)),
        target,
        target_velocity,
        torque,
        time + PERIOD / 2,
        stiffness,
        damping(stiffness, np.ones_like(stiffness)),
    )
    noise = np.random.default_rng(0).normal(size=effort.shape) * 0.02
    return Log(name, time, position, velocity, effort + noise, time - PERIOD / 2, False, commands)
