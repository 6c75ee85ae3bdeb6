"""report.html: where, which and how far on one screen, the evidence below."""

from __future__ import annotations

from pathlib import Path

from np_common.html_pages import page
from sim2real.checks.shrinkage import REGIMES
from sim2real.diagnosis import Diagnosis
from sim2real.report import plots
from sim2real.report.next_steps import suggest_next_steps


def render(report: dict, diagnosis: Diagnosis, folder: Path = Path("runs/report")) -> str:
    """The page as text, with its pictures in it. folder: where the report is written."""
    findings = diagnosis.findings if report["verdict"] != "no_gap" else ()
    added = [f for f in findings if f.is_chosen]
    listed = {(name, f.component) for f in added for name in f.generalised_by}  # by the number beside what is added
    logs = diagnosis.context.logs[diagnosis.context.reference :]
    return page(
        "sim2real",
        report=report,
        blocks=len(diagnosis.design.blocks),
        added=added,
        leads=[f for f in findings if not f.is_chosen and (f.effect.id, f.component) not in listed],
        regimes=REGIMES,
        steps=suggest_next_steps(diagnosis, folder),
        loop_plots=[plots.loop_plot(log.loop, log.duration) for log in logs],
        gap_plot=plots.gap_plot(diagnosis),
        residual_plot=plots.residual_plot(diagnosis),
        friction_plot=plots.friction_plot(diagnosis, added),
        velocity_plot=plots.velocity_plot(diagnosis),
    )
