"""A small picture of each module of the task diagnosis: what its row rests on."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from np_common.html_pages import style, svg
from np_description.camera import CAMERA, Camera
from np_description.domains import Pose, Task
from np_perception.pose_estimation import PoseError, estimate_pose, project_keypoints
from sim2real.effects.sentences import ValueWithInterval
from sim2real.recordings.reading import ContractViolation
from sim2real.task.camera.fit import evaluate_at
from sim2real.task.camera.parameters import COUNT
from sim2real.task.contact_force.fit import GRAVITY, NominalContact
from sim2real.task.diagnosis import TaskDiagnosis
from sim2real.task.keypoint_track import find_rests
from sim2real.task.suite.object_pose import pose_at_start

BLUE, GREY, RED, DARK = "#1f5fa8", "#b0b7c3", "#c0392b", "#222"
SIZE = 2.9, 1.12  # inches


def pictures(diagnosis: TaskDiagnosis, camera: Camera = CAMERA) -> dict[str, str]:
    """By module, its picture as SVG text, "" where there is nothing to draw."""
    plots = {
        "camera": lambda axes: _plot_corners(axes, diagnosis, camera),
        "keypoints": lambda axes: _plot_scatter(axes, diagnosis),
        "timing": lambda axes: _plot_latency(axes, diagnosis),
        "contact": lambda axes: _plot_friction_cone(axes, diagnosis),
        "object": lambda axes: _plot_path(axes, diagnosis, camera),
        "table": lambda axes: _plot_touches(axes, diagnosis),
    }
    return {module: _draw(draw) for module, draw in plots.items()}


def _draw(draw: Callable[[Axes], bool]) -> str:
    with style():
        figure = Figure(figsize=SIZE, layout="constrained")
        axes = figure.subplots()
        axes.tick_params(labelsize=6, length=2, pad=1)
        axes.xaxis.label.set_size(7)
        axes.yaxis.label.set_size(7)
        return svg(figure) if draw(axes) else ""


def _plot_corners(axes: Axes, diagnosis: TaskDiagnosis, camera: Camera) -> bool:
    """Corners as they are seen (dots) and predicted (crosses) at the place at which they are farthest off; where the hand met them, if that
    is elsewhere."""
    view, offset = diagnosis.camera, diagnosis.hand_eye.comparison if diagnosis.hand_eye else None
    sizes = offset.findings[0].hypotheses[0].estimates if offset is not None and offset.findings else {}
    if view is not None and view.scene is not None and not sizes:
        scene = view.scene
        fit = evaluate_at(scene, np.zeros(COUNT), view.nominal.poses, view.nominal.scatter)
        left = np.where(scene.usable[..., None], fit.left(scene), 0.0)
        place = int(np.linalg.norm(left, axis=-1).sum(axis=1).argmax())
        usable = scene.usable[place]
        pixels, expected = scene.pixels[place][usable], fit.lines.pixels[place][usable]
    elif diagnosis.recordings.rest_poses:
        place = diagnosis.recordings.rest_poses[-1]
        pixels = place.pixels[place.usable]
        expected = _expected(
            np.column_stack([np.nan_to_num(place.pixels), place.usable.astype(float)]), place.domain, camera, sizes
        )
        if expected is None:
            return False
        expected = expected[place.usable]
    else:
        return False
    axes.plot(*pixels.T, "o", color=DARK, ms=2.5)
    axes.plot(*expected.T, "x", color=RED, ms=4)
    axes.invert_yaxis()
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("px; dot: seen, cross: predicted")
    return True


def _expected(
    keypoints: np.ndarray, domain: Task, camera: Camera, off: Mapping[str, ValueWithInterval]
) -> np.ndarray | None:
    shift = np.array([off["x"].value, off["y"].value, 0.0]) if off else np.zeros(3)
    try:
        pose = estimate_pose(keypoints, domain, camera=camera).pose
        return project_keypoints(domain, Pose(pose.position - shift, pose.quaternion), camera)[:, :2]
    except (PoseError, ValueError):
        return None


def _plot_scatter(axes: Axes, diagnosis: TaskDiagnosis) -> bool:
    """Deviations of all corners from their medians, in the longest rest."""
    if diagnosis.noise is None:
        return False
    track = max(diagnosis.recordings.tracks, key=lambda one: len(one.time))
    rest = max(find_rests(track), key=lambda piece: piece.stop - piece.start)
    pixels = np.where(track.usable[rest][..., None], track.pixels[rest], np.nan)
    known = np.isfinite(pixels[..., 0]).any(axis=0)
    off = pixels[:, known] - np.nanmedian(pixels[:, known], axis=0)
    axes.plot(*off.reshape(-1, 2).T, ".", color=BLUE, ms=1.5, alpha=0.5)
    angle = np.linspace(0, 2 * np.pi, 60)
    axes.plot(
        2 * diagnosis.noise.spread.value * np.cos(angle),
        2 * diagnosis.noise.spread.value * np.sin(angle),
        color=DARK,
        lw=0.8,
    )
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("px off, at rest; circle: 2 x spread")
    return True


def _plot_latency(axes: Axes, diagnosis: TaskDiagnosis) -> bool:
    """The object's way in the longest push, as images have it, and the tip's."""
    if diagnosis.latency is None or not diagnosis.latency.pushes:
        return False
    one = max(diagnosis.latency.pushes, key=lambda push: len(push.time))
    begin = one.time[0] - 0.1
    shown = (one.at > begin) & (one.at < one.time[-1])
    axes.plot(one.at[shown] - begin, 1e3 * one.tip[shown], color=GREY, lw=2, label="tip")
    axes.plot(one.time - begin, 1e3 * one.way, ".", color=BLUE, ms=3, label="object, seen")
    axes.legend(fontsize=6, frameon=False, loc="lower right")
    axes.set_xlabel("s")
    axes.set_ylabel("mm to go")
    return True


def _plot_friction_cone(axes: Axes, diagnosis: TaskDiagnosis) -> bool:
    """Force along the table against what presses the object on it, with the nominal and the measured lines."""
    force = diagnosis.forces
    if force is None or not force.measured or "table" not in force.measured:
        return False
    nominal = NominalContact.of(diagnosis.recordings.tasks[0].domain)
    weight = GRAVITY * force.measured.get("mass", (nominal.mass,))[0]
    pressed = np.array([r.normal + weight for r in force.readings])
    far = np.array([0.0, 1.1 * pressed.max()])
    mu, low, high = force.measured["table"]
    axes.plot(far, nominal.table * far, color=GREY, lw=2, label=f"nominal {nominal.table:.2f}")
    axes.fill_between(far, low * far, high * far, color=BLUE, alpha=0.15, lw=0)
    axes.plot(far, mu * far, color=BLUE, lw=1, label=f"measured {mu:.2f}")
    axes.plot(pressed, [r.force for r in force.readings], ".", color=DARK, ms=4)
    axes.legend(fontsize=6, frameon=False, loc="upper left")
    axes.set_xlabel("N on the table")
    axes.set_ylabel("N along it")
    return True


def _plot_path(axes: Axes, diagnosis: TaskDiagnosis, camera: Camera) -> bool:
    """Where the object's middle is seen at the beginning of each experiment."""
    if not diagnosis.recordings.tasks:
        return False
    task, centres = diagnosis.recordings.tasks[0], []
    for name in task.spans:
        try:
            centres.append(pose_at_start(task, name, camera).position[:2])
        except ContractViolation:
            continue
    if not centres:
        return False
    path = 1e3 * np.array(centres)
    axes.plot(*path.T, "-", color=GREY, lw=1)
    axes.plot(*path.T, ".", color=BLUE, ms=4)
    axes.plot(*path[0], "o", color=DARK, ms=4)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x mm; black: where it began")
    axes.set_ylabel("y mm")
    return True


def _plot_touches(axes: Axes, diagnosis: TaskDiagnosis) -> bool:
    """Force against the tip's height at every touched place of the table; the grey line is the nominal height."""
    touches = [t for t in diagnosis.surfaces.touches if t.name.startswith("touch_table")] if diagnosis.surfaces else []
    if not touches:
        return False
    axes.axvline(0.0, color=GREY, lw=2)
    for one in touches:
        axes.plot(1e3 * one.course[:, 0], one.course[:, 1], color=BLUE, lw=0.8)
    axes.set_xlabel("mm over the nominal table")
    axes.set_ylabel("N")
    return True
