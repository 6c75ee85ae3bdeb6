"""report.html: where, which and how far on one screen, the evidence below."""

from __future__ import annotations

from np_diagnosis.checks.shrinkage import REGIMES
from np_diagnosis.diagnosis import Diagnosis
from np_diagnosis.report import plots
from np_record.report.pages import page


def render(report: dict, diagnosis: Diagnosis) -> str:
    """The page as text, with its pictures in it."""
    return page(
        "np_diagnosis",
        report=report,
        blocks=len(diagnosis.design.blocks),
        findings=diagnosis.findings if report["verdict"] != "no_gap" else (),
        regimes=REGIMES,
        gap_plot=plots.gap_plot(diagnosis),
        residual_plot=plots.residual_plot(diagnosis),
        velocity_plot=plots.velocity_plot(diagnosis),
    )
