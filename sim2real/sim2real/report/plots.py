"""The plots of the report, as SVG text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from np_common.html_pages import style, svg
from sim2real.diagnosis import Diagnosis
from sim2real.effects.joint_dynamics.friction_curve import EFFECT as CURVE
from sim2real.effects.joint_dynamics.friction_curve import SPEEDS, WAYS, value_name
from sim2real.effects.stage import Stage
from sim2real.finding import Finding
from sim2real.recordings.loop_timing import LOCKSTEP, LOOP, LoopTiming
from sim2real.recordings.signals import DECIMATION, GRID

WIDTH = 9.6
RATE = 1 / (GRID * DECIMATION)  # samples a second
PLACES = {
    "left": 0.09,
    "right": 0.99,
    "bottom": 0.11,
    "top": 0.94,
    "wspace": 0.38,
    "hspace": 0.45,
}  # of panels, as shares
BEFORE, AFTER, FLOOR, BACKWARDS = "#b0b7c3", "#1f5fa8", "#2f8f3a", "#c46a12"


def gap_plot(diagnosis: Diagnosis) -> str:
    """Held-out gap of each joint before and after, with its floor."""
    gap, joints = diagnosis.gap, diagnosis.context.arm.joints
    with style():
        figure = Figure(figsize=(WIDTH, 2.6), layout="constrained")
        axes = figure.add_subplot()
        place = np.arange(len(joints))
        axes.bar(place - 0.2, gap.before_joint, 0.4, color=BEFORE, label=_baseline_label(diagnosis))
        axes.bar(place + 0.2, gap.after_joint, 0.4, color=AFTER, label="effects added")
        axes.hlines(gap.floor_joint, place - 0.45, place + 0.45, color=FLOOR, lw=2, label="floor")
        axes.set_xticks(place, joints, fontsize=8)
        axes.set_ylabel("torque gap (Nm)")
        axes.grid(False, axis="x")
        figure.legend(fontsize=8, loc="outside upper right", ncols=3, frameon=False)
        return svg(figure)


def _baseline_label(diagnosis: Diagnosis) -> str:
    return "as it was before" if diagnosis.context.reference else "nominal simulator"


def friction_plot(diagnosis: Diagnosis, findings: Sequence[Finding]) -> str:
    """Friction over speed of the joints that have a curve of their own, with 95 % intervals; "" where none has.

    Against earlier recordings it is the change: the friction that the arm had then is not known.
    """
    arm, curves = diagnosis.context.arm, {f.component: f.parameters for f in findings if f.effect.id == CURVE.id}
    if not curves:
        return ""
    speeds, is_change = np.array(SPEEDS), bool(diagnosis.context.reference)
    rows = -(-len(curves) // 4)
    with style():
        figure = Figure(figsize=(WIDTH, 0.5 + 1.9 * rows), layout="constrained")
        panels = figure.subplots(rows, 4, sharex=True, squeeze=False).ravel()
        for axes, joint in zip(panels, [name for name in arm.joints if name in curves]):
            j = arm.joints.index(joint)
            nominal = 0.0 * speeds if is_change else arm.frictionloss[j] + arm.damping[j] * speeds
            axes.plot(speeds, nominal, color=BEFORE, label=_baseline_label(diagnosis))
            for way, colour, text in zip(WAYS, (AFTER, BACKWARDS), ("forwards", "backwards")):
                values = [curves[joint][value_name(way, speed)] for speed in SPEEDS]
                value, low, high = (np.array([getattr(v, end) for v in values]) for end in ("value", "low", "high"))
                spread = np.abs([value - low, high - value])
                axes.errorbar(speeds, nominal + value, spread, color=colour, ms=3, marker="o", capsize=2, label=text)
            axes.set_xscale("log")
            axes.set_xticks((0.03, 0.1, 0.3, 0.8), ("0.03", "0.1", "0.3", "0.8"), minor=False)
            axes.minorticks_off()
            axes.set_title(joint, fontsize=8)
            axes.set_ylim(bottom=None if is_change else 0.0)
        for axes in panels[len(curves) :]:
            axes.axis("off")
        for axes in panels[::4]:
            axes.set_ylabel("change of friction (Nm)" if is_change else "friction (Nm)")
        figure.supxlabel("speed (rad/s)", fontsize=8)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, fontsize=8, loc="outside upper right", ncols=3, frameon=False)
        return svg(figure)


def loop_plot(timing: LoopTiming, duration: float) -> str:
    """Losses and gaps of the stamps over the s of one recording; "" where nothing was counted and no stamp is late."""
    counted = timing.lost[timing.lost[:, 1] > 0]
    if timing.status == LOCKSTEP or not (len(timing.lost) or len(timing.state_gaps) or len(timing.command_gaps)):
        return ""
    with style():
        figure = Figure(figsize=(WIDTH, 2.8), layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True)
        if len(timing.lost):
            upper.bar(counted[:, 0] - 1.0, counted[:, 1], 1.0, color=AFTER)  # reported up to two seconds later
            upper.set_ylim(0.0, max(1.0, 1.1 * timing.lost[:, 1].max()))
        else:
            upper.text(0.5, 0.5, "not recorded", transform=upper.transAxes, ha="center", va="center", color=BEFORE)
            upper.set_yticks([])
        upper.set_ylabel("lost")
        for gaps, colour, mark, text in (
            (timing.command_gaps, BACKWARDS, "x", "effort_command"),
            (timing.state_gaps, AFTER, "o", "joint_states"),
        ):
            lower.plot(gaps[:, 0], gaps[:, 1], mark, color=colour, ms=4, label=text, clip_on=False)
        longest = max([*timing.state_gaps[:, 1], *timing.command_gaps[:, 1], 4.0])
        lower.set_ylim(0.0, 1.1 * longest)
        limit = 1e3 * LOOP.in_a_row * LOOP.cycle
        if timing.lost_cycles is not None and longest > limit / 2:
            lower.axhline(limit, color="#b02020", lw=1, ls="--", label="the robot ends the motion")
        lower.set_ylabel("gap (ms)")
        lower.set_xlim(0.0, duration)
        lower.set_xlabel("time (s)")
        figure.legend(*lower.get_legend_handles_labels(), fontsize=8, loc="outside upper right", ncols=3, frameon=False)
        return svg(figure)


def residual_plot(diagnosis: Diagnosis) -> str:
    """Residual torque over time, before and held out after."""
    return _residual_grid(diagnosis, True, "sample time (s)", "-", 0.7)


def velocity_plot(diagnosis: Diagnosis) -> str:
    """Residual torque over velocity: what friction looks like."""
    return _residual_grid(diagnosis, False, "velocity (rad/s)", ".", 1.0)


def _residual_grid(diagnosis: Diagnosis, over_time: bool, label: str, mark: str, size: float) -> str:
    samples = diagnosis.context.samples
    with style():
        figure = Figure(figsize=(WIDTH, 4.4), dpi=200)
        columns = (len(diagnosis.context.arm) + 2) // 2
        panels = figure.subplots(2, columns, gridspec_kw=PLACES).ravel()
        stride = max(1, len(samples) // 1500)
        for n, cell in enumerate(diagnosis.design.cells):
            if cell.stage is not Stage.DYNAMICS or cell.at_reversal:
                continue
            axes = panels[cell.joint]
            x = np.arange(len(samples)) / RATE if over_time else samples.velocity[:, cell.joint]
            for values, colour in ((diagnosis.gap.nominal[n], BEFORE), (diagnosis.gap.residuals[n], AFTER)):
                shown = np.where(cell.rows, values, np.nan)
                # As an image: thousands of marks are slow to write, and to show.
                axes.plot(x[::stride], shown[::stride], mark, color=colour, lw=size, ms=size, rasterized=True)
            axes.set_title(diagnosis.context.arm.joints[cell.joint], fontsize=8)
            axes.set_xlabel(label, fontsize=8)
        panels[0].set_ylabel("residual (Nm)")
        panels[columns].set_ylabel("residual (Nm)")
        for axes in panels[len(diagnosis.context.arm) :]:
            axes.axis("off")
        for text, colour, height in (
            (_baseline_label(diagnosis), BEFORE, 0.6),
            ("effects added, held out", AFTER, 0.4),
        ):
            panels[-1].text(0.1, height, text, color=colour, weight="bold", transform=panels[-1].transAxes)
        return svg(figure)
