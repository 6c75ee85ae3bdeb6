"""The experiment that the chain names for a picture that is off, made of the cases of a set whose answer left that a class: is it settled then?

The object is put down at eight places all over the picture, and something else measures where it lies, to `MEASURED`. What is true of a case is true
of this recording, its camera, its detector and its edges. `np_diagnosis view` is asked of it. It is settled where one effect of the catalogue is named
of the camera, and the true one. The last line printed is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from sim2real.effects.view_effects import ViewEffects
from sim2real.task.camera.places import Place, places
from sim2real.task.track import Track
from sim2real.thresholds import THRESHOLDS

from np_blind.camera.boxes import Case as Scene
from np_blind.camera.boxes import Truth, put_down
from np_blind.chain.answering import answered, publish
from np_blind.chain.cases import Case, draw
from np_blind.chain.figures import rates
from np_common.cli import Parser
from np_common.rotations import wxyz_from_xyzw
from np_description.camera import CAMERA, Camera
from np_description.domains import BUMP, Pose
from np_description.keypoints import box_keypoints
from np_description.panda import NOMINAL

COUNT, RESTS, RATE = 8, 3.0, 30  # places; s at each; images a second
HIDDEN = 1.0  # s between two places, of which there is no image
SETTLED = 0.4  # s before the next from which on the object lies there
MARGIN = 4.0  # px of the picture's edge within which no corner is
MEASURED = 5e-4, np.radians(0.15)  # m and rad, standard deviations of a pose that is measured
PICTURE = "camera_extrinsics"


def ask(case: Case, seed: int) -> dict:
    """What the view stage says of a case once the object has been put down."""
    from sim2real.task.camera.parameters import EFFECTS
    from sim2real.task.camera.view import view

    found = view(recorded(case, seed), CAMERA)
    named = [sorted({one for way in (n.effect, *n.rivals) for one in EFFECTS[way].ids}) for n in found.named]
    told = {"case": case.number, "kind": case.kind, "gap": case.gap, "verdict": found.verdict, "named": named}
    sizes = {n.effect: {name: [v.value, v.low, v.high] for name, v in n.sizes.items()} for n in found.named}
    return {**told, "sizes": sizes, "doubt": found.doubt, "settled": is_settled(case, named)}


def is_settled(case: Case, named: list[list[str]]) -> bool:
    """Whether of the camera's effects the true one is named, alone, and nothing that is not there."""
    return [PICTURE] in named and all(set(ids) & set(case.effects) for ids in named)


def recorded(case: Case, seed: int) -> list[Place]:
    """The places, each with the pose that was measured."""
    rng = np.random.default_rng([seed, case.number, 11])
    film, camera = case.film(seed * 1000 + case.number), ViewEffects(case.patch, CAMERA).camera
    half, lift = np.asarray(case.domain.half_size), case.patch.scene_change().lift
    scene = Scene(Truth(height=lift, size=case.longer), domain=BUMP)
    images, poses = [], []
    for number in range(COUNT):
        corners = np.full((8, 3), np.inf)
        while not _is_inside(corners, camera):
            _, middle, turn = put_down(scene, scene.truth, rng)
            corners = box_keypoints(half, middle, wxyz_from_xyzw(turn.as_quat()))
        lies = Pose(middle, wxyz_from_xyzw(turn.as_quat()))
        begin, count = number * (RESTS + HIDDEN), round(RESTS * RATE)
        film.look(round((begin - SETTLED) * 1e9), lies, NOMINAL.ready, False)
        for image in range(count + round(SETTLED * RATE)):  # those at the end wait for the last that were due
            made = film.look(round((begin + image / RATE) * 1e9), lies, NOMINAL.ready, image < count)
            images += made
            poses += [(middle, turn)] * len(made)
    times, found = np.array([stamp for stamp, _ in images]) / 1e9, np.array([one for _, one in images])
    track = Track("put down", times - times[0], found[..., :2], found[..., 2] >= THRESHOLDS.track.score)
    return [_measured(place, *poses[at.start], rng) for place, at in places(track, BUMP)]


def _is_inside(corners: np.ndarray, camera: Camera) -> bool:
    if not np.isfinite(corners).all():
        return False
    seen = camera.project(corners)[0]
    return bool(((seen > MARGIN) & (seen < np.array([CAMERA.width, CAMERA.height]) - MARGIN)).all())


def _measured(place: Place, middle: np.ndarray, turn: Rotation, rng: np.random.Generator) -> Place:
    off, tipped = (deviation * rng.standard_normal(3) for deviation in MEASURED)
    return replace(place, position=middle + off, rotation=(Rotation.from_rotvec(tipped) * turn).as_matrix())


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = Parser(
        prog="python -m np_blind.chain.put_down",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--of", type=int, default=72, help="how many cases the set has (default: %(default)s)")
    parser.add_argument("--seed", type=int, required=True, help="of the set")
    parser.add_argument(
        "--out", type=Path, required=True, help="folder of the set, with its answers; put_down.json is written there"
    )
    options = parser.parse_args(arguments)
    cases = {case.number: case for case in draw(options.of, options.seed)}
    open_ = [
        row["case"]
        for row in answered(list(cases.values()), options.out)
        if PICTURE in row["gap"] and any(PICTURE in ids and len(ids) > 1 for ids in row.get("named", ()))
    ]
    rows = [ask(cases[number], options.seed) for number in open_]
    figures = rates({"settled by the named experiment": [row["settled"] for row in rows]})
    command = f"chain.put_down --of {options.of} --seed {options.seed} --out FOLDER"
    publish(options.out / "put_down.json", command, options.seed, figures=figures, rows=rows)
    print(json.dumps({"cases": len(rows), **figures}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
