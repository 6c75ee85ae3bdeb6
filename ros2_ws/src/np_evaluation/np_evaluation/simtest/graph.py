"""Starts, calls and ends the nodes of the card graph as simulated processes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from std_srvs.srv import Trigger

from np_bringup.task_graph import task_graph
from np_description.domains import find_domain
from np_evaluation.simtest.arm import ArmDisturbance, make_bridge_class
from np_evaluation.simtest.invariants import Invariants
from np_evaluation.simtest.network import Network, find_diagnostics
from np_evaluation.simtest.plan import Plan
from np_evaluation.simtest.process import Process, find_node_class
from np_evaluation.simtest.scheduler import SECOND, Disk, Locks, Scheduler
from np_ros.processes.graph import NodeSpec

PARAMETERS = {  # shorter than the defaults, so that several episodes end in a run
    "sim_bridge": {"lockstep_timeout": 3.0},
    "episode": {"settle": 0.05, "planning": 5.0, "silence": 2.0},
    "approach": {"first_checks": 5000, "improve_checks": 100, "velocity": 0.6, "acceleration": 0.6},
}
RESPONSE_TIMEOUT = 3.0  # s until a call without a response fails


class SimulatedGraph:
    """The simulated machine of a plan and the nodes that run on it; folder: for bags."""

    def __init__(self, plan: Plan, folder: Path):
        self.plan, self._folder = plan, folder
        self.lines: list[str] = []
        self.scheduler = Scheduler(plan.seed)
        drawn = self.scheduler.rng.choice((0.0, 0.01, 1.0))
        reordered = drawn if plan.reordered is None else plan.reordered
        self.network = Network(self.scheduler, slowest=plan.slowest, reordered=reordered, delayed=plan.delayed)
        self.locks, self.disk, self.disturbance = Locks(), Disk(), ArmDisturbance()
        self.processes: dict[str, Process] = {}
        self.refusals: dict[str, int] = {}
        self.invariants = Invariants(find_domain(plan.domain), self.scheduler, self.find_node, self.log)
        # `simulate_host` replaces the clocks of loaded modules only: load those of all nodes first.
        self._classes = {spec.name: find_node_class(spec) for spec in self.make_specs()}
        self._classes["sim_bridge"] = make_bridge_class(self.invariants, self.disturbance)

    def log(self, text: str) -> None:
        """Append a line with the time since the beginning of the run."""
        self.lines.append(f"{self.seconds:9.4f} s  {text}")

    @property
    def seconds(self) -> float:
        """s since the beginning of the run."""
        return (self.scheduler.now - SECOND) * 1e-9

    def find_node(self, name: str):
        """Find the node of this name, None if it does not run."""
        process = self.processes.get(name)
        return process.node if process is not None and process.is_alive else None

    def make_specs(self) -> list[NodeSpec]:
        """Make the specifications of the plan's nodes from the graph's table."""
        plan = self.plan
        arguments = {"mode": plan.mode, "domain": plan.domain, "keypoints": "truth", "seed": str(plan.seed)}
        if plan.is_recorded:
            arguments |= {"bag": str(self._folder / "bag"), "record_at_start": "false"}
        changed = {**PARAMETERS, "episode": {**PARAMETERS["episode"], "post_timeout": plan.post_timeout}}
        return [replace(s, parameters={**s.parameters, **changed.get(s.name, {})}) for s in task_graph(arguments)]

    def start(self, name: str) -> None:
        """Start a node unless it runs."""
        if self.find_node(name) is None:
            self.log(f"{name} starts")
            spec = next(spec for spec in self.make_specs() if spec.name == name)
            self.processes[name] = Process(self.network, spec, self._classes[name], self.log, self._list_running)

    def end(self, name: str, *, killed: bool) -> None:
        """End a node by SIGKILL or SIGINT."""
        process = self.processes.get(name)
        if process is None or not process.is_alive:
            return
        for key, count in getattr(find_diagnostics(process.node), "counts", {}).items():
            self.refusals[f"{name}: {key}"] = self.refusals.get(f"{name}: {key}", 0) + count
        if not killed:
            process.stop()
            return
        process.kill()
        if name == "sim_bridge":  # the only node that takes a lock
            self.locks.release_all()

    def call(self, service: str, on_response: Callable[[object], None], request: object = None) -> None:
        """Call a service, by default a Trigger; `on_response` receives the response, None after RESPONSE_TIMEOUT."""
        process, responses = self.processes.get(service.partition("/")[0]), []

        def receive(response: object) -> None:
            if not responses:
                responses.append(response)
                self.log(f"{service}: " + (f"{response.success}: {response.message}" if response else "no response"))
                on_response(response)

        if process is not None and process.is_alive:
            process.call(service, request or Trigger.Request(), receive)
        self.scheduler.call_after(round(RESPONSE_TIMEOUT * SECOND), lambda: receive(None))

    def _list_running(self) -> list[str]:
        return [name for name in self.processes if self.find_node(name) is not None]
