"""One run: the card graph under faults, with a simulated operator who starts one episode after another."""

from __future__ import annotations

import json
import time
from collections.abc import Generator
from pathlib import Path

from np_description.phases import ENDS, FAULT
from np_evaluation.simtest.graph import PARAMETERS, SimulatedGraph
from np_evaluation.simtest.injection import Injection
from np_evaluation.simtest.plan import Plan, Report
from np_evaluation.simtest.recordings import BENIGN, SentMessages, check_truncated, replay
from np_evaluation.simtest.scheduler import SECOND, simulate_host

EPISODE_TIMEOUT = 60.0  # s until an episode must end
CLOSE_TIME = 2.0  # s for the recorder to close its bag
SHORTEST_PLANNING = 50.0  # ms, in real time; in lockstep planning takes no time
_STEP = SECOND // 20  # ns between two checks whether the run is over


class Run(SimulatedGraph):
    """Runs a plan."""

    recovery_timeout = 25.0
    """Time after the last fault within which an episode must end, s; longer than the lease of a killed process."""

    def __init__(self, plan: Plan, folder: Path):
        super().__init__(plan, folder)
        self._injection = Injection(self)
        self._kinds = {fault.kind for fault in plan.faults}
        self._recovered: float | None = None  # s at which the first episode after the last fault ended
        self._sent, self._bags = SentMessages(), []

    def play(self) -> Report:
        """Run the plan to its end."""
        began = time.process_time()
        with simulate_host(self.scheduler, self.locks, self.disk):
            self._subscribe()
            self._start_first()
            self._operate_under_faults()
            self._end_all()
        self._check_bags()
        return self._report(time.process_time() - began)

    def _start_first(self) -> None:
        late = {fault.target for fault in self.plan.faults if fault.kind == "late_start"}
        for spec in self.make_specs():
            if spec.name not in late:
                self.start(spec.name)

    def _operate_under_faults(self) -> None:
        self._injection.schedule()
        self._resume(self._operate())
        end = max(self.plan.horizon, self._injection.ends) + self.recovery_timeout
        while self.seconds < end and not self._is_over():
            self._pass_time()
        if self._recovered is None and not self.invariants.violations:
            self.invariants.violate(
                "goes_on", f"no episode ended within {self.recovery_timeout:g} s after the last fault"
            )

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

    def _subscribe(self) -> None:
        watch, taps = self.invariants, self.network.taps
        taps["/goal_pose"] = [lambda _, data: watch.on_goal(data)]
        taps["/diagnostics"] = [lambda _, data: watch.on_diagnostics(data)]
        taps["/episode/phase"] = [watch.on_phase, self._on_phase]
        self.network.on_accepted_invalid = watch.on_accepted_invalid
        if self.plan.is_recorded:
            taps[""] = [self._sent.on_sent]
        if self.plan.mode == "realtime":
            planning = SHORTEST_PLANNING, self.plan.planning
            for topic in ("/joint_trajectory", "/approach/refusal"):
                taps[topic] = [lambda publisher, _: publisher.process.occupy(self.scheduler.draw_time(*planning))]

    def _on_phase(self, publisher, data: bytes) -> None:
        state = self.invariants.phases[-1]
        is_end = state.phase in ENDS and state.phase != FAULT
        if self._recovered is None and is_end and self._are_faults_over():
            self._recovered = self.seconds

    def _are_faults_over(self) -> bool:
        """Whether the last fault is over."""
        return self.seconds > self._injection.ends

    def _operate(self) -> Generator[float | str, object, None]:
        """Run one episode after another; yields s to wait, or a service to call, and receives the response."""
        yield 0.6
        while True:
            if self.plan.is_recorded and (response := (yield "recorder/start")) and response.success:
                self._sent.open(response.message)
            if not ((response := (yield "sim_bridge/reset")) and response.success):
                self.invariants.recover_requests += 1
                yield "sim_bridge/recover"
                yield 0.2
                continue
            for _ in range(20):
                if not self.invariants.is_acknowledged:
                    yield 0.1
            began, phases_before = self.seconds, len(self.invariants.phases)
            if not ((response := (yield "episode/start")) and response.success):
                yield 0.3
                continue
            while self.seconds < began + EPISODE_TIMEOUT and self.find_node("episode") is not None:
                yield 0.05
                if any(state.phase in ENDS for state in self.invariants.phases[phases_before:]):
                    break
            self._sent.is_open = False
            if self.plan.is_recorded and (response := (yield "recorder/stop")) and response.success:
                self._check_bag(**json.loads(response.message))
            yield 0.1

    def _resume(self, operator: Generator, response: object = None) -> None:
        request = operator.send(response)
        if isinstance(request, float):
            self.scheduler.call_after(round(request * SECOND), lambda: self._resume(operator))
        else:
            self.call(request, lambda response: self._resume(operator, response))

    def _check_bag(self, bag: str, lost: int, **_) -> None:
        self._bags.append(bag)
        # Lost messages are counted, delayed ones may come too late, and a bag on a full disk ends early.
        is_whole = not lost and not self._kinds & {"delay", "disk_full", "crash_recorder"}
        if is_whole and (missing := self._sent.find_missing(bag)):
            self.invariants.violate("recording", f"{Path(bag).name} lacks {missing}")

    def _check_bags(self) -> None:
        if not self._bags:
            return
        if wrong := check_truncated(Path(self._bags[-1]), self.scheduler.rng):
            self.invariants.violate("recording", wrong)
        if self.plan.mode == "lockstep" and self._kinds <= BENIGN and (first := replay(self._bags[-1], PARAMETERS)):
            self.invariants.violate("replay", first)

    def _is_over(self) -> bool:
        for name, process in self.processes.items():
            if process.died and not (name == "recorder" and "disk_full" in self._kinds):
                self.invariants.violate("alive", f"{name} died: {process.died}")
        if self._recovered is None:
            return bool(self.invariants.violations)
        is_recorded = not self.plan.is_recorded or self.seconds > self._recovered + CLOSE_TIME
        return bool(self.invariants.violations) or (is_recorded and self.seconds > self.plan.horizon)
