"""The nodes of the card graph as simulated processes: started, asked, ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from std_srvs.srv import Trigger

from np_bringup.task_graph import task_graph
from np_description.domains import find_domain
from np_evaluation.simtest.arm import ArmDisturbance, bridge_class
from np_evaluation.simtest.invariants import Invariants
from np_evaluation.simtest.network import Network, diagnostics_of
from np_evaluation.simtest.plan import Plan
from np_evaluation.simtest.process import Process, node_class
from np_evaluation.simtest.scheduler import SECOND, Disk, Locks, Scheduler
from np_ros.processes.graph import NodeSpec

PARAMETERS = {  # shorter than usual, so that a run sees several ends
    "sim_bridge": {"lockstep_timeout": 3.0},
    "episode": {"settle": 0.05, "planning": 5.0, "silence": 2.0},
    "approach": {"first_checks": 5000, "improve_checks": 100, "velocity": 0.6, "acceleration": 0.6},
}
ANSWER = 3.0  # s for a service


class SimulatedGraph:
    """What a plan's nodes run on, and the nodes that run; folder: for bags."""

    def __init__(self, plan: Plan, folder: Path):
        self.plan, self._folder = plan, folder
        self.lines: list[str] = []
        self.scheduler = Scheduler(plan.seed)
        drawn = self.scheduler.rng.choice((0.0, 0.01, 1.0))
        reordered = drawn if plan.reordered is None else plan.reordered
        self.network = Network(self.scheduler, slowest=plan.slowest, reordered=reordered)
        self.locks, self.disk, self.disturbance = Locks(), Disk(), ArmDisturbance()
        self.processes: dict[str, Process] = {}
        self.refusals: dict[str, int] = {}
        self.invariants = Invariants(find_domain(plan.domain), self.scheduler, self.node, self.log)
        # Their modules, too, have to be there before they are given the simulated clock.
        self._classes = {spec.name: node_class(spec) for spec in self.specs()}
        self._classes["sim_bridge"] = bridge_class(self.invariants, self.disturbance)

    def log(self, text: str) -> None:
        """A line, with the time since the beginning."""
        self.lines.append(f"{self.seconds:9.4f} s  {text}")

    @property
    def seconds(self) -> float:
        """s since the beginning."""
        return (self.scheduler.now - SECOND) * 1e-9

    def node(self, name: str):
        """The node of this name, None where it does not run."""
        process = self.processes.get(name)
        return process.node if process is not None and process.is_alive else None

    def specs(self) -> list[NodeSpec]:
        """The nodes, as the graph's table has them."""
        plan = self.plan
        arguments = {"mode": plan.mode, "domain": plan.domain, "keypoints": "truth", "seed": str(plan.seed)}
        if plan.is_recorded:
            arguments |= {"bag": str(self._folder / "bag"), "record_at_start": "false"}
        changed = {**PARAMETERS, "episode": {**PARAMETERS["episode"], "post_timeout": plan.post_timeout}}
        return [replace(s, parameters={**s.parameters, **changed.get(s.name, {})}) for s in task_graph(arguments)]

    def start(self, name: str) -> None:
        """Start a node, unless it runs."""
        if self.node(name) is None:
            self.log(f"{name} starts")
            spec = next(spec for spec in self.specs() if spec.name == name)
            self.processes[name] = Process(self.network, spec, self._classes[name], self.log, self._names)

    def end(self, name: str, *, killed: bool) -> None:
        """End a node, killed or asked to."""
        process = self.processes.get(name)
        if process is None or not process.is_alive:
            return
        for key, count in getattr(diagnostics_of(process.node), "counts", {}).items():
            self.refusals[f"{name}: {key}"] = self.refusals.get(f"{name}: {key}", 0) + count
        if not killed:
            process.stop()
            return
        process.kill()
        if name == "sim_bridge":  # who alone takes a lock
            self.locks.release_all()

    def ask(self, service: str, then: Callable[[object], None], request: object = None) -> None:
        """Call a service, a Trigger unless `request` is another's; `then` is given the response, None where none comes in time."""
        process, answers = self.processes.get(service.partition("/")[0]), []

        def answered(response: object) -> None:
            if not answers:
                answers.append(response)
                self.log(f"{service}: {response.success}: {response.message}" if response else f"{service}: no answer")
                then(response)

        if process is not None and process.is_alive:
            process.call(service, request or Trigger.Request(), answered)
        self.scheduler.after(round(ANSWER * SECOND), lambda: answered(None))

    def _names(self) -> list[str]:
        return [name for name in self.processes if self.node(name) is not None]
