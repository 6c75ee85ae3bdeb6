"""A robot, its driver and, with `control:=topic`, its controller, put into motion: what faults are injected
into.
"""

from __future__ import annotations

import os
import tempfile
import time
from contextlib import ExitStack, closing, nullcontext
from pathlib import Path

import numpy as np
from backends import BACKENDS, Harness, silent
from diagnostic_msgs.msg import DiagnosticArray
from graph_tools import Graph, Probe
from simulated_robot import DRIVER_CORES, SLOW, SimulatedRobot, simulated_robot, urgent
from trajectory_msgs.msg import JointTrajectory

from np_description.panda import JOINT_NAMES, NOMINAL
from np_description.phases import FAULT, IDLE, PhaseState
from np_evaluation.conformance.commands import TARGETS
from np_franka.limits import FR3_LIMITS
from np_planning.time_parametrization import ACCELERATION_LIMIT, parametrize_path
from np_ros import qos
from np_ros.messages import trajectory_message
from np_ros.phases import phase_message

SWING = np.array([0.9, 0.4, -0.7, 0.5, 0.8, 0.6, 1.2])  # rad, of the seven joints from where they are
FAST = 0.4  # share of its speed limit that a joint has when a fault is injected
CONTROLLER_PRIORITY = 45
POLL = 0.02  # s
PAUSE = 0.9  # s without a state, after which libfranka may have given the robot up: it waits for 1 s
RUNNING = ("ready", "moving")


class MovingArm:
    """`control` is topic or onboard. In topic mode the node joint_impedance commands, unless `controller` is
    False: then the harness does. pace: of the robot, see SimulatedRobot; priority: whether robot, driver and
    controller run at real-time priority. End it with `close`."""

    def __init__(self, control: str, *, controller: bool = True, pace: float = SLOW, priority: bool = False):
        self._pace = pace
        self.control, self.has_controller = control, controller and control == "topic"
        self._stack = ExitStack()
        try:
            with urgent() if priority else nullcontext():
                self._start()
        except BaseException:
            self.close()
            raise

    def _start(self) -> None:
        stack = self._stack
        self._asked, self._state = -POLL, {}
        self._folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        self.robot: SimulatedRobot
        self.robot, self._parameters = stack.enter_context(simulated_robot(pace=self._pace))
        self.harness = self.start_driver()
        self._wait_for(*RUNNING)
        if self.has_controller:
            self.harness.commands = TARGETS  # which the controller follows
            for topic, message_type in TARGETS.sent.items():
                self.harness.probe.advertise(topic, message_type)
            self.start_controller()
            self._wait_for("moving")

    def start_driver(self) -> Harness:
        """A driver for the robot, in a graph of its own."""
        graph = self._stack.enter_context(Graph(self._folder / f"log{len(list(self._folder.iterdir()))}"))
        probe = self._stack.enter_context(closing(Probe(graph)))
        probe.advertise("joint_trajectory", JointTrajectory, qos.EVENT)
        probe.advertise("episode/phase", DiagnosticArray, qos.LATCHED)
        backend = BACKENDS["franka_driver" if self.control == "topic" else "franka_driver_onboard"]
        harness = Harness(graph, probe, backend, "realtime", **self._parameters)
        if self._parameters["realtime_priority"]:
            os.sched_setaffinity(graph.pid("franka_driver"), DRIVER_CORES)
        return harness

    def start_controller(self) -> None:
        """The node that commands in topic mode."""
        harness = self.harness
        priority = CONTROLLER_PRIORITY if self._parameters["realtime_priority"] else 0
        harness.graph.run("np_control", "joint_impedance", {"mode": "realtime", "realtime_priority": priority})
        harness.wait(lambda: all(map(harness.probe.matched, [*TARGETS.sent, "joint_trajectory"])), "the controller")

    def close(self) -> None:
        """End every process."""
        self._stack.close()

    def __enter__(self) -> MovingArm:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def swing(self) -> None:
        """Set every joint moving, on one trajectory, until the first is fast."""
        harness = self.harness
        harness.wait(lambda: harness.probe.matched("joint_trajectory"), "whoever follows trajectories")
        begin = np.array(harness.states[-1].position[:7])
        motion = parametrize_path(
            np.linspace(begin, begin + SWING, 50), 0.7 * NOMINAL.velocity_limit, 0.5 * ACCELERATION_LIMIT
        )
        harness.probe.publish(
            "joint_trajectory",
            trajectory_message(harness.stamp, JOINT_NAMES, motion.times, motion.positions, motion.velocities),
            qos.EVENT,
        )
        self._wait_fast()

    def turn(self) -> None:
        """Turn the last joint, by commands that keep coming, until it is fast."""
        self.harness.answer = self.harness.commands.turn_fast
        self.harness.send(self.harness.commands.turn_fast(self.harness.states[-1]))
        self._wait_fast()

    def _wait_fast(self) -> None:
        def is_fast() -> bool:
            if self.harness.status.get("state") in ("stopped", "fault"):
                raise RuntimeError(f"the arm was to move, and is not: {self.harness.message}")
            return self.speed_share() > FAST

        self.harness.wait(is_fast, "a fast joint")

    def state(self) -> dict:
        """The robot's own account, at most POLL s old: asking takes its time."""
        if time.monotonic() - self._asked > POLL:
            self._asked, self._state = time.monotonic(), self.robot.request("state")
        return self._state

    def speed_share(self) -> float:
        """Greatest share of its speed limit that a joint of the robot has."""
        return float(np.max(np.abs(self.state()["dq"]) / FR3_LIMITS.velocity))

    def rest(self) -> None:
        """Wait until the robot, by its own account, has been at rest for 0.2 s of its time."""
        since = None

        def is_at_rest() -> bool:
            nonlocal since
            state = self.state()
            if np.abs(state["dq"]).max() >= FR3_LIMITS.rest_speed:
                since = None
            elif since is None:
                since = state["time"]
            return since is not None and state["time"] - since > 0.2

        self.harness.wait(is_at_rest, "rest")

    def hold_anew(self) -> None:
        """Stop and recover: the driver counts its cycles from here on."""
        assert self.harness.call("stop").success
        self.harness.wait_state("stopped")
        self.rest()
        self.recover()

    def deafen(self) -> None:
        """Listen to states no longer: reading 500 a second takes time from what is measured."""
        node = self.harness.probe.node
        for subscription in list(node.subscriptions):
            if subscription.topic_name == "/joint_states":
                node.destroy_subscription(subscription)

    def recover(self) -> str:
        """Recover as an operator and the episode node do; the state that this leads to."""
        self.harness.answer = silent
        self.robot.request("lenient")
        while not self._recovers():
            pass
        self._wait_for(*RUNNING)
        return self.harness.status["state"]

    def _recovers(self) -> bool:
        """Ask for recovery, with the phases that let a controller's target go along with the arm."""
        probe = self.harness.probe
        probe.publish("episode/phase", phase_message(PhaseState(FAULT)), qos.LATCHED)
        response = self.harness.call("recover")
        probe.publish("episode/phase", phase_message(PhaseState(IDLE)), qos.LATCHED)
        refused = "still moves", "nothing to recover"
        assert response.success or any(text in response.message for text in refused), response.message
        return response.success

    def _wait_for(self, *states: str) -> None:
        """Wait for one of these states. Where a busy machine has kept the controller from answering for so
        long that the watchdog has rightly stopped the arm, or the robot itself, by its own account, from
        telling its state for so long that it was given up, recover and go on."""
        harness = self.harness

        def is_reached() -> bool:
            if harness.status.get("state") == "stopped" and "silence" in harness.message:
                self._recovers()
            elif harness.status.get("state") == "fault" and self.robot.request("state")["pause"] > PAUSE:
                self.robot.request("forget")
                self._recovers()
            return harness.status.get("state") in states

        harness.wait(is_reached, f"state {' or '.join(states)}")

    def trace(self) -> np.ndarray:
        """What the robot did: rows of time s, q, dq, torque told (7 each), step of torque, whether it was
        commanded.
        """
        path = self._folder / "trace.npy"
        self.robot.request(f"trace {path}")
        return np.load(path)
