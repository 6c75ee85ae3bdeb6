"""What an explanation of the view leaves: patterns that it should not, and what it is worth at places that it has not seen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as fisher

from np_description.keypoints import COUNT as CORNER_COUNT
from sim2real.task.camera.fit import MEASURED, CameraFit, Prior, evaluate_at, fit_scene
from sim2real.task.camera.model import SHIFT, TURN, CameraScene
from sim2real.task.camera.parameters import COUNT
from sim2real.thresholds import THRESHOLDS

COMPARISON = THRESHOLDS.camera_comparison
POWERS = tuple((a, degree - a) for degree in (2, 3) for a in range(degree + 1))
"""Of u and v, in patterns that neither a pose nor a focal length makes."""
FAINT = 0.05  # of the clearest of a pattern's directions, below which it is the explanation's own


@dataclass(frozen=True)
class HeldOutPrediction:
    """What a hypothesis predicts at rest poses that it was not fitted to."""

    gain: float
    """Log Bayes factor (nats) of a rest pose."""
    before: float
    """Median distance px of a corner from its nominal place."""
    after: float
    """The same with the hypothesis."""


def find_residual_patterns(scene: CameraScene, found: CameraFit, prior: Prior) -> str:
    """Patterns in what is left that are no chance and matter, in words; "" for none.

    Student's weights would hide what is wrong with a few corners or places each time: far errors are cut short here, and count.
    """
    deviation = np.sqrt(found.scatter**2 + scene.error**2)[..., None]
    weights = np.where(scene.usable[..., None], 1 / deviation, 0.0).repeat(2, axis=-1)  # (k, 8, 2)
    rows = weights.size
    base, right = _equations(scene, found, prior, weights)
    right = right - base @ np.linalg.lstsq(base, right, rcond=None)[0]
    patterns: dict[str, tuple[float, str]] = {}  # by kind, the least probable by chance
    for kind, text, columns, tries in _suspects(scene, found):
        columns = columns / np.maximum(np.sqrt((columns**2).mean(axis=(0, 1, 2))), 1e-12)
        extra = np.zeros((len(right), columns.shape[-1]))
        extra[:rows] = (weights[..., None] * columns).reshape(rows, -1)
        extra -= base @ np.linalg.lstsq(base, extra, rcond=None)[0]  # what the explanation cannot make
        axes, lengths, _ = np.linalg.svd(extra, full_matrices=False)
        significant = lengths > FAINT * lengths.max(initial=1e-12)
        rank, freedom = int(significant.sum()), found.freedom - significant.sum()
        if rank == 0 or freedom < 1:
            continue
        shown = axes[:, significant].T @ right
        remaining = max(right @ right - shown @ shown, 1e-12)
        chance = fisher.sf((shown @ shown / rank) / (remaining / freedom), rank, freedom)
        # As far as it is seen: what the poses of the places make of it is no error of a corner, unless it was measured where they are.
        concerned = scene.usable & (columns != 0).any(axis=(2, 3))
        size = found.scatter * np.sqrt(shown @ shown / max(concerned.sum(), 1))
        if chance * tries < COMPARISON.sure and size > COMPARISON.matters:
            patterns[kind] = min(patterns.get(kind, (1.0, "")), (chance, f"{text} ({size:.1f} px)"))
    return "; ".join(text for _, text in patterns.values())


def _equations(
    scene: CameraScene, found: CameraFit, prior: Prior, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the linearised fit, one beneath the other, by all numbers and poses; and what is left of each."""
    k, lines = len(scene), found.lines
    base = np.zeros((weights.size + COUNT + 6 * k, COUNT + 3 * k))
    corner_rows, prior_rows = slice(0, weights.size), slice(weights.size, weights.size + COUNT)
    base[corner_rows, :COUNT] = (weights[..., None] * lines.by_vector).reshape(-1, COUNT)
    root = np.sqrt(prior.precision(found.vector))
    base[prior_rows, :COUNT] = np.diag(root)
    base[prior_rows.stop :, :COUNT] = (lines.off_by_vector / MEASURED[:, None]).reshape(-1, COUNT)
    for n in range(k):
        columns = slice(COUNT + 3 * n, COUNT + 3 * n + 3)
        base[16 * n : 16 * n + 16, columns] = (weights[n, ..., None] * lines.by_pose[n]).reshape(16, 3)
        base[prior_rows.stop + 6 * n : prior_rows.stop + 6 * n + 6, columns] = lines.off_by_pose[n] / MEASURED[:, None]
    left = weights * (scene.pixels - lines.pixels)
    left *= np.minimum(1.0, COMPARISON.cut / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-12))
    return base, np.concatenate([left.ravel(), -found.vector * root, (-lines.off / MEASURED).ravel()])


def _suspects(scene: CameraScene, found: CameraFit) -> Iterator[tuple[str, str, np.ndarray, int]]:
    """Kind, what a pattern would mean, its columns (k, 8, 2, c) in px, and how many of its kind are tried."""
    camera, lines = scene.camera, found.lines
    place = (lines.pixels - (camera.cx, camera.cy)) / camera.width
    powers = np.stack([place[..., 0] ** a * place[..., 1] ** b for a, b in POWERS], axis=-1)
    columns = np.einsum("kcp,ij->kcijp", powers, np.eye(2)).reshape(*powers.shape[:2], 2, -1)
    yield (
        "lens",
        "what is left goes with the place in the picture: a lens of another kind, or a table that is not flat",
        columns,
        1,
    )
    for corner in range(CORNER_COUNT if (scene.half == scene.half[0]).all() else 0):
        own = lines.by_point * (np.arange(CORNER_COUNT) == corner)[:, None, None]
        yield "box", f"corner {corner} is not where the box that it is taken for has it", own, CORNER_COUNT
    # One place alone may have two corners that are gross together; where its pose was measured, all of them count.
    alone = 1 if scene.measured.all() else 2
    boundaries = range(alone, len(scene) - alone + 1)
    for first in boundaries:
        later = (np.arange(len(scene)) >= first)[:, None, None, None]
        text = f"the camera was moved before {scene.names[first]}"
        yield "moved", text, lines.by_vector[..., np.r_[SHIFT, TURN]] * later, len(boundaries)


def held_out_gain(scene: CameraScene, found: CameraFit, prior: Prior, start: np.ndarray) -> HeldOutPrediction:
    """By fits to the other places, with the scatter of the best explanation. start (k, 3): poses as measured, or as first found."""
    count = min(len(scene), COMPARISON.folds)
    gain, before, after = 0.0, [], []
    for n in range(count):
        out = np.arange(len(scene)) % count == n
        vector = fit_scene(scene.of(~out), prior, start[~out], found.scatter).vector
        held_out = scene.of(out)
        for numbers, sign, away in ((np.zeros(COUNT), -1, before), (vector, 1, after)):
            predicted = evaluate_at(held_out, numbers, found.poses[out], found.scatter)
            gain += sign * predicted.evidence
            away.append(corner_distances(held_out, predicted, start[out]))
    return HeldOutPrediction(gain / len(scene), *(float(np.median(np.concatenate(v))) for v in (before, after)))


def corner_distances(scene: CameraScene, found: CameraFit, start: np.ndarray) -> np.ndarray:
    """px (n,) of usable corners from where the numbers of a fit put them: at the measured poses (k, 3) where there are, else at the fit's."""
    poses = np.where(scene.measured[:, None], start, found.poses)
    left = evaluate_at(scene, found.vector, poses, found.scatter, held=True).left(scene)
    return np.linalg.norm(left, axis=-1)[scene.usable]
