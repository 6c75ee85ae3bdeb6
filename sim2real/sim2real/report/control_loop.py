"""`control_loop` of report.json: the timing of each recording's control loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from sim2real.finding import Finding
from sim2real.recordings.loop_timing import LoopTiming, explain_effect
from sim2real.recordings.signals import Log


def describe_loops(logs: Sequence[Log], findings: Sequence[Finding] = ()) -> list[dict]:
    """One object a recording; numbers that were not recorded are None. findings: of the arm, which the timing may explain."""
    return [
        {
            "bag": log.name,
            "status": log.loop.status,
            "reason": log.loop.reason,
            "faults": [asdict(fault) for fault in log.loop.faults],
            "lost_cycles": log.loop.lost_cycles,
            "lost_in_a_row": log.loop.in_a_row,
            "success_rate": log.loop.success_rate,
            "late_share": log.loop.late_share,
            "answer_ms": log.loop.answer_ms and list(log.loop.answer_ms),
            "effects": _explained(log.loop, findings),
        }
        for log in logs
    ]


def describe_broken_loops(logs: Sequence[Log]) -> list[str]:
    """For the headline: one text for each recording in which the loop broke."""
    return [log.loop.broken_sentence for log in logs if log.loop.broken_sentence]


def _explained(timing: LoopTiming, findings: Sequence[Finding]) -> list[str]:
    values = [(f.effect.id, e.value) for f in findings if f.is_chosen for e in f.parameters.values()]
    return [text for effect, value in values if (text := explain_effect(timing, effect, value))]
