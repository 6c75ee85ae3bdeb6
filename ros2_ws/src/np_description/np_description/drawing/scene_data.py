"""A scene and its moments as data, for pages and pictures: shapes once, poses of bodies for each moment."""

from __future__ import annotations

import mujoco
import numpy as np

from np_description.camera import CAMERA
from np_description.domains import Pose, Task
from np_description.drawing.expected_view import find_expected_outlines
from np_description.drawing.meshes import CANVAS, load_visual_model
from np_description.drawing.robot import WORLD, robot_bodies, visual_shapes
from np_description.panda import BASE_FRAME, STATE_NAMES
from np_description.scene import OBJECT

GOAL = "goal"
_DIGITS = 4


class SceneData:
    """The shapes of a domain's scene, and where they are for joints and object; needs no renderer.

    meshes: as in `load_visual_model`, which raises NoMeshes.
    """

    def __init__(self, domain: Task, *, meshes: bool | None = None):
        self.domain = domain
        self._model = load_visual_model(domain.as_rigid_box, meshes=meshes, share=CANVAS)
        self._data = mujoco.MjData(self._model)
        self._joints = [self._model.joint(name).qposadr[0] for name in STATE_NAMES]
        self.bodies = [WORLD, *robot_bodies(self._model), OBJECT, GOAL]

    def scene(self) -> dict:
        """bodies: names in the order of poses; shapes: body, kind, size m, pose in the body's frame, rgba 0..1; of a mesh
        vertices, x, y, z m in that pose, and triangles, three numbers of vertices each; expected_view: outlines px in an image
        of the size px that the policies' camera has."""
        drawn = [
            {
                "body": self.bodies.index(shape.body),
                "kind": shape.kind,
                "size": _round(shape.size),
                "pose": _round([*shape.position, *shape.quaternion]),
                "rgba": _round(shape.rgba),
            }
            | (
                {"vertices": shape.vertices.round(_DIGITS).tolist(), "triangles": shape.triangles.tolist()}
                if shape.kind == "mesh"
                else {}
            )
            for shape in visual_shapes(self._model)
        ]
        goal = {"body": self.bodies.index(GOAL), "kind": "box", "size": list(self.domain.half_size)}
        drawn.append({**goal, "pose": [0, 0, 0, 1, 0, 0, 0], "rgba": [0.2, 0.8, 0.3, 0.25]})
        view = {"size": [CAMERA.width, CAMERA.height], "lines": find_expected_outlines(self.domain).round(1).tolist()}
        return {
            "domain": self.domain.name,
            "base_frame": BASE_FRAME,
            "bodies": self.bodies,
            "shapes": drawn,
            "expected_view": view,
        }

    def poses(self, joints: np.ndarray, body: Pose | None, goal: Pose | None) -> list[list[float] | None]:
        """Pose of each body for joints (9,): x, y, z m and w, x, y, z; None for an unknown object or goal."""
        self._data.qpos[self._joints] = joints
        mujoco.mj_kinematics(self._model, self._data)
        found = []
        for name in self.bodies[:-2]:
            placed = self._data.body(name)
            found.append(_round([*placed.xpos, *placed.xquat]))
        return [*found, *(_round([*p.position, *p.quaternion]) if p else None for p in (body, goal))]


def _round(values) -> list[float]:
    return [round(float(value), _DIGITS) for value in values]
