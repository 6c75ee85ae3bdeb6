"""One run: the card graph under faults, with an operator who keeps asking for episodes."""

from __future__ import annotations

import json
import time
from collections.abc import Generator
from pathlib import Path

from np_description.phases import ENDS, FAULT
from np_evaluation.simtest.graph import PARAMETERS, SimulatedGraph
from np_evaluation.simtest.injection import Injection
from np_evaluation.simtest.plan import Plan, Report
from np_evaluation.simtest.recordings import BENIGN, SentMessages, read_cut_off, replay
from np_evaluation.simtest.scheduler import SECOND, simulate_host

PATIENCE = 60.0  # s of an episode
CLOSING = 2.0  # s in which a recorder closes its bag
PLANNING = 50.0, 1500.0  # ms, in real time: in lockstep it takes no time
_STEP = SECOND // 20  # ns between two looks at whether the run is over


class Run(SimulatedGraph):
    """Plays a plan."""

    settled = 25.0
    """s after the last fault within which an episode must have run to its end: more than the lease of a killed process."""

    def __init__(self, plan: Plan, folder: Path):
        super().__init__(plan, folder)
        self._injection = Injection(self)
        self._kinds = {fault.kind for fault in plan.faults}
        self._recovered: float | None = None  # s at which an episode has ended after the last fault
        self._sent, self._bags = SentMessages(), []

    def play(self) -> Report:
        """Run it to its end."""
        began = time.process_time()
        with simulate_host(self.scheduler, self.locks, self.disk):
            self._listen()
            self._start_first()
            self._operate_under_faults()
            self._end_all()
        self._check_bags()
        return self._report(time.process_time() - began)

    def _start_first(self) -> None:
        late = {fault.target for fault in self.plan.faults if fault.kind == "late_start"}
        for spec in self.specs():
            if spec.name not in late:
                self.start(spec.name)

    def _operate_under_faults(self) -> None:
        self._injection.schedule()
        self._go_on(self._operate())
        end = max(self.plan.horizon, self._injection.ends) + self.settled
        while self.seconds < end and not self._is_over():
            self._pass_time()
        if self._recovered is None and not self.invariants.violations:
            self.invariants.violate("goes_on", f"no episode ended within {self.settled:g} s after the last fault")

    def _pass_time(self) -> None:
        self.scheduler.run_until(self.scheduler.now + _STEP)

    def _end_all(self) -> None:
        self._simulated = self.invariants.steps * 0.002
        for name in self.processes:
            self.end(name, killed=False)

    def _report(self, processor: float) -> Report:
        watch = self.invariants
        phases = [str(state) for state in watch.phases]
        return Report(
            self.plan,
            watch.violations,
            phases,
            self.refusals,
            self._simulated,
            watch.period,
            processor,
            self.lines,
        )

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
        if self._recovered is None and is_end and self._is_quiet():
            self._recovered = self.seconds

    def _is_quiet(self) -> bool:
        """Whether the last fault is over."""
        return self.seconds > self._injection.ends

    def _operate(self) -> Generator[float | str, object, None]:
        """Ask for one episode after the other; yields s to wait, or a service whose answer is wanted."""
        yield 0.6
        while True:
            if self.plan.is_recorded and (answer := (yield "recorder/start")) and answer.success:
                self._sent.open(answer.message)
            if not ((answer := (yield "sim_bridge/reset")) and answer.success):
                self.invariants.recover_asked += 1
                yield "sim_bridge/recover"
                yield 0.2
                continue
            for _ in range(20):
                if not self.invariants.is_acknowledged:
                    yield 0.1
            began, said = self.seconds, len(self.invariants.phases)
            if not ((answer := (yield "episode/start")) and answer.success):
                yield 0.3
                continue
            while self.seconds < began + PATIENCE and self.node("episode") is not None:
                yield 0.05
                if any(state.phase in ENDS for state in self.invariants.phases[said:]):
                    break
            self._sent.is_open = False
            if self.plan.is_recorded and (answer := (yield "recorder/stop")) and answer.success:
                self._check_bag(**json.loads(answer.message))
            yield 0.1

    def _go_on(self, operator: Generator, answer: object = None) -> None:
        asked = operator.send(answer)
        if isinstance(asked, float):
            self.scheduler.after(round(asked * SECOND), lambda: self._go_on(operator))
        else:
            self.ask(asked, lambda response: self._go_on(operator, response))

    def _check_bag(self, bag: str, lost: int, **_) -> None:
        self._bags.append(bag)
        # What is lost is counted; what a delay holds back is late, and a bag that the disk was too small for ends early.
        is_whole = not lost and not self._kinds & {"delay", "disk_full", "crash_recorder"}
        if is_whole and (missing := self._sent.missing(bag)):
            self.invariants.violate("recording", f"{Path(bag).name} lacks {missing}")

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
        if self._recovered is None:
            return bool(self.invariants.violations)
        is_recorded = not self.plan.is_recorded or self.seconds > self._recovered + CLOSING
        return bool(self.invariants.violations) or (is_recorded and self.seconds > self.plan.horizon)
