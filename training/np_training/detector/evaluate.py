"""Judge a released detector on images it has not seen, drawn by the renderers of the deployed camera.

    python -m np_training.detector.evaluate --domain card --images 5000

Three sets: `nominal`, the scene as the bridge draws it, by OpenGL; `shifted`, by OpenGL, with table patterns
never used in training, other lights and colours, and the camera within 2 cm and 2 degrees of its place;
`ray_caster`, the nominal scene by MuJoCo Warp's ray caster, one ray a pixel. With --episodes, three fifths of the
states are ones that the released policies pass through
(`np_training.evaluate --released DOMAIN --conditions paper --record FILE`). Writes
docs/results/detector_DOMAIN.json, a picture of the best, median and worst detections beside it, and a plot of
how far scores hold; prints the JSON. Without OpenGL only the last set is judged.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import torch
from matplotlib.figure import Figure

from np_bringup.figures import detector_figures
from np_bringup.pages import style
from np_description.camera import CAMERA
from np_description.domains import DOMAINS, Domain, find_domain
from np_description.scene import build_scene
from np_perception.detector import KeypointDetector
from np_sim_bridge.renderer import egl_works, make_renderer
from np_training.detector.metrics import summarise
from np_training.detector.network import RELIABLE
from np_training.detector.render import (
    NOMINAL_LOOK,
    Looks,
    Randomisation,
    corner_blocks,
    corner_visibility,
    object_area,
    project_corners,
)
from np_training.detector.samples import LEAST_AREA, SampleConfig, inside_image
from np_training.detector.scenes import sample_states
from np_training.detector.visited import load_visited, mix_visited

SHIFTED_LOOK = Randomisation(camera_position=0.02, camera_angle=0.035, any_table=0.0)
PATTERNS = 8  # of tables in the shifted set
SETS = "nominal", "shifted", "ray_caster"


@dataclass(frozen=True)
class HeldOut:
    """One labelled image: image (224, 224, 3) uint8, truth (8, 2) px, visible (8,), present (8,)."""

    image: np.ndarray
    truth: np.ndarray
    visible: np.ndarray
    present: np.ndarray


def held_out_images(domain: Domain, count: int, seed: int, look: Randomisation, renderer: str,
                    patterned: bool, visited: torch.Tensor | None = None) -> Iterator[HeldOut]:
    """So many labelled images from `renderer` (see np_sim_bridge.renderer); visited: states (m, 16) of episodes, from
    which most are taken."""
    generator = torch.Generator().manual_seed(seed)
    states = sample_states(domain, count, generator)
    if visited is not None:
        states = mix_visited(states, visited, SampleConfig.visited, generator)
    for part in states.split(-(-count // PATTERNS) if patterned else count):
        model = patterned_model(domain, generator) if patterned else build_scene(domain).compile()
        looks, camera = Looks(model, look, "cpu"), make_renderer(renderer, model)
        for state in part:
            values = looks.sample(1, generator)
            if look is not NOMINAL_LOOK:
                for name, value in values.items():
                    getattr(model, name)[:] = value[0].numpy()
            image = camera.render(state.double().numpy())
            pixels = project_corners(domain, state[None], values["cam_pos"][:, 0], values["cam_quat"][:, 0])
            geoms = cast_rays(model, state.double().numpy(), pixels[0].numpy())
            blocks = corner_blocks(model)
            visible = corner_visibility(geoms, pixels, blocks)[0]
            present = inside_image(pixels)[0] & bool(object_area(geoms, blocks) >= LEAST_AREA)
            yield HeldOut(image, pixels[0].numpy(), visible.numpy(), present.numpy())
        camera.close()


def patterned_model(domain: Domain, generator: torch.Generator) -> mujoco.MjModel:
    """The scene on a table with a checker or gradient pattern of random colours and size."""
    draw = torch.rand(8, generator=generator).tolist()
    spec = build_scene(domain)
    kind = mujoco.mjtBuiltin.mjBUILTIN_CHECKER if draw[0] < 0.7 else mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    spec.add_texture(
        name="table",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=kind,
        rgb1=draw[1:4],
        rgb2=draw[4:7],
        width=256,
        height=256,
    )
    material = spec.add_material(name="table", texrepeat=[4 + 20 * draw[7]] * 2)
    textures = ["" for _ in range(mujoco.mjtTextureRole.mjNTEXROLE)]
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "table"
    material.textures = textures
    table = spec.geom("table")
    table.material, table.rgba = "table", [1, 1, 1, 1]
    return spec.compile()


def cast_rays(model: mujoco.MjModel, state: np.ndarray, pixels: np.ndarray) -> torch.Tensor:
    """Geom id (1, 224, 224) seen by the model's camera, -1 for none; only around the object's corners, pixels
    (8, 2)."""
    data = mujoco.MjData(model)
    data.qpos[:] = state
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    geoms = np.full((CAMERA.height, CAMERA.width), -1)
    low = np.clip(np.floor(pixels.min(axis=0)).astype(int) - 3, 0, None)
    high = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 4, [CAMERA.width, CAMERA.height])
    if (high <= low).any():
        return torch.from_numpy(geoms)[None]
    u, v = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    directions = np.stack(
        [(u - CAMERA.cx) / CAMERA.fx, (CAMERA.cy - v) / CAMERA.fy, -np.ones(u.shape)], axis=-1
    )
    directions = (directions.reshape(-1, 3) @ data.cam_xmat[0].reshape(3, 3).T)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hit, distance = np.empty(len(directions), np.int32), np.empty(len(directions))
    drawn = np.array([1, 1, 1, 0, 0, 0], np.uint8)
    mujoco.mj_multiRay(
        model,
        data,
        data.cam_xpos[0],
        directions.ravel(),
        drawn,
        True,
        -1,
        hit,
        distance,
        None,
        len(hit),
        mujoco.mjMAXVAL,
    )
    geoms[low[1]:high[1], low[0]:high[0]] = hit.reshape(u.shape)
    return torch.from_numpy(geoms)[None]


def judge(detector: KeypointDetector, images: Iterator[HeldOut], total: int, name: str) -> tuple[dict, list]:
    """Figures, and (worst visible error px, image, detection) of each image that shows the object."""
    rows, pictures = [], []
    for i, sample in enumerate(images):
        found = detector.detect(sample.image)
        rows.append((found.pixels, found.scores, sample.truth, sample.visible, sample.present))
        seen = sample.visible & sample.present
        if seen.any():
            error = np.linalg.norm(found.pixels - sample.truth, axis=1)
            pictures.append((float(error[seen].max()), sample, found))
        print(f"\r{name}: {i + 1}/{total}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return summarise(*map(np.array, zip(*rows))), pictures


def draw_reliability(sets: dict[str, dict], path: Path) -> None:
    """What share of keypoints is within RELIABLE px of the truth, against the score that says so."""
    with style():
        figure = Figure(figsize=(5.2, 4.4), layout="constrained")
        axes = figure.add_subplot()
        axes.plot([0, 1], [0, 1], color="0.6", lw=1, ls="--")
        for name, figures in sets.items():
            score, held, count = np.array(figures["reliability"]).T
            (line,) = axes.plot(score, held, lw=1, label=f"{name}: {figures['calibration_error']:.3f}")
            axes.scatter(score, held, s=4 + 12 * np.log10(count), color=line.get_color())
        axes.set(xlabel="score", ylabel=f"share within {RELIABLE:g} px", xlim=(0, 1.02), ylim=(0, 1.02))
        axes.legend(title="expected calibration error", frameon=False)
        figure.savefig(path, dpi=110)


def draw(pictures: list, path: Path, columns: int = 5) -> None:
    """A sheet of the best, median and worst images: rings are true corners (white seen, black hidden), dots
    detections."""
    pictures = sorted(pictures, key=lambda p: p[0])
    middle = max(0, len(pictures) // 2 - columns // 2)
    rows = {
        "best": pictures[:columns],
        "median": pictures[middle : middle + columns],
        "worst": pictures[-columns:],
    }
    figure = Figure(figsize=(3 * columns, 9.6), layout="constrained")
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
    figure.savefig(path, dpi=70)


def evaluate(domain: Domain, folder: str | Path, images: int, seed: int, pictures: Path | None,
             visited: torch.Tensor | None = None, only: Sequence[str] = SETS) -> dict:
    """The figures of the sets, `visited` states among them; the sheet of the shifted one goes to `pictures`."""
    detector = KeypointDetector(domain, folder)
    sets = {"ray_caster": (NOMINAL_LOOK, "warp", False)}
    if egl_works():
        sets = {"nominal": (NOMINAL_LOOK, "egl", False), "shifted": (SHIFTED_LOOK, "egl", True), **sets}
    result = {
        "domain": domain.name,
        "seed": seed,
        "weights_sha256": detector.information["weights_sha256"],
        "sets": {},
    }
    for number, (name, (look, renderer, patterned)) in enumerate(sets.items()):
        if name not in only:
            continue
        samples = held_out_images(domain, images, 7919 * (seed + 1) + number, look, renderer, patterned,
                                  visited)
        result["sets"][name], shown = judge(detector, samples, images, name)
        if pictures is not None and shown and name in ("shifted", "ray_caster") and not (
                name == "ray_caster" and "shifted" in sets):
            draw(shown, pictures)
    result["detection"] = detector_figures(domain, str(folder))
    return result


def main() -> None:
    """Command line; the last line printed is the figures as JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--domain", choices=list(DOMAINS), default="card")
    parser.add_argument("--weights", default="", help="folder of weights; default: the released ones")
    parser.add_argument("--images", type=int, default=5000, help="of each set")
    parser.add_argument("--sets", nargs="+", choices=SETS, default=SETS)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--episodes", type=Path, help="recording of np_training.evaluate: most states come from it")
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    options = parser.parse_args()
    torch.set_num_threads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    stem = options.out / f"detector_{options.domain}"
    domain = find_domain(options.domain)
    visited = load_visited(options.episodes, domain, "cpu") if options.episodes else None
    result = evaluate(domain, options.weights, options.images, options.seed, stem.with_suffix(".png"), visited,
                      options.sets)
    draw_reliability(result["sets"], stem.with_name(f"{stem.name}_reliability.png"))
    stem.with_suffix(".json").write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result))


if __name__ == "__main__":
    main()
