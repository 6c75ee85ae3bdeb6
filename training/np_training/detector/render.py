"""Labelled images of the scene in batches, by MuJoCo Warp's ray caster on a GPU or a CPU.

Each image is rendered at twice its resolution, so that the background can be replaced before the edges are
smoothed (np_training.detector.augment). Every world has its own camera, lights and colours.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp

from np_common.rotations import matrix_from_quaternion, matrix_from_vector, quaternion_from_matrix
from np_description.camera import CAMERA
from np_description.domains import Task
from np_description.keypoints import box_keypoints
from np_description.scene import OBJECT, load_model
from np_training.detector.scenes import STATE_SIZE

OVERSAMPLING = 2
VISIBLE_RADIUS = 1.0  # px: a corner is visible if its own block is seen this near to it


@dataclass(frozen=True)
class Randomisation:
    """Spread of what differs from image to image; all uniform within +-.

    camera_position m, camera_angle rad (each axis); light_position m, light_target m; light_power: range of a
    factor on each light; light_tint: on each channel of its colour; object_colour, robot_colour: on each
    channel of RGB; dim_robot: share of robots each part of which is darker by any factor; any_table: share of
    tables and obstacles of any colour at all; shadowless: share of images without shadows.
    """

    camera_position: float = 0.01
    camera_angle: float = 0.0175
    light_position: float = 0.5
    light_target: float = 0.15
    light_power: tuple[float, float] = (0.5, 1.3)
    light_tint: float = 0.1
    object_colour: float = 0.10
    robot_colour: float = 0.15
    dim_robot: float = 0.3
    any_table: float = 0.5
    shadowless: float = 0.2


NOMINAL_LOOK = Randomisation(0, 0, 0, 0, (1, 1), 0, 0, 0, 0, 0, 0)


@dataclass
class Frames:
    """A batch of renderings at OVERSAMPLING times the camera's resolution, and labels in pixels of the
    camera.

    rgb (n, 448, 448, 3) in [0, 1]; surroundings (n, 448, 448) bool: table or nothing; pixels (n, 8, 2) u, v
    of the corners; visible (n, 8) bool; object_area (n,): pixels of the object, at the camera's resolution.
    """

    rgb: torch.Tensor
    surroundings: torch.Tensor
    pixels: torch.Tensor
    visible: torch.Tensor
    object_area: torch.Tensor


class SceneRenderer:
    """Renders `worlds` states of a domain at once, and labels them. edges: the range of the factors on the object's edges, another
    object in each image; None: its own size."""

    def __init__(
        self,
        domain: Task,
        worlds: int,
        device: str,
        edges: tuple[float, float] | None = None,
    ) -> None:
        self.domain, self.worlds, self.device = domain, worlds, torch.device(device)
        self.size = CAMERA.width * OVERSAMPLING
        model = load_model(domain)
        self.blocks = corner_blocks(model)
        self.table = model.geom("table").id
        self.looks = Looks(model, Randomisation(), self.device)
        self._shapes = Shapes(domain, model, self.device, edges) if edges else None
        batched = (*Looks.fields, *(Shapes.fields if edges else ()))
        self._wp_device = wp.get_device(device)
        if self._wp_device.is_cuda:
            torch.cuda.set_stream(wp.stream_to_torch(wp.get_stream(self._wp_device)))  # one queue: no synchronising
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        with wp.ScopedDevice(self._wp_device):
            self.model = mjw.put_model(model, batch_sizes=dict.fromkeys(batched, worlds))
            self.data = mjw.put_data(model, data, nworld=worlds)
            self.context = mjw.create_render_context(
                model,
                nworld=worlds,
                cam_res=(self.size, self.size),
                render_rgb=True,
                render_seg=True,
                use_shadows=True,
                shadow_light_fraction=0.0,
            )  # as in OpenGL
            self._rgb = wp.zeros((worlds, self.size, self.size), dtype=wp.vec3)
            self._segments = wp.zeros((worlds, self.size, self.size), dtype=wp.vec2i)
        self.fields = {name: wp.to_torch(getattr(self.model, name)) for name in batched}
        self._qpos = wp.to_torch(self.data.qpos)

    def render(self, states: torch.Tensor, generator: torch.Generator) -> Frames:
        """Frames of states (worlds, 16), each under a look of its own. The images are overwritten by the next
        call."""
        if states.shape != (self.worlds, STATE_SIZE):
            raise ValueError(f"states: expected {(self.worlds, STATE_SIZE)}, got {tuple(states.shape)}")
        half_size = self.domain.half_size
        values = self.looks.sample(self.worlds, generator)
        if self._shapes is not None:
            half_size, states, shape = self._shapes.sample(states, generator)
            values |= shape
        for name, value in values.items():
            self.fields[name].copy_(value)
        self._qpos.copy_(states)
        with wp.ScopedDevice(self._wp_device):
            mjw.kinematics(self.model, self.data)
            mjw.com_pos(self.model, self.data)
            mjw.camlight(self.model, self.data)
            mjw.refit_bvh(self.model, self.data, self.context)
            mjw.render(self.model, self.data, self.context)
            mjw.get_rgb(self.context, 0, self._rgb)
            mjw.get_segmentation(self.context, 0, self._segments)
        geoms = wp.to_torch(self._segments)[..., 0]
        pixels = project_corners(half_size, states, self.fields["cam_pos"][:, 0], self.fields["cam_quat"][:, 0])
        visible = corner_visibility(geoms, pixels, self.blocks)
        area = object_area(geoms, self.blocks)
        return Frames(wp.to_torch(self._rgb), (geoms == self.table) | (geoms < 0), pixels, visible, area)


def corner_blocks(model: mujoco.MjModel) -> list[int]:
    """Geom ids of the eight coloured blocks, keypoint order."""
    return [g for g in range(model.ngeom) if model.geom_bodyid[g] == model.body(OBJECT).id and model.geom_group[g] == 2]


def object_area(geoms: torch.Tensor, blocks: list[int]) -> torch.Tensor:
    """Pixels (n,) of the camera that show the object, from geom ids (n, h, w) at any multiple of its
    resolution."""
    seen = (geoms >= min(blocks)) & (geoms <= max(blocks))
    return seen.sum((1, 2)) * (CAMERA.height / geoms.shape[1]) ** 2


class Shapes:
    """Objects whose edges are longer or shorter than their domain's own: all by one factor in COMMON of the images, each by its own in
    OWN; the others are as they are. They lie as low as before."""

    fields = ("geom_size", "geom_pos")
    COMMON, OWN = 0.4, 0.4

    def __init__(self, domain: Task, model: mujoco.MjModel, device: str | torch.device, edges: tuple[float, float]):
        self._edges = edges
        self._half_size = torch.tensor(domain.half_size, dtype=torch.float32, device=device)
        self._nominal = {
            name: torch.tensor(getattr(model, name), dtype=torch.float32, device=device) for name in self.fields
        }
        self._object = torch.as_tensor(model.geom_bodyid == model.body(OBJECT).id, device=device)

    def sample(self, states: torch.Tensor, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor, dict]:
        """Half sizes (n, 3) m, the states (n, 16) with such objects in the place of their own, and values of the model's `fields`."""
        low, high = self._edges
        count = len(states)
        kind, common, own = (
            torch.rand(count, width, generator=generator, device=generator.device) for width in (1, 1, 3)
        )
        factor = low + (high - low) * torch.where(kind < self.COMMON, common.expand(-1, 3), own)
        factor = torch.where(kind < self.COMMON + self.OWN, factor, torch.ones_like(factor))
        up = matrix_from_quaternion(states[:, 12:16])[:, 2].abs()
        states = states.clone()
        states[:, 11] += (up * self._half_size * (factor - 1)).sum(-1)
        scale = torch.where(self._object[:, None], factor[:, None], 1.0)
        return self._half_size * factor, states, {name: value * scale for name, value in self._nominal.items()}


class Looks:
    """Random cameras, lights and colours of a model."""

    fields = (
        "cam_pos",
        "cam_quat",
        "geom_rgba",
        "light_pos",
        "light_dir",
        "light_diffuse",
        "light_castshadow",
    )

    def __init__(self, model: mujoco.MjModel, look: Randomisation, device: str | torch.device) -> None:
        self.look = look
        self.nominal = {name: torch.as_tensor(np.array(getattr(model, name)), device=device) for name in self.fields}
        self.nominal = {name: t.bool() if name == "light_castshadow" else t.float() for name, t in self.nominal.items()}
        self.object_geoms = torch.as_tensor(model.geom_bodyid == model.body(OBJECT).id, device=device)
        self.robot_geoms = torch.as_tensor(model.geom_group == 1, device=device)

    def sample(self, count: int, generator: torch.Generator) -> dict[str, torch.Tensor]:
        """Values (count, ...) of the model's `fields`."""
        look, nominal = self.look, self.nominal

        def spread(shape: tuple[int, ...], width: float) -> torch.Tensor:
            return width * (2 * torch.rand(count, *shape, generator=generator, device=generator.device) - 1)

        def chance(share: float, *shape: int) -> torch.Tensor:
            return torch.rand(count, *shape, generator=generator, device=generator.device) < share

        rotation = matrix_from_quaternion(nominal["cam_quat"]) @ matrix_from_vector(spread((1, 3), look.camera_angle))
        lights = nominal["light_pos"].shape[0]
        light_position = nominal["light_pos"] + spread((lights, 3), look.light_position)
        # A light keeps pointing at what it nominally lights on the table, give or take.
        reach = -nominal["light_pos"][:, 2:] / nominal["light_dir"][:, 2:]
        target = nominal["light_pos"] + reach * nominal["light_dir"] + spread((lights, 3), look.light_target)
        direction = target - light_position
        low, high = look.light_power
        power = low + (high - low) * torch.rand(count, lights, 1, generator=generator, device=generator.device)
        tint = 1 + spread((lights, 3), look.light_tint)
        return {
            "cam_pos": nominal["cam_pos"] + spread((1, 3), look.camera_position),
            "cam_quat": quaternion_from_matrix(rotation),
            "light_pos": light_position,
            "light_dir": direction / direction.norm(dim=-1, keepdim=True),
            "light_diffuse": nominal["light_diffuse"] * power * tint,
            "light_castshadow": nominal["light_castshadow"] & ~chance(look.shadowless, 1),
            "geom_rgba": self._colours(count, generator, spread, chance),
        }

    def _colours(self, count: int, generator: torch.Generator, spread, chance) -> torch.Tensor:
        look, rgba = self.look, self.nominal["geom_rgba"].expand(count, -1, -1).clone()
        geoms = rgba.shape[1]
        width = look.object_colour * self.object_geoms + look.robot_colour * self.robot_geoms
        rgba[..., :3] += width[:, None] * spread((geoms, 3), 1.0)
        factor = torch.rand(count, geoms, 1, generator=generator, device=generator.device)
        dim = self.robot_geoms[:, None] & chance(look.dim_robot, 1, 1)
        rgba[..., :3] = torch.where(dim, rgba[..., :3] * factor, rgba[..., :3])
        colours = torch.rand(count, geoms, 3, generator=generator, device=generator.device)
        surroundings = ~(self.object_geoms | self.robot_geoms)[:, None] & chance(look.any_table, 1, 1)
        rgba[..., :3] = torch.where(surroundings, colours, rgba[..., :3])
        return rgba.clamp(0, 1)


def project_corners(half_size, states: torch.Tensor, position: torch.Tensor, quaternion: torch.Tensor):
    """Pixels (n, 8, 2) of the corners of objects of half_size (3,) or (n, 3) m in states (n, 16), seen by cameras at position (n, 3),
    quaternion (n, 4).

    The quaternion is MuJoCo's (looking along -z, y up). The image of a camera at another pose is CAMERA's image
    of the points after they have been moved along to CAMERA.
    """
    corners = box_keypoints(half_size, states[:, 9:12], states[:, 12:16])
    flip = torch.diag(torch.tensor([1.0, -1.0, -1.0], device=states.device))
    rotation = matrix_from_quaternion(quaternion) @ flip
    optical = torch.einsum("nij,nki->nkj", rotation, corners - position[:, None])
    home = torch.tensor(CAMERA.rotation, dtype=states.dtype, device=states.device)
    pixels, _ = CAMERA.project(optical @ home.T + torch.tensor(CAMERA.position, device=states.device))
    return pixels


def corner_visibility(geoms: torch.Tensor, pixels: torch.Tensor, blocks: list[int]) -> torch.Tensor:
    """Whether (n, 8) a corner's own block shows within VISIBLE_RADIUS of it.

    geoms (n, h, w): geom id at each pixel of a rendering, at any multiple of the camera's resolution; pixels
    (n, 8, 2).
    """
    count, height, width = geoms.shape
    scale = height / CAMERA.height
    reach = max(1, round(VISIBLE_RADIUS * scale))
    offset = torch.arange(-reach, reach + 1, device=geoms.device)
    centre = ((pixels + 0.5) * scale - 0.5).round().long()
    columns = centre[..., 0, None, None] + offset
    rows = centre[..., 1, None, None] + offset[:, None]
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    index = rows.clamp(0, height - 1) * width + columns.clamp(0, width - 1)
    near = geoms.reshape(count, -1).gather(1, index.flatten(1)).view(index.shape)
    own = torch.tensor(blocks, device=geoms.device, dtype=near.dtype)[:, None, None]
    return ((near == own) & inside).flatten(2).any(dim=-1)
