"""A rendered calibration: the board in the hand or on the table, seen by a camera whose pose is known.

MuJoCo draws the picture at one and a half times the camera's resolution. Then it is distorted by the lens, blurred
and given noise. So `calibrate` gets what a real image has passed through, light apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import mujoco
import numpy as np

from np_common.rotations import matrix_from_vector, quaternion_from_matrix
from np_control.kinematics import forward_kinematics, pose_distance, solve_ik
from np_description.calibration import Lens
from np_description.camera import CAMERA, Camera
from np_description.domains import CARD, Pose
from np_description.panda import NOMINAL, TCP_FRAME
from np_description.scene import build_scene
from np_perception.calibration.board import Board, undistort
from np_perception.camera.rectify import project_distorted
from np_sim_bridge.renderer import EglRenderer

D435 = Lens(1280, 720, 918.0, 917.0, 643.0, 356.0, (0.10, -0.22, 6e-4, -4e-4, 0.06))
"""Like the colour stream of a D435, with a little more distortion than theirs have."""
_FINER = 1.5  # pixels drawn for one of the camera's, in each direction
_MARGIN = 1.12  # how much wider than the camera's the drawn image is, for the lens to take from
_BLUR = 0.5  # px of the camera
_NOISE = 2.0  # of 255, standard deviation
_TEXTURE = 8000  # px per m of board
_THICKNESS = 0.003  # m
_TRIES = 200  # postures that are tried


@dataclass(frozen=True, eq=False)
class Mount:
    """The board's pose on its carrier, T_E or the base."""

    position: np.ndarray
    """(3,) m."""
    rotation: np.ndarray
    """(3, 3)."""


def hand_mount(board: Board) -> Mount:
    """A board on a handle between the fingers, its middle 11 cm beyond them, turned to face the camera."""
    pointing = forward_kinematics(NOMINAL.ready)[1] @ matrix_from_vector(np.array([0.0, np.radians(20), 0.0]))
    facing = np.asarray(CAMERA.rotation)
    rotation = pointing.T @ facing
    return Mount(np.array([0.0, 0.0, 0.11]) - rotation @ _middle(board), rotation)


def table_mount(board: Board, height: float = 0.001) -> Mount:
    """A board that lies in the middle of the workspace, its upper side `height` m over the table."""
    # x to the left, y away from the base, z down
    flat = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    rotation = matrix_from_vector(np.array([0.0, 0.0, 0.2])) @ flat
    return Mount(np.array([0.5, 0.0, height]) - rotation @ _middle(board), rotation)


def _middle(board: Board) -> np.ndarray:
    return np.array([board.columns, board.rows, 0]) * board.square / 2


class BoardScene:
    """The scene with a board, drawn through a lens. position, rotation: of the camera; in_hand: what carries
    the board."""

    def __init__(
        self,
        board: Board,
        mount: Mount,
        position: np.ndarray,
        rotation: np.ndarray,
        *,
        lens: Lens = D435,
        in_hand: bool = True,
        seed: int = 0,
    ) -> None:
        self.board, self.mount, self.lens, self.in_hand = board, mount, lens, in_hand
        self.position, self.rotation = np.asarray(position, float), np.asarray(rotation, float)
        self._rng = np.random.default_rng(seed)
        width, height = (round(side * _FINER * _MARGIN) for side in (lens.width, lens.height))
        self._drawn = Camera(
            width,
            height,
            lens.fx * _FINER,
            lens.fx * _FINER,
            (width - 1) / 2,
            (height - 1) / 2,
            tuple(self.position.tolist()),
            tuple(map(tuple, self.rotation.tolist())),
        )
        spec = build_scene(CARD, camera=self._drawn)
        spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
        spec.visual.quality.offsamples = 4
        self._add_board(spec)
        self._renderer = EglRenderer(spec.compile(), shadows=False)
        self._configuration = np.array(spec.key("ready").qpos, float)
        self._configuration[9:12] = 0.3, 0.6, 0.0025  # the card, out of the way
        u, v = np.meshgrid(np.arange(lens.width), np.arange(lens.height))
        ideal = undistort(np.stack([u.ravel(), v.ravel()], axis=1).astype(float), lens)
        drawn = (ideal - (lens.cx, lens.cy)) / (lens.fx, lens.fy) * self._drawn.fx + (
            self._drawn.cx,
            self._drawn.cy,
        )
        self._map = drawn.reshape(lens.height, lens.width, 2).astype(np.float32)

    def _add_board(self, spec: mujoco.MjSpec) -> None:
        picture = self.board.picture(_TEXTURE)
        colour = np.ascontiguousarray(np.repeat(picture[..., None], 3, axis=2))
        texture = spec.add_texture(
            name="board",
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            width=picture.shape[1],
            height=picture.shape[0],
            nchannel=3,
        )
        texture.data = colour.tobytes()
        material = spec.add_material(name="board", specular=0.0, shininess=0.0, reflectance=0.0)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "board"
        position, rotation = self.mount.position, self.mount.rotation
        parent = spec.worldbody
        if self.in_hand:
            parent, tcp = spec.body("panda_hand"), spec.site(TCP_FRAME)
            turn = np.empty(9)
            mujoco.mju_quat2Mat(turn, np.asarray(tcp.quat, float))
            position = np.asarray(tcp.pos) + turn.reshape(3, 3) @ position
            rotation = turn.reshape(3, 3) @ rotation
        # A box carries its picture on its upper side, with its own y up: half a turn about the board's x.
        upright = rotation @ np.diag([1.0, -1.0, -1.0])
        centre = position + rotation @ _middle(self.board)
        silent = dict(contype=0, conaffinity=0, mass=0)
        body = parent.add_body(pos=centre, quat=quaternion_from_matrix(upright))
        width, height = self.board.size
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[width / 2, height / 2, _THICKNESS / 2],
            pos=[0, 0, -_THICKNESS / 2],
            material="board",
            **silent,
        )

    def place_card(self, pose: Pose) -> None:
        """Put the card there in every image from now on."""
        self._configuration[9:16] = *pose.position, *pose.quaternion

    def render(self, joints: np.ndarray) -> np.ndarray:
        """The camera's image (height, width, 3) uint8 with the arm at `joints` (7,) rad."""
        self._configuration[:7] = joints
        drawn = self._renderer.render(self._configuration)
        drawn = cv2.GaussianBlur(drawn, (0, 0), _BLUR * _FINER)
        image = cv2.remap(drawn, self._map, None, cv2.INTER_LINEAR).astype(float)
        image += self._rng.normal(0, _NOISE, image.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()

    def corner_pixels(self, joints: np.ndarray) -> np.ndarray:
        """True pixels (n, 2) of the corners."""
        at, turned = forward_kinematics(np.asarray(joints, float)) if self.in_hand else (np.zeros(3), np.eye(3))
        points = (self.board.corners @ self.mount.rotation.T + self.mount.position) @ turned.T + at
        return project_distorted((points - self.position) @ self.rotation, self.lens)

    def postures(self, count: int, rng: np.random.Generator, tilt: float = 0.45) -> list[np.ndarray]:
        """Joints (7,) at which the policies' view shows the board, turned by up to `tilt` rad away from
        facing the camera.

        Raises ValueError if the arm cannot show it so often.
        """
        crop = 0.5 * CAMERA.width / CAMERA.fx
        depth = rng.uniform(0.55, 0.9, (_TRIES, 1))
        at = np.concatenate([rng.uniform(-0.55, 0.55, (_TRIES, 2)) * crop, np.ones((_TRIES, 1))], axis=1) * depth
        turn = self.rotation @ matrix_from_vector(rng.uniform(-tilt, tilt, (_TRIES, 3)))
        hand = turn @ self.mount.rotation.T
        position = at @ self.rotation.T + self.position - turn @ _middle(self.board) - hand @ self.mount.position
        joints = solve_ik(NOMINAL.ready + rng.normal(0, 0.1, (_TRIES, 7)), position, hand, iterations=30)
        distance, angle = pose_distance(joints, position, hand)
        good = (distance < 1e-4) & (angle < 1e-3) & (position[:, 2] > 0.05)
        found = [q for q in joints[good] if self._is_shown(q, crop)][:count]
        if len(found) < count:
            raise ValueError(f"board: expected {count} postures that show it, the arm reaches {len(found)}")
        return found

    def _is_shown(self, joints: np.ndarray, crop: float) -> bool:
        pixels = undistort(self.corner_pixels(joints), self.lens)
        across = (pixels - (self.lens.cx, self.lens.cy)) / (self.lens.fx, self.lens.fy)
        return (np.abs(across) < 0.95 * crop).all(axis=1).mean() > 0.6
