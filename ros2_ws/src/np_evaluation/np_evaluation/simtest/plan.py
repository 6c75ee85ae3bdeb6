"""The plan of a run, drawn from a seed, and the report of its outcome."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_evaluation.simtest.faults import InjectedFault, draw


@dataclass(frozen=True)
class Plan:
    """One run of the graph."""

    seed: int
    """Seed of the tasks and of the network."""
    mode: str
    """`lockstep` or `realtime`."""
    domain: str
    """Task family."""
    is_recorded: bool
    """Whether the recorder runs."""
    horizon: float
    """Latest start of a fault, s; the run continues until the graph has recovered."""
    post_timeout: float
    """Timeout of phase post, s: short for several episodes in a run, or long enough for a success."""
    faults: tuple[InjectedFault, ...]
    """Sorted by time."""
    slowest: float = 0.5
    """Largest delay of a message without faults, ms."""
    reordered: float | None = None
    """Share of the messages that may overtake those of other topics; None: drawn from the seed."""
    delayed: float = 0.001
    """Share of the messages that wait for the processor, for 1 to 10 ms."""
    planning: float = 1500.0
    """Longest time that a plan takes in real time, ms."""

    @classmethod
    def of(cls, seed: int) -> Plan:
        """Draw a plan from a seed; the horizon is shorter in lockstep, where an episode takes little wall time."""
        rng = np.random.default_rng([seed, 1])
        mode, domain = str(rng.choice(("lockstep", "realtime"))), str(rng.choice(("card", "card", "wall", "bump")))
        is_recorded = bool(rng.random() < 0.3)
        horizon = float(rng.uniform(1.5, 2.5) if mode == "lockstep" else rng.uniform(2.0, 3.5))
        post_timeout = 6.0 if rng.random() < 0.1 else 0.6
        return cls(seed, mode, domain, is_recorded, horizon, post_timeout, tuple(draw(rng, horizon, is_recorded)))


@dataclass(frozen=True)
class Report:
    """The outcome of a run."""

    plan: Plan
    violations: dict[str, str]
    """The first violation of each guarantee (`np_evaluation.simtest.invariants.GUARANTEES`)."""
    phases: list[str]
    """Every phase that `episode` published."""
    refusals: dict[str, int]
    """Counts by node and reason, as `node: reason`."""
    simulated: float
    """Simulated time of the arm, s."""
    period: float
    """Median time between steps of the arm by the clock of the run, ms."""
    processor: float
    """Processor time, s."""
    log: list[str]
    """One line per event, with its time."""

    def summarize(self) -> dict[str, object]:
        """Summarize the report for JSON."""
        return {
            "seed": self.plan.seed,
            "mode": self.plan.mode,
            "domain": self.plan.domain,
            "faults": [str(fault) for fault in self.plan.faults],
            "violations": self.violations,
            "phases": self.phases,
            "refusals": self.refusals,
            "simulated_s": round(self.simulated, 3),
            "processor_s": round(self.processor, 2),
        }
