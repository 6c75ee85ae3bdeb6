"""The picture of the README: an episode in four moments, and what follows what. `python tools/decomposition.py BAG OUT.jpg`

BAG: a recorded episode with camera images, as `make demo` writes one. The pictures are of the bag; boxes and arrows are the graph's.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from np_description.phases import APPROACH, POST
from np_record.bag import Recording
from np_record.recorded_episode import images, load_episode
from np_record.report.third_person import ThirdPerson
from np_record.report.video import SCALE, annotate, from_the_side

SIDE = 640  # px, of a picture from beside the table, of which
SHOWN = slice(150, 610), slice(90, 550)  # are shown: rows, columns
INK, PALE, BLUE = "#222222", "#f2f4f8", "#1f5fa8"
STEPS = (
    ("1  See", "keypoint detector", "30 times a second", "image, 224 x 224", "8 corners of the object:\nu, v, score"),
    (
        "2  Choose a contact",
        "pre-contact policy",
        "once",
        "corners now,\ncorners at the goal",
        "pose of the hand,\nopening of the fingers",
    ),
    ("3  Go there", "planner, RRT*", "once", "joints,\nthe chosen pose", "trajectory of the joints"),
    (
        "4  Move the object",
        "post-contact policy",
        "10 times a second",
        "corners, corners at the goal, joints,\nhand pose, last action",
        "step of the hand (6), stiffness (7)\nand damping ratio (7) of the joints",
    ),
)


def pictures(bag: Path) -> list[np.ndarray]:
    """Four RGB pictures of a bag: the camera's with corners and goal; from beside the table arm and chosen pose, the way, the push."""
    with Recording(bag) as recording:
        episode = load_episode(recording)
        begins = {state.phase: time for time, state in reversed(episode.phases)}
        if not {APPROACH, POST} <= begins.keys():
            raise ValueError(f"expected an episode with {APPROACH} and {POST}, it has {', '.join(begins)}")
        approach, post = begins[APPROACH], begins[POST]
        seen = next((pixels for time, pixels in images(recording) if time >= approach), None)
    if seen is None:
        raise ValueError("expected a bag with camera images, it has none")
    beside = ThirdPerson(episode.domain, SIDE)
    start, way, chosen, push = (
        from_the_side(beside, episode, time)[SHOWN]
        for time in (approach, (approach + post) / 2, post, post + 0.75 * (episode.duration - post))
    )
    first = annotate(seen, episode, approach)
    bar = 12 * SCALE  # the line of text, which says nothing here
    first[:bar] = first[bar]
    return [first, cv2.addWeighted(start, 0.45, chosen, 0.55, 0), way, push]


def draw(shown: list[np.ndarray]) -> Figure:
    """The whole picture."""
    with matplotlib.rc_context({"font.family": "sans-serif", "text.color": INK}):
        figure = Figure(figsize=(15.2, 7.6), facecolor="white")
        axes = figure.add_axes((0, 0, 1, 1))
        axes.axis("off")
        for n, (picture, (title, who, rate, given, told)) in enumerate(zip(shown, STEPS)):
            left = 2 + 37.7 * n
            axes.text(left, 76.2, title, fontsize=17, fontweight="bold", va="center")
            axes.imshow(picture, extent=(left, left + 35, 39, 74), interpolation="lanczos")
            axes.text(left + 17.5, 36.2, given, ha="center", va="center", fontsize=11, color="#555555")
            _arrow(axes, (left + 17.5, 33.9), (left + 17.5, 31.7))
            _box(axes, (left, 23.2, 35, 8.5), who, rate)
            _arrow(axes, (left + 17.5, 23), (left + 17.5, 20.6))
            axes.text(left + 17.5, 18.2, told, ha="center", va="center", fontsize=11, color=BLUE)
            if n < 3:
                _arrow(axes, (left + 35.2, 27.5), (left + 37.5, 27.5))
        _arrow(axes, (94.9, 15.6), (94.9, 13.1))
        _arrow(axes, (132.6, 15.6), (132.6, 13.1))
        _box(
            axes,
            (77.4, 4.4, 72.7, 8.5),
            "joint impedance controller",
            "500 times a second: stiffness x (target - angle) - damping x speed, as torques",
        )
        axes.text(
            2,
            8.6,
            "One camera, one arm. Steps 2 and 3 are done before the hand touches anything,\nstep 4 from then on until the object is at its goal (green).",
            va="center",
            fontsize=12.5,
        )
        axes.set(xlim=(0, 152), ylim=(3, 79))  # pictures have set their own
    return figure


def _box(axes: Axes, place: tuple[float, float, float, float], name: str, rate: str) -> None:
    left, low, width, height = place
    axes.add_patch(
        FancyBboxPatch((left, low), width, height, boxstyle="round,pad=0,rounding_size=1.2", fc=PALE, ec=BLUE, lw=1.4)
    )
    axes.text(left + width / 2, low + 0.66 * height, name, ha="center", va="center", fontsize=14, fontweight="bold")
    axes.text(left + width / 2, low + 0.27 * height, rate, ha="center", va="center", fontsize=11)


def _arrow(axes: Axes, begin: tuple[float, float], end: tuple[float, float]) -> None:
    axes.add_patch(
        FancyArrowPatch(begin, end, arrowstyle="-|>", mutation_scale=13, color=INK, lw=1.2, shrinkA=0, shrinkB=0)
    )


def main() -> None:
    """Draw the picture of a bag."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("bag", type=Path)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    draw(pictures(options.bag)).savefig(options.out, dpi=100)


if __name__ == "__main__":
    main()
