"""Faults over the wire: each is injected into a fast motion, and what the arm did then is taken from the
robot itself.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from backends import silent
from moving_arm import RUNNING, MovingArm

from np_evaluation.conformance.commands import Make
from np_franka.limits import FR3_LIMITS

BOTH = ("topic", "onboard")
ENDED = ("stopped", "fault")
NEAR = 0.02  # rad from the soft wall
PRESSED_NS = 500_000_000  # ns against it
Inject = Callable[[MovingArm], None]


@dataclass(frozen=True)
class Case:
    """One fault. inject: brings it about, and waits for what the driver makes of it. controls: modes in which
    it can be; motion: swing (every joint, a trajectory) or turn (the last joint, commands that keep coming);
    controller: whether, in topic mode, the node joint_impedance commands, or the harness."""

    title: str
    inject: Inject
    controls: tuple[str, ...] = BOTH
    motion: str = "swing"
    controller: bool = True


@dataclass(frozen=True)
class Row:
    """What the arm did from the fault on.

    state, cause: the driver's words; peak_speed rad/s and peak_speed_share of its limit; peak_torque Nm, its
    share and the greatest change from one command to the next, Nm, of what the driver commanded; time_to_rest
    s; range_left rad: least distance to the end of a joint's range; braked_by: who commanded the arm when it
    came to rest; after: the state after recovery."""

    fault: str
    control: str
    state: str
    cause: str
    peak_speed: float
    peak_speed_share: float
    peak_torque: float
    peak_torque_share: float
    peak_torque_step: float
    time_to_rest: float
    range_left: float
    braked_by: str
    after: str


def run(name: str, control: str) -> Row:
    """Inject one fault into a moving arm."""
    case = CASES[name]
    with MovingArm(control, controller=case.controller, priority=True) as arm:
        getattr(arm, case.motion)()
        begin = arm.robot.request("state")["time"]
        case.inject(arm)
        arm.rest()
        trace = arm.trace()
        status, message = arm.harness.status["state"], arm.harness.message
        if status not in RUNNING:
            restore(arm)
        after = arm.harness.status["state"]
    return _row(case.title, control, status, message, trace[trace[:, 0] > begin], after)


def _row(fault: str, control: str, state: str, message: str, trace: np.ndarray, after: str) -> Row:
    time, q, dq, torque = trace[:, 0], trace[:, 1:8], np.abs(trace[:, 8:15]), trace[:, 15:22]
    ours = trace[:, 23] > 0
    moving = np.flatnonzero(dq.max(axis=1) >= FR3_LIMITS.rest_speed)
    end = int(moving[-1]) if moving.size else 0
    commanded = np.abs(torque[ours]) if ours.any() else np.zeros((1, 7))
    return Row(
        fault,
        control,
        state,
        message.partition(": ")[2],
        round(float(dq.max()), 3),
        round(float((dq / FR3_LIMITS.velocity).max()), 3),
        round(float(commanded.max()), 2),
        round(float((commanded / FR3_LIMITS.torque).max()), 3),
        round(float(trace[:, 22].max()), 3),
        round(float(time[end] - time[0]), 3),
        round(float(np.minimum(q - FR3_LIMITS.position_lower, FR3_LIMITS.position_upper - q).min()), 3),
        "driver" if ours[end] else "robot",
        after,
    )


def over_limit(row: Row) -> list[str]:
    """The limits that were not kept, in words."""
    step = FR3_LIMITS.torque_rate * FR3_LIMITS.period
    checks = (
        ("speed", row.peak_speed_share, 1.0),
        ("torque", row.peak_torque_share, 1.0),
        ("torque step", row.peak_torque_step, step + 1e-6),
        ("distance beyond the range", -row.range_left, 0.0),
    )
    return [f"{name}: {value} is over {limit}" for name, value, limit in checks if value > limit]


def measure(name: str, control: str) -> dict:
    """A row for a report, with the limits that were not kept."""
    row = run(name, control)
    return {**asdict(row), "over_limit": over_limit(row)}


def restore(arm: MovingArm) -> None:
    """Back to an arm that can be commanded."""
    if arm.has_controller and "joint_impedance" not in arm.harness.graph.names:
        arm.start_controller()
    arm.recover()


# Injections


def asked(*requests: str, ends: bool = True, says: str = "", then: str = "") -> Inject:
    """Asks the robot for these; ends: waits until driver or robot has stopped the arm; says: what the driver
    must say of it; then: asked for after that."""

    def inject(arm: MovingArm) -> None:
        for request in requests:
            arm.robot.request(request)
        if ends:
            arm.harness.wait_state(*ENDED)
        assert says in arm.harness.message, arm.harness.message
        if then:
            arm.robot.request(then)

    return inject


def answered(bad: Callable[[MovingArm], tuple[Make, Sequence[str]]]) -> Inject:
    """Answers every state with bad commands until the arm is stopped; bad: what makes them, and the reasons
    one of which they must be refused for."""

    def inject(arm: MovingArm) -> None:
        arm.harness.answer, reasons = bad(arm)
        arm.harness.wait_state("stopped")
        assert any(map(arm.harness.refused, reasons)), arm.harness.status

    return inject


def not_a_number(arm: MovingArm) -> tuple[Make, Sequence[str]]:
    bad = arm.harness.commands.bad
    reason = "not_finite" if "not_finite" in bad else "finite"
    return bad[reason], (reason,)


def stale(arm: MovingArm) -> tuple[Make, Sequence[str]]:
    old = arm.harness.commands.turn_fast(arm.harness.states[0])
    return lambda _: old, ("order", "late")


def kill_controller(arm: MovingArm) -> None:
    arm.harness.graph.kill("joint_impedance", signal.SIGKILL)
    arm.harness.wait_state("stopped")


def end_targets(arm: MovingArm) -> None:
    """Without targets a controller of its own process holds the last one; on board the driver stops."""
    arm.harness.answer = silent
    if arm.control == "onboard":
        arm.harness.wait_state("stopped")


def kill_driver(arm: MovingArm) -> None:
    """The robot may miss 20 commands before it hears that the connection is closed: the kernel first takes
    back the memory that the process had locked. Then it is in reflex, and the next driver comes up at fault."""
    arm.robot.request("strict")
    arm.harness.graph.kill("franka_driver", signal.SIGKILL)
    arm.harness.wait(lambda: arm.state()["mode"] != "kMove", "the robot to notice")
    arm.rest()
    if arm.has_controller:
        arm.harness.graph.kill("joint_impedance", signal.SIGKILL)
        arm.has_controller = False
    arm.robot.request("lenient")
    arm.harness = arm.start_driver()
    arm.harness.wait(lambda: "state" in arm.harness.status, "the new driver's state")


def freeze(arm: MovingArm) -> None:
    arm.robot.request("strict")
    arm.robot.freeze()
    arm.harness.wait_state(*ENDED)
    arm.harness.wait(lambda: arm.robot.hostname in arm.harness.status["last_error"], "the lost connection")
    arm.robot.thaw()


def stop(arm: MovingArm) -> None:
    assert arm.harness.call("stop").success
    arm.harness.wait_state("stopped")


def limit(arm: MovingArm) -> None:
    """On towards the end of the last joint's range at full speed, and pressed against it for half a
    second.
    """
    harness, wall = arm.harness, FR3_LIMITS.wall_upper[6]
    harness.wait(lambda: harness.states[-1].position[6] > wall - NEAR, "the soft wall")
    later = harness.stamp + PRESSED_NS
    harness.wait(lambda: harness.stamp > later, "half a second at the wall")
    harness.answer = silent
    harness.wait_state("stopped")


CASES = {
    "killed_controller": Case("controller killed", kill_controller, controls=("topic",)),
    "ended_targets": Case("policy killed: targets end", end_targets, motion="turn"),
    "killed_driver": Case("driver killed", kill_driver),
    "frozen_server": Case("robot frozen for longer than 1 s", freeze),
    "network_cut": Case("network cut", asked("strict", "mute", then="unmute")),
    "lost_15_cycles": Case("15 cycles lost", asked("strict", "drop 15", ends=False)),
    "lost_20_cycles": Case(
        "20 cycles lost, and 5 more", asked("strict", "drop 25", says="communication_constraints_violation")
    ),
    "reflex": Case("collision reflex", asked("reflex", says="joint_reflex")),
    "not_a_number": Case("NaN in every command", answered(not_a_number), motion="turn", controller=False),
    "stale": Case("stale command, over and over", answered(stale), motion="turn", controller=False),
    "joint_limit": Case("joint limit at full speed", limit, motion="turn", controller=False),
    "stop": Case("~/stop in full motion", stop),
}
PAIRS = [(name, control) for name, case in CASES.items() for control in case.controls]
