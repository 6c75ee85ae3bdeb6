"""What a run consists of, as a seed draws it, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_evaluation.simtest.faults import InjectedFault, draw


@dataclass(frozen=True)
class Plan:
    """One run of the graph."""

    seed: int
    """Of the tasks and of the network."""
    mode: str
    """lockstep or realtime."""
    domain: str
    """Task family."""
    is_recorded: bool
    """Whether a recorder runs."""
    horizon: float
    """s up to which faults begin; the run goes on until the graph has recovered."""
    post_timeout: float
    """s of phase post: short, so that a run sees several ends, or long enough for a success."""
    faults: tuple[InjectedFault, ...]
    """In the order of their time."""
    slowest: float = 0.5
    """ms that a message takes at most where nothing is wrong."""
    reordered: float | None = None
    """Share of the messages that may overtake those of other topics; None: as the seed draws it."""

    @classmethod
    def of(cls, seed: int) -> Plan:
        """The plan that a seed draws. In lockstep an episode takes little wall time, so that a run is shorter."""
        rng = np.random.default_rng([seed, 1])
        mode, domain = str(rng.choice(("lockstep", "realtime"))), str(rng.choice(("card", "card", "wall", "bump")))
        is_recorded = bool(rng.random() < 0.3)
        horizon = float(rng.uniform(1.5, 2.5) if mode == "lockstep" else rng.uniform(2.0, 3.5))
        post_timeout = 6.0 if rng.random() < 0.1 else 0.6
        return cls(seed, mode, domain, is_recorded, horizon, post_timeout, tuple(draw(rng, horizon, is_recorded)))


@dataclass(frozen=True)
class Report:
    """What a run came to."""

    plan: Plan
    violations: dict[str, str]
    """What was seen, by the promise that it breaks (`np_evaluation.simtest.invariants.PROMISED`)."""
    phases: list[str]
    """Every phase that `episode` said."""
    refusals: dict[str, int]
    """How often each node counted each reason."""
    simulated: float
    """s of the arm's time."""
    period: float
    """ms from one step of the arm to the next, by the clock of the run."""
    processor: float
    """s of processor time."""
    log: list[str]
    """A line for each thing that happened, with its time."""

    def figures(self) -> dict[str, object]:
        """What is kept of it as JSON."""
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
