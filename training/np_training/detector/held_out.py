"""Labelled images that no detector was trained on, drawn by the renderers of the deployed camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
import torch

from np_description.camera import CAMERA
from np_description.domains import Task
from np_description.drawing.meshes import load_visual_model
from np_description.scene import build_scene
from np_sim_bridge.renderer import make_renderer
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
from np_training.detector.visited import mix_visited

SHIFTED_LOOK = Randomisation(camera_position=0.02, camera_angle=0.035, any_table=0.0)
PATTERNS = 8  # of tables that are patterned


@dataclass(frozen=True)
class LabelledImage:
    """One labelled image: image (224, 224, 3) uint8, truth (8, 2) px, visible (8,), present (8,)."""

    image: np.ndarray
    truth: np.ndarray
    visible: np.ndarray
    present: np.ndarray


def held_out_images(
    domain: Task,
    count: int,
    seed: int,
    look: Randomisation,
    renderer: str,
    patterned: bool,
    visited: torch.Tensor | None = None,
    meshes: bool = False,
) -> Iterator[LabelledImage]:
    """So many labelled images from `renderer` (see np_sim_bridge.renderer); visited: states (m, 16) of episodes, from
    which most are taken; meshes: the arm as it looks (`make meshes`), not patterned."""
    generator = torch.Generator().manual_seed(seed)
    states = sample_states(domain, count, generator)
    if visited is not None:
        states = mix_visited(states, visited, SampleConfig.visited, generator)
    for part in states.split(-(-count // PATTERNS) if patterned else count):
        model = make_patterned_model(domain, generator) if patterned else load_visual_model(domain, meshes=meshes)
        looks, camera = Looks(model, look, "cpu"), make_renderer(renderer, model)
        for state in part:
            values = looks.sample(1, generator)
            if look is not NOMINAL_LOOK:
                for name, value in values.items():
                    getattr(model, name)[:] = value[0].numpy()
            image = camera.render(state.double().numpy())
            pixels = project_corners(domain.half_size, state[None], values["cam_pos"][:, 0], values["cam_quat"][:, 0])
            geoms = cast_rays(model, state.double().numpy(), pixels[0].numpy())
            blocks = corner_blocks(model)
            visible = corner_visibility(geoms, pixels, blocks)[0]
            present = inside_image(pixels)[0] & bool(object_area(geoms, blocks) >= LEAST_AREA)
            yield LabelledImage(image, pixels[0].numpy(), visible.numpy(), present.numpy())
        camera.close()


def make_patterned_model(domain: Task, generator: torch.Generator) -> mujoco.MjModel:
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
    directions = np.stack([(u - CAMERA.cx) / CAMERA.fx, (CAMERA.cy - v) / CAMERA.fy, -np.ones(u.shape)], axis=-1)
    directions = directions.reshape(-1, 3) @ data.cam_xmat[0].reshape(3, 3).T
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
    geoms[low[1] : high[1], low[0] : high[0]] = hit.reshape(u.shape)
    return torch.from_numpy(geoms)[None]
