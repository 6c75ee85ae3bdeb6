"""What a withheld robot's lab records of it: both suites in PhysX in one process, and the diagnosis of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from sim2real.diagnosis import explain_gap as diagnose_arm
from sim2real.effects.patch import Patch
from sim2real.excitation.suite import end_stamp, make_suite, schedule_starts
from sim2real.recordings.reading import SECOND
from sim2real.recordings.signals import Commands, Log
from sim2real.simulation.patch_trial import try_patch
from sim2real.task.camera.rest_poses import find_rest_poses
from sim2real.task.diagnosis import TaskRecordings
from sim2real.task.diagnosis import diagnose_task as diagnose_chain
from sim2real.task.object_motion.patch_check import check_patch
from sim2real.task.suite.recording import TaskRecording, correct_encoders

from np_blind.task.simulated_lab import TORQUE_NOISE, SimulatedLab
from np_control.controller import Controller
from np_control.impedance import damping
from np_control.safety import LIMITS, SafetyFilter
from np_description.domains import BUMP, CARD
from np_description.engine import MakeEngine
from np_description.panda import JOINT_NAMES
from np_description.phases import EXCITE, PhaseState
from np_sim_bridge.simulation import Simulation

SETTLING = 1_000_000_000  # ns at rest before the plan


def record_arm(patch: Patch, seed: int, engine: MakeEngine, only: tuple[str, ...] = ()) -> Log:
    """The excitation suite, or parts of it, as the graph records it: states, and the controller's commands for them."""
    arm = Simulation(CARD, seed=seed, patch=patch, engine=engine)
    controller, guard, rng = Controller(), SafetyFilter(), np.random.default_rng([seed, 2])
    guard.start(arm.measure().position[:7])
    plan = make_suite(only)
    starts, end, sent = schedule_starts(plan, SETTLING), end_stamp(plan, SETTLING), 0
    gains = plan[0].gains
    states, answers, phases = [], [], []
    while arm.stamp < end:
        now = arm.measure()
        q, dq = now.position[:7], now.velocity[:7]
        controller.observe(now.stamp, q, dq)
        if sent < len(plan) and now.stamp >= starts[sent]:
            phases.append((now.stamp / SECOND, PhaseState(EXCITE, experiment=plan[sent].name)))
            controller.follow(plan[sent].trajectory, now.stamp, plan[sent].gains)
            gains, sent = plan[sent].gains, sent + 1
        command = controller.answer()
        states.append((q, dq, now.effort[:7] + TORQUE_NOISE * rng.standard_normal(7)))
        answers.append((command.position, command.velocity, command.torque, *gains))
        guard.offer(now.stamp, JOINT_NAMES, command.position, command.velocity, command.torque, now=now.stamp)
        arm.step(guard.apply(now.stamp, q, dq).torque)
    q, dq, effort = (np.array(column) for column in zip(*states))
    target, velocity, torque, stiffness, ratio = (np.array(column) for column in zip(*answers))
    time, half = LIMITS.period * np.arange(len(q)), LIMITS.period / 2
    commands = Commands(np.arange(len(q)), target, velocity, torque, time + half, stiffness, damping(stiffness, ratio))
    return Log("suite", time, q, dq, effort, time - half, False, commands, phases=tuple(phases))


def record_arm_physx(patch: Patch, seed: int) -> Log:
    """The excitation suite in PhysX."""
    from np_physx_bridge.engine import PhysxEngine  # where SAPIEN is

    return record_arm(patch, seed, PhysxEngine)


def record_task_physx(patch: Patch, seed: int) -> TaskRecording:
    """The task suite in PhysX, with the bump's cube, for which it is made, whatever the robot's task is: frictions are changed by shares, of every
    object alike. A robot that presses too hard has it up to there."""
    from np_physx_bridge.engine import PhysxEngine

    return SimulatedLab(BUMP, patch, seed, PhysxEngine).run(is_cut=True)


def diagnose_robot(log: Log | None, tasks: Sequence[TaskRecording]) -> tuple[Patch, dict]:
    """What the diagnosis finds in recordings of a robot, of which it is given nothing else; verdicts by program. log: None where there is none."""
    found, left_out, verdict = Patch(), (), "not recorded"
    if log is not None:
        try:
            arm = diagnose_arm([log])
            verdict, (found, trial) = arm.verdict, try_patch(arm)
            left_out = trial.left_out if trial else ()
        except ValueError as error:
            verdict = f"refused: {error}"
    tasks = [correct_encoders(task, found.per_joint("encoder_bias", "bias")) for task in tasks]
    rests = tuple(place for task in tasks for place, _ in find_rest_poses(task.track, task.domain))
    seen = TaskRecordings(tuple(tasks), tuple(task.track for task in tasks), rests)
    chain = diagnose_chain(seen, panda=found.panda())
    kept = check_patch(tasks, chain, panda=found.panda())
    verdicts = {
        "arm": verdict,
        "chain": chain.verdict,
        "rows": {row.module: row.verdict for row in chain.modules},
        "doubts": chain.abstention_reasons,
        "not_patched": [*left_out, *kept.withheld],
    }
    return Patch((*found.effects, *kept.patch.effects)), verdicts
