"""`control_loop` of report.json: the timing of each recording's control loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from sim2real.checks.control_loop import LoopTiming, explain_effect
from sim2real.finding import Finding
from sim2real.recordings.signals import Log


def describe_loops(logs: Sequence[Log], loops: Sequence[LoopTiming], findings: Sequence[Finding]) -> list[dict]:
    """One object a recording; numbers that were not recorded are None."""
    return [
        {
            "bag": log.name,
            "status": timing.status,
            "reason": timing.reason,
            "faults": [asdict(fault) for fault in timing.faults],
            "lost_cycles": timing.lost_cycles,
            "lost_in_a_row": timing.in_a_row,
            "success_rate": timing.success_rate,
            "late_share": timing.late_share,
            "answer_ms": timing.answer_ms and list(timing.answer_ms),
            "effects": _explained(timing, findings),
        }
        for log, timing in zip(logs, loops)
    ]


def _explained(timing: LoopTiming, findings: Sequence[Finding]) -> list[str]:
    values = [(f.effect.id, e.value) for f in findings if f.is_chosen for e in f.parameters.values()]
    return [text for effect, value in values if (text := explain_effect(timing, effect, value))]
