"""One run: the card graph under faults, with an operator who keeps asking for episodes."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path

from std_srvs.srv import Trigger

from np_bringup.task_graph import task_graph
from np_description.domains import find_domain
from np_description.phases import ENDS, FAULT
from np_evaluation.simtest.arm import Disturbance, bridge_class
from np_evaluation.simtest.injection import Injection
from np_evaluation.simtest.invariants import Invariants
from np_evaluation.simtest.network import Network, diagnostics_of
from np_evaluation.simtest.node import Process, node_class
from np_evaluation.simtest.plan import Plan, Report
from np_evaluation.simtest.recordings import BENIGN, SentMessages, read_cut_off, replay
from np_evaluation.simtest.scheduler import SECOND, Disk, Locks, Scheduler, simulated_host
from np_ros.processes.graph import NodeSpec

PARAMETERS = {  # shorter than usual, so that a run sees several ends
    "sim_bridge": {"lockstep_timeout": 3.0},
    "episode": {"settle": 0.05, "planning": 5.0, "silence": 2.0},
    "approach": {"first_checks": 5000, "improve_checks": 100, "velocity": 0.6, "acceleration": 0.6},
}
SETTLED = 25.0  # s after the last fault within which an episode must have run to its end: more than the lease of a killed process
PATIENCE = 60.0  # s of an episode
ANSWER = 3.0  # s for a service
PLANNING = 50.0, 1500.0  # ms, in real time: in lockstep it takes no time
_STEP = SECOND // 20  # ns between two looks at whether the run is over


class Run:
    """Plays a plan; folder: for bags."""

    def __init__(self, plan: Plan, folder: Path):
        self.plan, self._folder = plan, folder
        self._lines: list[str] = []
        self.scheduler = Scheduler(plan.seed)
        self.network = Network(self.scheduler, reordered=self.scheduler.rng.choice((0.0, 0.01, 1.0)))
        self.locks, self.disk, self.disturbance = Locks(), Disk(), Disturbance()
        self.processes: dict[str, Process] = {}
        domain = find_domain(plan.domain)
        self.invariants = Invariants(domain, self.scheduler, self.node, self.log)
        # Their modules, too, have to be there before they are given the simulated clock.
        self._classes = {spec.name: node_class(spec) for spec in self._specs()}
        self._classes["sim_bridge"] = bridge_class(self.invariants, self.disturbance)
        self._injection = Injection(self)
        self._kinds = {fault.kind for fault in plan.faults}
        self._has_recovered = False
        self._refusals: dict[str, int] = {}
        self._sent, self._bags = SentMessages(), []

    def log(self, text: str) -> None:
        """A line, with the time since the beginning."""
        self._lines.append(f"{self.seconds:9.4f} s  {text}")

    @property
    def seconds(self) -> float:
        """s since the beginning."""
        return (self.scheduler.now - SECOND) * 1e-9

    def node(self, name: str):
        """The node of this name, None where it does not run."""
        process = self.processes.get(name)
        return process.node if process is not None and process.is_alive else None

    def play(self) -> Report:
        """Run it to its end."""
        began, simulated = time.process_time(), 0.0
        with simulated_host(self.scheduler, self.locks, self.disk):
            self._listen()
            late = {fault.target for fault in self.plan.faults if fault.kind == "late_start"}
            for spec in self._specs():
                if spec.name not in late:
                    self.start(spec.name)
            self._injection.schedule()
            self._go_on(self._operate())
            end = max(self.plan.horizon, self._injection.ends) + SETTLED
            while self.seconds < end and not self._is_over():
                self.scheduler.run_until(self.scheduler.now + _STEP)
            if not (self._has_recovered or self.invariants.violations):
                self.invariants.violate("goes_on", f"no episode ended within {SETTLED:g} s after the last fault")
            simulated = self.invariants.steps * 0.002
            for process in self.processes.values():
                self.note_refusals(process)
                process.stop()
        self._check_bags()
        phases = [str(state) for state in self.invariants.phases]
        used = time.process_time() - began
        return Report(self.plan, self.invariants.violations, phases, self._refusals, simulated, used, self._lines)

    def start(self, name: str) -> None:
        """Start a node of the graph, unless it runs."""
        if self.node(name) is None:
            self.log(f"{name} starts")
            spec = next(spec for spec in self._specs() if spec.name == name)
            self.processes[name] = Process(self.network, spec, self._classes[name], self.log, self._names)

    def note_refusals(self, process: Process) -> None:
        """Keep what a node has counted, before it ends."""
        for key, count in getattr(diagnostics_of(process.node), "counts", {}).items() if process.is_alive else ():
            name = f"{process.spec.name}: {key}"
            self._refusals[name] = self._refusals.get(name, 0) + count

    def ask(self, service: str, then: Callable[[object], None]) -> None:
        """Call a Trigger service; `then` is given the response, None where none comes in time."""
        process, answers = self.processes.get(service.partition("/")[0]), []

        def answered(response: object) -> None:
            if not answers:
                answers.append(response)
                self.log(f"{service}: {response.success}: {response.message}" if response else f"{service}: no answer")
                then(response)

        if process is not None and process.is_alive:
            process.call(service, Trigger.Request(), answered)
        self.scheduler.after(round(ANSWER * SECOND), lambda: answered(None))

    def _specs(self) -> list[NodeSpec]:
        plan = self.plan
        arguments = {"mode": plan.mode, "domain": plan.domain, "keypoints": "truth", "seed": str(plan.seed)}
        if plan.is_recorded:
            arguments |= {"bag": str(self._folder / "bag"), "record_at_start": "false"}
        changed = {**PARAMETERS, "episode": {**PARAMETERS["episode"], "post_timeout": plan.post_timeout}}
        specs = task_graph(arguments)
        return [replace(s, parameters={**s.parameters, **changed.get(s.name, {})}) for s in specs]

    def _names(self) -> list[str]:
        return [name for name in self.processes if self.node(name) is not None]

    def _listen(self) -> None:
        watch, taps = self.invariants, self.network.taps
        taps["/goal_pose"] = [lambda _, data: watch.on_goal(data)]
        taps["/diagnostics"] = [lambda _, data: watch.on_diagnostics(data)]
        taps["/episode/phase"] = [watch.on_phase, self._on_phase]
        self.network.on_unrefused = watch.on_unrefused
        if self.plan.is_recorded:
            taps[""] = [self._sent.note]
        if self.plan.mode == "realtime":
            for topic in ("/joint_trajectory", "/approach/refusal"):
                taps[topic] = [lambda publisher, _: publisher.process.occupy(self.scheduler.draw(*PLANNING))]

    def _on_phase(self, publisher, data: bytes) -> None:
        state = self.invariants.phases[-1]
        is_end = state.phase in ENDS and state.phase != FAULT
        self._has_recovered |= is_end and self.seconds > self._injection.ends

    def _operate(self) -> Generator[float | str, object, None]:
        """Ask for one episode after the other; yields s to wait, or a service whose answer is wanted."""
        yield 0.6
        while True:
            if self.plan.is_recorded and (answer := (yield "recorder/start")) and answer.success:
                self._sent.open()
            if not ((answer := (yield "sim_bridge/reset")) and answer.success):
                self.invariants.recover_asked += 1
                yield "sim_bridge/recover"
                yield 0.2
                continue
            for _ in range(20):
                if not self.invariants.is_acknowledged:
                    yield 0.1
            if not ((answer := (yield "episode/start")) and answer.success):
                yield 0.3
                continue
            began, said = self.seconds, len(self.invariants.phases)
            while self.seconds < began + PATIENCE and self.node("episode") is not None:
                yield 0.05
                if any(state.phase in ENDS for state in self.invariants.phases[said:]):
                    break
            self._sent.is_open = False
            if self.plan.is_recorded and (answer := (yield "recorder/stop")) and answer.success:
                self._check_bag(json.loads(answer.message)["bag"])
            yield 0.1

    def _go_on(self, operator: Generator, answer: object = None) -> None:
        asked = operator.send(answer)
        if isinstance(asked, float):
            self.scheduler.after(round(asked * SECOND), lambda: self._go_on(operator))
        else:
            self.ask(asked, lambda response: self._go_on(operator, response))

    def _check_bag(self, bag: str) -> None:
        self._bags.append(bag)
        # What a delay holds back until the bag is closed is late, and a bag that the disk was too small for ends early.
        if not self._kinds & {"delay", "disk_full", "crash_recorder"} and (missing := self._sent.missing(bag)):
            self.invariants.violate("recording", f"{bag} lacks {missing}")

    def _check_bags(self) -> None:
        if not self._bags:
            return
        if wrong := read_cut_off(Path(self._bags[-1]), self.scheduler.rng):
            self.invariants.violate("recording", wrong)
        if self.plan.mode == "lockstep" and self._kinds <= BENIGN and (first := replay(self._bags[-1], PARAMETERS)):
            self.invariants.violate("replay", first)

    def _is_over(self) -> bool:
        for name, process in self.processes.items():
            if process.died and not (name == "recorder" and "disk_full" in self._kinds):
                self.invariants.violate("alive", f"{name} died: {process.died}")
        return bool(self.invariants.violations) or (self._has_recovered and self.seconds > self.plan.horizon)
