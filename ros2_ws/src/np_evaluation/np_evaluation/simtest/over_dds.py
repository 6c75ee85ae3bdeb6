"""Runs a script of the simulation on the graph's nodes as processes over DDS, in a separate ROS domain.

The script begins when all nodes without a late start have discovered each other. A relay changes the topics of a fault.
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
from np_evaluation.simtest.invariants import NEXT_PHASES, REST_TIME, Invariants
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
"""Kinds that need access to the machine's clock, the backend's process or the disk."""
_STARTING = {"late_start", "crash", "stop"}
_SERVICES = "sim_bridge/reset", "sim_bridge/recover", "sim_bridge/stop", "episode/start", "episode/stop"
_READY = 300.0  # s until the graph is ready; only a broken graph takes as long
_POLL_PERIOD = SECOND // 20  # ns between two checks whether a process has ended


def select_playable(plan: Plan) -> Plan:
    """Select the faults that can be caused from outside; without recording."""
    return replace(plan, is_recorded=False, faults=tuple(f for f in plan.faults if f.kind not in _INSIDE))


class _OutsideInvariants(Invariants):
    """The invariants that can be checked from messages alone."""

    held_since: int | None = None
    """Arm's time at which the backend first published a stop or fault, ns; None while it is in neither."""
    stamp = 0
    """Stamp of the newest state, ns."""

    def on_state(self, data: bytes) -> None:
        """Check a message on `joint_states`."""
        self.count_step()
        self.stamp = read_stamp(data)
        if self.held_since is None or (late := self.stamp - self.held_since) <= REST_TIME:
            return
        speed = float(np.abs(deserialize_message(data, JointState).velocity[:7]).max())
        if speed > LIMITS.rest_speed:
            self.violate("rest", f"{speed:.2f} rad/s {late / 1e6:.0f} ms after it was stopped")

    def on_numbered_phase(self, publisher: DdsProcess, data: bytes, number: int) -> None:
        """Check a message on `episode/phase` with its sequence number; a latched topic keeps the newest alone, so one may be missing."""
        if getattr(publisher, "number", 0) + 1 != number:
            state = phase_state(deserialize_message(data, DiagnosticArray))
            publisher.last_phase = next(before for before, after in NEXT_PHASES.items() if state.phase in after)
            self._log(f"a phase before {state} was overwritten before it arrived")
        publisher.number = number
        self.on_phase(publisher, data)

    def _check_success(self) -> None:
        """Check nothing: only the episode's process has the estimate."""


class DdsRun(Run):
    """Runs a plan over DDS; in the report's plan, a fault that ends a node lasts until the node publishes again."""

    recovery_timeout = 120.0

    def __init__(self, plan: Plan, folder: Path):
        self._relayed = {fault.target for fault in plan.faults if fault.target in PUBLISHER}
        super().__init__(plan, folder)
        self.invariants = _OutsideInvariants(find_domain(plan.domain), self.scheduler, self.find_node, self.log)
        self._first_published: list[tuple[str, float]] = []  # node, time in s
        self._zero = time.monotonic_ns()

    def make_specs(self) -> list[NodeSpec]:
        """Make the specifications as in the simulation; the input topics of relays are renamed."""
        return [
            replace(
                spec,
                remappings=[(topic, topic + BEFORE) for topic in self._relayed if PUBLISHER[topic] == spec.name],
            )
            for spec in super().make_specs()
        ]

    def play(self) -> Report:
        """Run the plan to its end."""
        with ExitStack() as stack:
            self._supervisor = stack.enter_context(Supervisor(self._folder / "log"))
            self._peer = stack.enter_context(closing(GraphClient("simtest", domain_id=self._supervisor.domain_id)))
            stack.callback(self._thaw_all)
            self._subscribe()
            links = ConnectionStatus(self._peer.node)
            self._start_first()
            names = {*self.processes}
            self._peer.wait_until(lambda: self._poll() or links.are_complete(names), _READY, "the graph")
            self._peer.wait_until(self._is_idle, _READY, "a graph at rest")
            self._begin()
            self._operate_under_faults()
            self._wait_for_counts()
            self._end_all()
        return replace(self._report(0.0), plan=replace(self.plan, faults=tuple(self._measure_faults())))

    def _is_idle(self) -> bool:
        """Check for an idle graph; recover the backend if the arm stopped because seven starting processes slowed the machine.

        An `episode` that starts late has no phase yet.
        """
        self._poll()
        watch = self.invariants
        if watch.held_since is not None:
            self._peer.call("sim_bridge/recover")
        is_idle = "episode" not in self.processes or (watch.phases and watch.phases[-1].phase == IDLE)
        return bool(watch.held_since is None and is_idle)

    def _begin(self) -> None:
        """Discard counts, phases and steps from before the run."""
        self._wait_for_counts()
        for process in self.processes.values():
            process.reset_counts()
        del self.invariants.phases[:-1]
        self.invariants.steps = 0
        self._first_published.clear()
        self._zero = time.monotonic_ns()
        self._poll_periodically()

    def start(self, name: str) -> None:
        """Start a node unless it runs; if it is ending, start it after its end."""
        if name not in self._supervisor.names:
            self.log(f"{name} starts")
            spec = next(spec for spec in self.make_specs() if spec.name == name)
            self.processes[name] = DdsProcess(self._supervisor, spec, self.scheduler, self._clients)
        elif self.find_node(name) is None:
            self.scheduler.call_after(_POLL_PERIOD, lambda: self.start(name))

    def call(self, service: str, on_response, request=None) -> None:
        """Call a service as in the simulation; note a reset."""
        if service == "sim_bridge/reset":
            self.invariants.on_reset()
        super().call(service, on_response, request)

    def _subscribe(self) -> None:
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

    def _poll(self) -> None:
        for process in self.processes.values():
            process.poll()

    def _poll_periodically(self) -> None:
        self._poll()
        self.scheduler.call_after(_POLL_PERIOD, self._poll_periodically)

    def _are_faults_over(self) -> bool:
        return super()._are_faults_over() and all(
            each.is_alive and each.has_published for each in self.processes.values()
        )

    def _wait_for_counts(self) -> None:
        """Wait until every running node has published its counts, which it does once a second."""
        self._thaw_all()
        for process in self.processes.values():
            process.has_published = False
        self._peer.wait_until(
            lambda: self._poll() or all(each.has_published or not each.is_alive for each in self.processes.values()),
            _READY,
            "the nodes' counts",
        )

    def _thaw_all(self) -> None:
        for process in self.processes.values():
            process.thaw()

    def _measure_faults(self):
        """Yield the faults; one that ends a node lasts until the node publishes again."""
        for fault in self.plan.faults:
            ended = fault.at + fault.seconds
            published = [at for name, at in self._first_published if name == fault.target and at > ended]
            yield replace(fault, seconds=published[0] - fault.at) if published and fault.kind in _STARTING else fault

    def _on_numbered_phase(self, data: bytes, info: dict) -> None:
        episode = self.processes["episode"]
        self.invariants.on_numbered_phase(episode, data, info["publication_sequence_number"])
        self._on_phase(episode, data)

    def _on_diagnostics(self, data: bytes) -> None:
        self.invariants.on_diagnostics(data)
        for status in deserialize_message(data, DiagnosticArray).status:
            name, values = status.name.lstrip("/"), {pair.key: pair.value for pair in status.values}
            if (process := self.processes.get(name)) is None:
                continue
            if not process.has_published:
                self._first_published.append((name, self.seconds))
            process.on_diagnostics(values)
            if name == "sim_bridge":
                is_held, watch = values.get("state") in ("stopped", "fault"), self.invariants
                watch.held_since = (watch.held_since or watch.stamp) if is_held else None
