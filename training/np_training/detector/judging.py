"""A released detector judged on images that it has not seen, drawn by the renderers of the deployed camera."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread, imsave

from np_description.domains import DOMAINS, Task
from np_description.objects.choice import domain_with
from np_perception.detector import KeypointDetector
from np_sim_bridge.renderer import egl_works
from np_training.detector.held_out import SHIFTED_LOOK, LabelledImage, held_out_images
from np_training.detector.metrics import summarise
from np_training.detector.render import NOMINAL_LOOK
from np_training.detector.timing import detector_figures
from np_training.detector.visited import load_visited

SETS = {  # by the names of `np_training.detector.evaluate`: look, renderer, whether the table is patterned, the arm of meshes
    "nominal": (NOMINAL_LOOK, "egl", False, False),
    "shifted": (SHIFTED_LOOK, "egl", True, False),
    "ray_caster": (NOMINAL_LOOK, "warp", False, False),
    "meshes": (NOMINAL_LOOK, "egl", False, True),
}
LIKE = {"meshes": "nominal"}
"""Sets with the states of another."""


def judge(detector: KeypointDetector, images: Iterator[LabelledImage], total: int, name: str) -> tuple[dict, list]:
    """Figures, and (worst visible error px, image, detection) of each image that shows the object."""
    rows, pictures = [], []
    for i, sample in enumerate(images):
        found = detector.detect(sample.image)
        rows.append((found.pixels, found.scores, sample.truth, sample.visible, sample.present))
        seen = sample.visible & sample.present
        if seen.any():
            error = np.linalg.norm(found.pixels - sample.truth, axis=1)
            pictures.append((float(error[seen].max()), sample, found))
        if sys.stderr.isatty() or i + 1 == total:
            print(f"\r{name}: {i + 1}/{total}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return summarise(*map(np.array, zip(*rows))), pictures


def draw(pictures: list, columns: int = 5) -> np.ndarray:
    """RGBA pixels of a sheet of the best, median and worst images: rings are true corners (white seen, black
    hidden), dots detections."""
    pictures = sorted(pictures, key=lambda p: p[0])
    middle = max(0, len(pictures) // 2 - columns // 2)
    rows = {
        "best": pictures[:columns],
        "median": pictures[middle : middle + columns],
        "worst": pictures[-columns:],
    }
    figure = Figure(figsize=(3 * columns, 9.6), dpi=70, layout="constrained")
    axes = figure.subplots(3, columns)
    for (title, chosen), line in zip(rows.items(), axes):
        for axis in line:
            axis.set_axis_off()
        for axis, (error, sample, found) in zip(line, chosen):
            centre = sample.truth[sample.present].mean(axis=0)
            axis.imshow(sample.image, interpolation="nearest")
            edges = np.where(sample.visible, "white", "black")
            axis.scatter(*sample.truth.T, s=40, facecolors="none", edgecolors=edges, linewidths=1.2)
            axis.scatter(*found.pixels.T, s=10, c=found.scores, cmap="RdYlGn", vmin=0, vmax=1, linewidths=0)
            axis.set_xlim(centre[0] - 40, centre[0] + 40)
            axis.set_ylim(centre[1] + 40, centre[1] - 40)
            axis.set_title(f"{title}: {error:.2f} px", fontsize=9)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())


def write_figures(figures: dict, sheet: np.ndarray | None, folder: Path) -> None:
    """Put a domain's figures into detector.json of `folder`, and its sheet at the domain's place in detector.png,
    where the sheets stand below each other in the order of `DOMAINS`."""
    data, picture = folder / "detector.json", folder / "detector.png"
    known = json.loads(data.read_text()) if data.exists() else {}
    known[figures["domain"]] = figures
    data.write_text(json.dumps({name: known[name] for name in DOMAINS if name in known}) + "\n")
    if sheet is None:
        return
    height = len(sheet)
    whole = np.full((height * len(DOMAINS), *sheet.shape[1:]), 255, np.uint8)
    if picture.exists():
        whole = np.round(255 * imread(picture)).astype(np.uint8)
    start = height * list(DOMAINS).index(figures["domain"])
    whole[start : start + height] = sheet
    imsave(picture, whole)


def evaluate(
    domain: Task,
    folder: str | Path,
    images: int,
    seed: int,
    visited: torch.Tensor | None = None,
    only: Sequence[str] = tuple(
        name for name in SETS if name not in LIKE
    ),  # meshes are only there if they were installed
) -> tuple[dict, np.ndarray | None]:
    """The figures of the sets, `visited` states among them, and the sheet of the shifted one."""
    detector = KeypointDetector(domain, folder)
    result = {
        "domain": domain.name,
        "seed": seed,
        "weights_sha256": detector.information["weights_sha256"],
        "sets": {},
    }
    sheet = None
    opengl = egl_works()
    drawable = [name for name, (_, renderer, *_) in SETS.items() if renderer != "egl" or opengl]
    if missing := [name for name in only if name not in drawable]:
        print(f"OpenGL does not work here: not judged on {', '.join(missing)}", file=sys.stderr)
    for name in (name for name in drawable if name in only):
        look, renderer, patterned, meshes = SETS[name]
        images_seed = 7919 * (seed + 1) + list(SETS).index(LIKE.get(name, name))
        samples = held_out_images(domain, images, images_seed, look, renderer, patterned, visited, meshes)
        result["sets"][name], shown = judge(detector, samples, images, name)
        if shown and name == ("shifted" if "shifted" in drawable else "ray_caster"):
            sheet = draw(shown)
    result["detection"] = detector_figures(domain, str(folder))
    return result, sheet


def judge_released(options: argparse.Namespace) -> dict:
    """Figures of the detector that the command line names; they and its sheet go to the named folder."""
    torch.set_num_threads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    domain = domain_with(options.domain, options.object)
    visited = load_visited(options.episodes, domain, "cpu") if options.episodes else None
    result, sheet = evaluate(domain, options.weights, options.images, options.seed, visited, options.sets)
    write_figures(result, sheet, options.out)
    return result
