"""The robot for drawing: its shapes, and the same as a URDF, both read from the compiled scene.

The scene is the one description that everything else runs with; what is seen is what collides, in our own primitives.
Links, joints and frames have the manufacturer's names (panda_link0 ... panda_hand, panda_joint1 ..., panda_finger_joint1).
`python -m np_description.drawing.robot > panda.urdf` writes a file.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import mujoco
import numpy as np

from np_description.domains import CARD
from np_description.panda import BASE_FRAME, FINGER_FORCE, FINGER_SPEED, JOINT_NAMES, NOMINAL, TCP_FRAME
from np_description.scene import OBJECT, load_model

WORLD = "world"
_KINDS = {
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_PLANE: "plane",
    mujoco.mjtGeom.mjGEOM_MESH: "mesh",
}
_INVISIBLE = 3  # group of the object's hull, inside its coloured blocks


@dataclass(frozen=True)
class VisualShape:
    """A shape that is drawn, in the frame of its body."""

    body: str
    """Name of the body."""
    kind: str
    """capsule, box, plane or mesh."""
    size: tuple[float, ...]
    """capsule: radius, half length along z; box: half size (3,); plane: half size x, y; mesh: half size of its bounding box, m."""
    position: np.ndarray
    """(3,) m."""
    quaternion: np.ndarray
    """wxyz (4,)."""
    rgba: np.ndarray
    """(4,) 0..1."""
    vertices: np.ndarray | None = None
    """Of a mesh (n, 3) m."""
    triangles: np.ndarray | None = None
    """Numbers of its vertices (m, 3), outwards."""


def visual_shapes(model: mujoco.MjModel) -> list[VisualShape]:
    """Everything that is drawn of a scene, body by body."""
    found = []
    for i in range(model.ngeom):
        if model.geom_group[i] == _INVISIBLE:
            continue
        kind = _KINDS[mujoco.mjtGeom(model.geom_type[i])]
        size = model.geom_size[i][: 3 if kind in ("box", "mesh") else 2]
        body = model.body(model.geom_bodyid[i]).name
        mesh = _mesh(model, model.geom_dataid[i]) if kind == "mesh" else ()
        placed = model.geom_pos[i], model.geom_quat[i], model.geom_rgba[i]
        found.append(VisualShape(body, kind, tuple(size.tolist()), *placed, *mesh))
    return found


def _mesh(model: mujoco.MjModel, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a mesh."""
    vertex, triangle = model.mesh_vertadr[number], model.mesh_faceadr[number]
    return (
        model.mesh_vert[vertex : vertex + model.mesh_vertnum[number]],
        model.mesh_face[triangle : triangle + model.mesh_facenum[number]],
    )


def robot_bodies(model: mujoco.MjModel) -> list[str]:
    """The links of the robot, parents first."""
    names = [model.body(i).name for i in range(model.nbody)]
    return [name for name in names if name not in (WORLD, OBJECT)]


def urdf() -> str:
    """The nominal robot as URDF. URDF has no fields for contact and joint dynamics."""
    model = load_model(CARD)
    robot = Element("robot", name="panda")
    drawn = visual_shapes(model)
    for name in robot_bodies(model):
        link = SubElement(robot, "link", name=name)
        _add_inertial(link, model.body(name))
        for shape in drawn:
            if shape.body == name:
                _add_shape(link, shape)
    for name in robot_bodies(model):
        if name != BASE_FRAME:
            _add_joint(robot, model, model.body(name))
    tcp = model.site(TCP_FRAME)
    SubElement(robot, "link", name=TCP_FRAME)
    joint = SubElement(robot, "joint", name=f"{TCP_FRAME}_joint", type="fixed")
    _add_ends(joint, model.body(model.site_bodyid[tcp.id]).name, TCP_FRAME)
    _add_origin(joint, tcp.pos, tcp.quat)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode")


def _add_inertial(link: Element, body) -> None:
    inertial = SubElement(link, "inertial")
    _add_origin(inertial, body.ipos, body.iquat)
    SubElement(inertial, "mass", value=_text(body.mass))
    principal = dict(zip(("ixx", "iyy", "izz"), map(_number, body.inertia)))
    SubElement(inertial, "inertia", **principal, ixy="0", ixz="0", iyz="0")


def _add_shape(link: Element, shape: VisualShape) -> None:
    """URDF has no capsule: a cylinder and two spheres."""
    radius, half = shape.size[:2]
    parts: list[tuple[str, dict[str, str], float]] = (
        [
            ("cylinder", {"radius": _number(radius), "length": _number(2 * half)}, 0.0),
            ("sphere", {"radius": _number(radius)}, half),
            ("sphere", {"radius": _number(radius)}, -half),
        ]
        if shape.kind == "capsule"
        else [("box", {"size": _text(2 * np.array(shape.size))}, 0.0)]
    )
    along = np.empty(3)
    mujoco.mju_rotVecQuat(along, np.array([0.0, 0.0, 1.0]), shape.quaternion)
    for kind, size, offset in parts:
        for tag in ("visual", "collision"):
            element = SubElement(link, tag)
            _add_origin(element, shape.position + offset * along, shape.quaternion)
            SubElement(SubElement(element, "geometry"), kind, **size)
            if tag == "visual":
                name = "white" if shape.rgba[0] > 0.5 else "dark"
                SubElement(SubElement(element, "material", name=name), "color", rgba=_text(shape.rgba))


def _add_joint(robot: Element, model: mujoco.MjModel, body) -> None:
    has_joint = body.jntnum[0] > 0
    joint = model.joint(body.jntadr[0]) if has_joint else None
    slides = has_joint and joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    kind = ("prismatic" if slides else "revolute") if has_joint else "fixed"
    element = SubElement(robot, "joint", name=joint.name if has_joint else f"{body.name}_joint", type=kind)
    _add_ends(element, model.body(body.parentid[0]).name, body.name)
    _add_origin(element, body.pos, body.quat)
    if has_joint:
        SubElement(element, "axis", xyz=_text(joint.axis))
        lower, upper = joint.range
        number = JOINT_NAMES.index(joint.name) if not slides else 0
        effort, speed = (
            (FINGER_FORCE, FINGER_SPEED) if slides else (NOMINAL.torque_limit[number], NOMINAL.velocity_limit[number])
        )
        limits = {"lower": lower, "upper": upper, "effort": effort, "velocity": speed}
        SubElement(element, "limit", **{name: _number(value) for name, value in limits.items()})


def _add_ends(joint: Element, parent: str, child: str) -> None:
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)


def _add_origin(element: Element, position, quaternion) -> None:
    SubElement(element, "origin", xyz=_text(position), rpy=_text(roll_pitch_yaw(quaternion)))


def roll_pitch_yaw(quaternion) -> np.ndarray:
    """Angles (3,) rad about the fixed x, y, z axes, as URDF has them, of a quaternion wxyz (4,)."""
    m = np.empty(9)
    mujoco.mju_quat2Mat(m, np.asarray(quaternion, float))
    r = m.reshape(3, 3)
    pitch = np.arcsin(np.clip(-r[2, 0], -1.0, 1.0))
    if abs(r[2, 0]) > 1 - 1e-9:  # looking straight up or down: only the sum of roll and yaw is there
        return np.array([0.0, pitch, np.arctan2(-r[0, 1], r[1, 1])])
    return np.array([np.arctan2(r[2, 1], r[2, 2]), pitch, np.arctan2(r[1, 0], r[0, 0])])


def _number(value: float) -> str:
    return f"{float(value):.9g}"


def _text(values) -> str:
    return " ".join(map(_number, np.atleast_1d(values)))


if __name__ == "__main__":
    print(urdf())
