"""The scripts of the simulation against the graph itself: its nodes as processes, over DDS, in a ROS domain of their own.

A script begins when all nodes that start at once have found each other. Topics that a fault changes go through a relay.
"""

from __future__ import annotations

import time
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from np_control.safety import LIMITS
from np_description.domains import find_domain
from np_description.phases import IDLE
from np_evaluation.simtest.dds_process import DdsProcess
from np_evaluation.simtest.invariants import NEXT, REST, Invariants
from np_evaluation.simtest.plan import Plan, Report
from np_evaluation.simtest.relay import BEFORE, PUBLISHER, Relay
from np_evaluation.simtest.run import Run
from np_evaluation.simtest.scheduler import SECOND
from np_ros import qos
from np_ros.client.connection_status import ConnectionStatus
from np_ros.client.graph_client import GraphClient
from np_ros.low_latency.raw import read_stamp
from np_ros.phases import phase_state
from np_ros.processes.graph import NodeSpec
from np_ros.processes.supervisor import Supervisor

_INSIDE = {"clock_jump", "sensor_nan", "sensor_jump", "push", "disk_full", "crash_recorder"}
"""Kinds that need a hand on the machine's clock, in the backend's process or on the disk."""
_STARTING = {"late_start", "crash", "stop"}
_SERVICES = "sim_bridge/reset", "sim_bridge/recover", "sim_bridge/stop", "episode/start", "episode/stop"
_READY = 300.0  # s until the graph is up: only how long a broken one takes to fail
_AGAIN = SECOND // 20  # ns between two looks whether a process has ended


def playable(plan: Plan) -> Plan:
    """The plan without what cannot be brought about from outside; nothing is recorded."""
    return replace(plan, is_recorded=False, faults=tuple(f for f in plan.faults if f.kind not in _INSIDE))


class _OutsideInvariants(Invariants):
    """What can be checked where no node's inside is seen."""

    held_since: int | None = None
    """ns, the arm's time when the backend first said that it had stopped; None: it has not."""
    stamp = 0
    """ns, of the newest state."""

    def on_state(self, data: bytes) -> None:
        """A message on `joint_states`."""
        self.count_step()
        self.stamp = read_stamp(data)
        if self.held_since is None or (late := self.stamp - self.held_since) <= REST:
            return
        speed = float(np.abs(deserialize_message(data, JointState).velocity[:7]).max())
        if speed > LIMITS.rest_speed:
            self.violate("rest", f"{speed:.2f} rad/s {late / 1e6:.0f} ms after it was stopped")

    def on_numbered_phase(self, publisher: DdsProcess, data: bytes, number: int) -> None:
        """A message on `episode/phase` with its number; what is latched keeps the newest alone, so that one before it may not come."""
        if getattr(publisher, "number", 0) + 1 != number:
            state = phase_state(deserialize_message(data, DiagnosticArray))
            publisher.said = next(before for before, then in NEXT.items() if state.phase in then)
            self._log(f"a phase before {state} was overwritten before it came")
        publisher.number = number
        self.on_phase(publisher, data)

    def _check_success(self) -> None:
        """Only the episode's process has the estimate."""


class DdsRun(Run):
    """Plays a plan over DDS; the report's plan has the times at which nodes that a fault had ended spoke again."""

    settled = 120.0

    def __init__(self, plan: Plan, folder: Path):
        self._relayed = {fault.target for fault in plan.faults if fault.target in PUBLISHER}
        super().__init__(plan, folder)
        self.invariants = _OutsideInvariants(find_domain(plan.domain), self.scheduler, self.node, self.log)
        self._first_words: list[tuple[str, float]] = []  # node, s
        self._zero = time.monotonic_ns()

    def specs(self) -> list[NodeSpec]:
        """As in the simulation; a topic that goes through a relay is published by another name."""
        return [
            replace(
                spec,
                remappings=[(topic, topic + BEFORE) for topic in self._relayed if PUBLISHER[topic] == spec.name],
            )
            for spec in super().specs()
        ]

    def play(self) -> Report:
        """Run it to its end."""
        with ExitStack() as stack:
            self._supervisor = stack.enter_context(Supervisor(self._folder / "log"))
            self._peer = stack.enter_context(closing(GraphClient("simtest", domain_id=self._supervisor.domain_id)))
            stack.callback(self._thaw_all)
            self._listen()
            links = ConnectionStatus(self._peer.node)
            self._start_first()
            names = {*self.processes}
            self._peer.wait_until(lambda: self._look() or links.are_complete(names), _READY, "the graph")
            self._peer.wait_until(self._is_calm, _READY, "a graph at rest")
            self._begin()
            self._operate_under_faults()
            self._hear_all_counts()
            self._end_all()
        return replace(self._report(0.0), plan=replace(self.plan, faults=tuple(self._measured())))

    def _is_calm(self) -> bool:
        """A machine that starts seven processes at once may be too slow for an arm in real time: it then stops, and is asked to go on."""
        self._look()
        watch = self.invariants
        if watch.held_since is not None:
            self._peer.call("sim_bridge/recover")
        return bool(watch.held_since is None and watch.phases and watch.phases[-1].phase == IDLE)

    def _begin(self) -> None:
        """What came before is no part of the run."""
        self._hear_all_counts()
        for process in self.processes.values():
            process.forget_counts()
        del self.invariants.phases[:-1]
        self.invariants.steps = 0
        self._first_words.clear()
        self._zero = time.monotonic_ns()
        self._keep_looking()

    def start(self, name: str) -> None:
        """Start a node, unless it runs; one that is ending is waited for."""
        if name not in self._supervisor.names:
            self.log(f"{name} starts")
            spec = next(spec for spec in self.specs() if spec.name == name)
            self.processes[name] = DdsProcess(self._supervisor, spec, self.scheduler, self._clients)
        elif self.node(name) is None:
            self.scheduler.after(_AGAIN, lambda: self.start(name))

    def ask(self, service: str, then, request=None) -> None:
        """As in the simulation."""
        if service == "sim_bridge/reset":
            self.invariants.on_reset()
        super().ask(service, then, request)

    def _listen(self) -> None:
        node, watch, is_lockstep = self._peer.node, self.invariants, self.plan.mode == "lockstep"
        self._relays = [Relay(node, topic, self.network, is_lockstep=is_lockstep) for topic in self._relayed]
        for topic, kind, profile, callback in (
            ("goal_pose", PoseStamped, qos.LATCHED, watch.on_goal),
            ("episode/phase", DiagnosticArray, qos.RECORDER_LATCHED, self._on_numbered_phase),
            ("diagnostics", DiagnosticArray, qos.RECORDER, self._on_diagnostics),
            ("joint_states", JointState, qos.RECORDER, watch.on_state),
        ):
            name = topic + BEFORE if topic in self._relayed else topic
            node.create_subscription(kind, name, callback, profile, raw=True)
        self._clients = {name: node.create_client(Trigger, name) for name in _SERVICES}
        self._clients["sim_bridge/pause"] = node.create_client(SetBool, "sim_bridge/pause")

    def _pass_time(self) -> None:
        self._peer.spin_once(0.002)
        self.scheduler.run_until(SECOND + time.monotonic_ns() - self._zero)

    def _look(self) -> None:
        for process in self.processes.values():
            process.look()

    def _keep_looking(self) -> None:
        self._look()
        self.scheduler.after(_AGAIN, self._keep_looking)

    def _is_quiet(self) -> bool:
        return super()._is_quiet() and all(each.is_alive and each.has_spoken for each in self.processes.values())

    def _hear_all_counts(self) -> None:
        """Who lives says once a second what it has counted."""
        self._thaw_all()
        for process in self.processes.values():
            process.has_spoken = False
        self._peer.wait_until(
            lambda: self._look() or all(each.has_spoken or not each.is_alive for each in self.processes.values()),
            _READY,
            "the nodes' counts",
        )

    def _thaw_all(self) -> None:
        for process in self.processes.values():
            process.thaw()

    def _measured(self):
        """The faults; one that ends a node lasts until it has spoken again."""
        for fault in self.plan.faults:
            ended = fault.at + fault.seconds
            spoke = [at for name, at in self._first_words if name == fault.target and at > ended]
            yield replace(fault, seconds=spoke[0] - fault.at) if spoke and fault.kind in _STARTING else fault

    def _on_numbered_phase(self, data: bytes, info: dict) -> None:
        episode = self.processes["episode"]
        self.invariants.on_numbered_phase(episode, data, info["publication_sequence_number"])
        self._on_phase(episode, data)

    def _on_diagnostics(self, data: bytes) -> None:
        self.invariants.on_diagnostics(data)
        for status in deserialize_message(data, DiagnosticArray).status:
            name, said = status.name.lstrip("/"), {pair.key: pair.value for pair in status.values}
            if (process := self.processes.get(name)) is None:
                continue
            if not process.has_spoken:
                self._first_words.append((name, self.seconds))
            process.on_diagnostics(said)
            if name == "sim_bridge":
                is_held, watch = said.get("state") in ("stopped", "fault"), self.invariants
                watch.held_since = (watch.held_since or watch.stamp) if is_held else None
