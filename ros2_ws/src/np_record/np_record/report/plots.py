"""The plots of an episode's report, as SVG text."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from np_common.html_pages import style, svg
from np_description.force_reflex import COUNTED_FORCES, FORCE_REFLEX
from np_description.keypoints import box_keypoints
from np_description.panda import NOMINAL
from np_description.phases import APPROACH, FAILED, FAULT, IDLE, POST, PRE, SUCCEEDED
from np_record.recorded_episode import EpisodeData, Series

WIDTH = 9.6
PHASE_COLOURS = {
    IDLE: "#eeeeee",
    PRE: "#dfe7f5",
    APPROACH: "#fdf0d5",
    POST: "#e3f1e1",
    SUCCEEDED: "#b7e1b0",
    FAILED: "#f3c6c6",
    FAULT: "#e9a3a3",
}


def plot_progress(episode: EpisodeData) -> str:
    """Distance and angle to the goal over time, with the tolerances."""
    with style():
        figure, (top, bottom) = _figure(2, 3.6, episode)
        _line(top, episode.distance, 100, "#1f5fa8")
        _tolerance(top, 100 * episode.domain.tolerance_position, "cm")
        top.set_ylabel("distance (cm)")
        _line(bottom, episode.angle, 180 / np.pi, "#a8461f")
        if episode.domain.tolerance_angle is not None:
            _tolerance(bottom, np.degrees(episode.domain.tolerance_angle), "deg")
        bottom.set_ylabel("angle (deg)")
        for axes in (top, bottom):
            axes.set_ylim(bottom=0)
        return svg(figure)


def plot_torque(episode: EpisodeData) -> str:
    """Commanded torque of each joint as a share of its limit."""
    return _plot_joints(
        episode, episode.command.time, 100 * episode.command.values / NOMINAL.torque_limit, "torque (% of limit)", True
    )


def plot_tracking(episode: EpisodeData) -> str:
    """Difference of each joint from its target."""
    common, i, j = np.intersect1d(episode.position.time, episode.target.time, return_indices=True)
    error = np.degrees(episode.target.values[j] - episode.position.values[i])
    return _plot_joints(episode, common, error, "target - measured (deg)")


def plot_speed(episode: EpisodeData) -> str:
    """Speed of each joint as a share of its limit, at which the robot's reflex stops it."""
    shares = 100 * episode.velocity.values / NOMINAL.velocity_limit
    return _plot_joints(episode, episode.velocity.time, shares, "speed (% of limit)", True)


def _plot_joints(episode: EpisodeData, time: np.ndarray, values: np.ndarray, label: str, is_share: bool = False) -> str:
    """Values (n, 7) of the joints; is_share: in % of limits, which are drawn."""
    with style():
        figure, (axes,) = _figure(1, 2.6, episode)
        for joint, column in enumerate(values.T):
            axes.plot(time, column, lw=0.8, label=f"joint {joint + 1}")
        if is_share:
            for limit in (-100, 100):
                axes.axhline(limit, color="#b02020", lw=1)
            axes.set_ylim(-115, 115)
        axes.set_ylabel(label)
        figure.legend(fontsize=7, loc="outside right center", frameon=False)
        return svg(figure)


def plot_force(episode: EpisodeData) -> str:
    """Filtered external force and moment at the hand against the reflex's thresholds, and the stricter force that is counted too."""
    with style():
        figure, (top, bottom) = _figure(2, 3.6, episode)
        force, moment = episode.wrench.values[:, :3], episode.wrench.values[:, 3:]
        stop, strict = COUNTED_FORCES
        for axes, values, label, threshold in (
            (top, force, "force (N)", stop),
            (bottom, moment, "moment (Nm)", FORCE_REFLEX.moment),
        ):
            size = np.linalg.norm(values, axis=1)
            axes.plot(episode.wrench.time, size, color="#1f5fa8", lw=1)
            axes.axhline(threshold, color="#b03030", lw=1, ls="--", label=f"the arm stops above {threshold:g}")
            axes.set_ylabel(label)
            axes.set_ylim(0, 1.25 * max(threshold, size.max(initial=0.0)))
        top.axhline(strict, color="#c98a1b", lw=1, ls=":", label=f"stricter threshold, {strict:g}")
        for axes in (top, bottom):
            axes.legend(fontsize=7, frameon=False, loc="upper left", ncols=2)
        return svg(figure)


def plot_depth(episode: EpisodeData) -> str:
    """How deep shapes are in each other: what a real robot could not do."""
    with style():
        figure, (axes,) = _figure(1, 2.4, episode)
        for pair, depth in episode.depths.items():
            axes.plot(depth.time, 1e3 * depth.values, lw=0.9, label=pair.replace("-", " in "))
        axes.set_ylabel("depth (mm)")
        axes.set_ylim(bottom=0)
        if episode.depths:
            figure.legend(fontsize=7, loc="outside right center", frameon=False)
        return svg(figure)


def plot_keypoints(episode: EpisodeData) -> str:
    """Detected keypoints against the projected truth, and their scores."""
    with style():
        figure, (top, bottom) = _figure(2, 3.2, episode)
        if len(episode.keypoint_error):
            error = Series(episode.keypoint_error.time, np.median(episode.keypoint_error.values, axis=1))
            worst = episode.keypoint_error.values.max(axis=1)
            top.fill_between(error.time, 0, worst, color="#7a4fa3", alpha=0.25, lw=0, label="worst of 8")
            _line(top, error, 1, "#7a4fa3", label="median of 8")
            top.legend(fontsize=7, frameon=False, loc="upper left")
            bottom.plot(episode.keypoints.time, episode.keypoints.values[:, :, 2].min(axis=1), lw=1, color="#444444")
        top.set_ylabel("error (px)")
        top.set_ylim(0, max(5.0, min(40.0, top.get_ylim()[1])))
        bottom.set_ylabel("least score")
        bottom.set_ylim(0, 1.05)
        return svg(figure)


def plot_path(episode: EpisodeData) -> str:
    """The object from above: start, path and goal; x points up, as the robot sees it."""
    with style():
        figure = Figure(figsize=(3.6, 3.6), layout="constrained")
        axes = figure.add_subplot()
        positions, quaternions = episode.object_position.values, episode.object_quaternion.values
        axes.plot(positions[:, 1], positions[:, 0], color="#1f5fa8", lw=1)
        half = np.asarray(episode.domain.half_size)
        shapes = [
            (positions[0], quaternions[0], "#888888", "start"),
            (positions[-1], quaternions[-1], "#1f5fa8", "end"),
            (episode.goal.position, episode.goal.quaternion, "#2f8f3a", "goal"),
        ]
        for position, quaternion, colour, label in shapes:
            corners = box_keypoints(half, position, quaternion)[:, :2]
            hull = corners[_convex_order(corners)]
            closed = np.vstack([hull, hull[:1]])
            line = "--" if label == "goal" else "-"
            axes.plot(closed[:, 1], closed[:, 0], color=colour, lw=1.5, label=label, ls=line)
        axes.set_aspect("equal", adjustable="datalim")
        axes.invert_xaxis()
        axes.set_xlabel("y (m)")
        axes.set_ylabel("x (m)")
        axes.legend(fontsize=7, frameon=False)
        return svg(figure)


def _figure(rows: int, height: float, episode: EpisodeData):
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    panels = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    ends = [*(begin for begin, _ in episode.phases[1:]), episode.duration]
    for axes in panels:
        for (begin, state), end in zip(episode.phases, ends):
            colour = PHASE_COLOURS.get(state.phase, "#ffffff")
            axes.axvspan(begin, max(end, begin + 0.01), color=colour, lw=0, zorder=-1)
        axes.set_xlim(0, max(episode.duration, 0.01))
    for (begin, state), end in zip(episode.phases, ends):
        if end - begin > 0.03 * episode.duration:
            text = {"ha": "center", "va": "bottom", "fontsize": 8, "color": "#555555"}
            panels[0].text((begin + end) / 2, 1.01, state.phase, transform=panels[0].get_xaxis_transform(), **text)
    panels[-1].set_xlabel("simulated time (s)")
    return figure, panels


def _line(axes, series: Series, factor: float, colour: str, **options) -> None:
    axes.plot(series.time, factor * series.values, color=colour, lw=1.4, **options)


def _tolerance(axes, value: float, unit: str) -> None:
    axes.axhline(value, color="#2f8f3a", ls="--", lw=1, label=f"tolerance, {value:.2g} {unit}")
    axes.legend(fontsize=7, frameon=False, loc="upper right")


def _convex_order(points: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.convexHull(points.astype(np.float32), returnPoints=False)[:, 0]
