"""The view of a person beside the table: arm, object and goal, drawn by a painter, without a graphics card.

The arm looks like itself where its meshes are installed (`np_description.drawing.meshes`), else like the shapes that collide.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from np_common.rotations import matrix_from_quaternion
from np_description.domains import Pose, Task
from np_description.drawing.scene_data import SceneData
from np_description.panda import FINGER_MAX

EYE, LOOK = np.array([1.35, -0.95, 0.75]), np.array([0.40, 0.0, 0.22])  # m, base frame
_FOCUS = 1.35  # focal length over the picture's height
_SUN = np.array([0.35, -0.45, 0.82])
_BACKGROUND, _GRID = (29, 33, 38), (53, 60, 69)
_CORNERS = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], float)
_FACES = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
_NORMALS = np.array([(0, 0, -1), (0, 0, 1), (0, -1, 0), (0, 1, 0), (-1, 0, 0), (1, 0, 0)], float)
_SHADES = 6

Paint = tuple[float, Callable[[np.ndarray], None]]
"""How far something is (m), and what draws it."""


class ThirdPerson:
    """Draws a domain's scene in pictures of `size` pixels a side."""

    def __init__(self, domain: Task, size: int):
        self._data, self._size = SceneData(domain), size
        self._shapes = self._data.scene()["shapes"]
        for shape in self._shapes:
            for key in {"vertices", "triangles"} & shape.keys():
                shape[key] = np.array(shape[key])
        back = (EYE - LOOK) / np.linalg.norm(EYE - LOOK)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        self._axes = np.stack([right, -np.cross(back, right), -back])  # x right, y down, z away
        self._empty = np.full((size, size, 3), _BACKGROUND, np.uint8)
        for k in np.linspace(-1, 1, 21):
            for ends in ([(k, -1, 0), (k, 1, 0)], [(-1, k, 0), (1, k, 0)]):
                pixels, far = self._project(np.array(ends, float))
                if (far > 0.05).all():
                    cv2.line(self._empty, *map(_whole, pixels), _GRID, 1, cv2.LINE_AA)

    def picture(self, joints: np.ndarray, body: Pose | None, goal: Pose | None) -> np.ndarray:
        """RGB (size, size, 3) uint8 for joints (7,) rad, fingers as at rest, or (9,) with fingers m."""
        joints = np.asarray(joints, float)
        if joints.shape == (7,):
            joints = np.append(joints, np.zeros(2))
        joints[7:] = np.clip(joints[7:], 0.0, FINGER_MAX)
        poses, paints = self._data.poses(joints, body, goal), []
        for shape in self._shapes:
            outer = poses[shape["body"]]
            if outer is not None and shape["kind"] != "plane":
                turn = matrix_from_quaternion(np.array(outer[3:]))
                inner = np.array(shape["pose"])
                place = np.array(outer[:3]) + turn @ inner[:3]
                draw = {"box": self._box, "capsule": self._capsule, "mesh": self._mesh}[shape["kind"]]
                paints += draw(shape, place, turn @ matrix_from_quaternion(inner[3:]))
        frame = self._empty.copy()
        for _, paint in sorted(paints, key=lambda one: -one[0]):
            paint(frame)
        return frame

    def _project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (n, 2) and how far (n,) m, of points (n, 3)."""
        seen = (points - EYE) @ self._axes.T
        far = np.maximum(seen[:, 2], 0.05)
        return self._size * (0.5 + _FOCUS * seen[:, :2] / far[:, None]), seen[:, 2]

    def _box(self, shape: dict, place: np.ndarray, turn: np.ndarray) -> list[Paint]:
        corners = place + (_CORNERS * shape["size"]) @ turn.T
        pixels, _ = self._project(corners)
        colour, alpha, paints = np.array(shape["rgba"][:3]), shape["rgba"][3], []
        for face, normal in zip(_FACES, _NORMALS @ turn.T):
            middle = corners[list(face)].mean(axis=0)
            if normal @ (EYE - middle) <= 0:
                continue
            outline = np.round(pixels[list(face)]).astype(np.int32)
            painted = _colour(colour * (0.55 + 0.45 * max(0.0, normal @ _SUN)))

            def paint(frame: np.ndarray, outline=outline, painted=painted) -> None:
                if alpha < 1:
                    cv2.polylines(frame, [outline], True, painted, 2, cv2.LINE_AA)
                else:
                    cv2.fillConvexPoly(frame, outline, painted, cv2.LINE_AA)

            paints.append((float(np.linalg.norm(middle - EYE)), paint))
        return paints

    def _capsule(self, shape: dict, place: np.ndarray, turn: np.ndarray) -> list[Paint]:
        radius, half = shape["size"]
        pixels, far = self._project(np.stack([place - half * turn[:, 2], place + half * turn[:, 2]]))
        wide = 2 * radius * _FOCUS * self._size / max(float(far.mean()), 0.05)
        colour = np.array(shape["rgba"][:3])

        def paint(frame: np.ndarray) -> None:
            for i in range(_SHADES):  # from the rim to the side that the light comes from
                shift = np.array([-0.6, -1.0]) * wide * 0.16 * i / _SHADES
                thick = max(1, round(wide * (1 - i / _SHADES)))
                shade = _colour(colour * (0.5 + 0.55 * np.sqrt(i / (_SHADES - 1))))
                cv2.line(frame, _whole(pixels[0] + shift), _whole(pixels[1] + shift), shade, thick, cv2.LINE_AA)

        return [(float(far.mean()) - radius / 2, paint)]

    def _mesh(self, shape: dict, place: np.ndarray, turn: np.ndarray) -> list[Paint]:
        points = place + shape["vertices"] @ turn.T
        pixels = np.round(self._project(points)[0]).astype(np.int32)
        corners = points[shape["triangles"]]
        middles = corners.mean(axis=1)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        seen = np.einsum("ij,ij->i", normals, EYE - middles) > 0
        lit = normals[seen] @ _SUN / np.linalg.norm(normals[seen], axis=1)
        light = 0.5 + 0.5 * np.maximum(0.0, lit)
        far = np.linalg.norm(middles[seen] - EYE, axis=1)
        colours = (255 * np.minimum(1.0, np.outer(light, shape["rgba"][:3]))).tolist()

        def paint(frame: np.ndarray, outline: np.ndarray, colour: list[float]) -> None:
            cv2.fillConvexPoly(frame, outline, colour)

        outlines = pixels[shape["triangles"][seen]]
        return [
            (distance, partial(paint, outline=outline, colour=colour))
            for distance, outline, colour in zip(far.tolist(), outlines, colours)
        ]


def _whole(pixel) -> tuple[int, int]:
    return round(float(pixel[0])), round(float(pixel[1]))


def _colour(rgb: np.ndarray) -> tuple[int, int, int]:
    return tuple(int(255 * min(1.0, float(c))) for c in rgb)
