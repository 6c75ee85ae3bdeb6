"""The MuJoCo scene: table, obstacles, Panda with hand, object, camera, lights.

One builder for the bridge, the planner, training and MuJoCo's viewer. Collision shapes are our own primitives, which
are also what is drawn. `python -m np_description.scene card > card.xml` writes a file the viewer opens.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.contact.model import OBJECT_FRICTION, ROLLING, TORSION, Compliance, ContactModel
from np_description.domains import Task
from np_description.hand import BoxShape, CapsuleShape
from np_description.keypoints import CORNERS
from np_description.objects.bodies import add_parts
from np_description.panda import BASE_FRAME, FINGER_FORCE, FINGER_MAX, NOMINAL, TCP_FRAME, Frame, Inertial, PandaModel
from np_description.scene_change import UNCHANGED, SceneChange

OBJECT = "object"
CAMERA_NAME = "camera"
FINGER_STIFFNESS, FINGER_DAMPING = 20000.0, 200.0  # N/m, N s/m: a finger is geared to its motor and hardly gives way

SHAFT, TIP = "shaft", "tip"  # a finger's geoms: their names end so
SUPPORT = "support"  # and the axis of the object along which the patch is proud
SUPPORT_PROUD, SUPPORT_SHARE = 0.0003, 0.97  # m; of the sides of its face, at most: the box itself touches beyond

# Collision bits: a pair collides where one's type meets the other's affinity.
ENVIRONMENT_BIT, OBJECT_BIT, ROBOT_BIT, SUPPORT_BIT = 1, 2, 4, 8

CORNER_COLOURS = (
    (0.85, 0.10, 0.10),
    (0.10, 0.35, 0.90),
    (0.05, 0.60, 0.15),
    (0.95, 0.80, 0.05),
    (0.55, 0.10, 0.65),
    (0.05, 0.75, 0.80),
    (0.95, 0.45, 0.05),
    (0.90, 0.40, 0.65),
)
"""RGB of the block at each corner, keypoint order: every face shows four colours, no two corners look alike."""

_TOUCHING = dict(contype=ROBOT_BIT, conaffinity=ENVIRONMENT_BIT | OBJECT_BIT)
_SILENT = dict(contype=0, conaffinity=0)
_WHITE, _DARK = [0.92, 0.92, 0.92, 1], [0.25, 0.26, 0.28, 1]

# Capsules that enclose each link: link -> (centre m, half axis vector m, radius m) in the link frame.
_LINK_CAPSULES = {
    0: [((-0.04, 0, 0.06), (0.05, 0, 0), 0.06)],
    1: [((0, 0, -0.19), (0, 0, 0.14), 0.06)],
    2: [((0, 0, 0), (0, 0, 0.06), 0.06)],
    3: [((0, 0, -0.14), (0, 0, 0.075), 0.06)],
    4: [((0, 0, 0), (0, 0, 0.06), 0.06)],
    5: [((0, 0, -0.26), (0, 0, 0.05), 0.06), ((0, 0.08, -0.13), (0, 0, 0.08), 0.03)],
    6: [((0, 0, -0.02), (0, 0, 0.04), 0.05), ((0.088, 0, 0), (0, 0, 0.03), 0.045)],
    7: [((0, 0, 0.05), (0, 0, 0.03), 0.04)],
}


def build_scene(
    domain: Task,
    *,
    timestep: float = 0.002,
    arm_collision: bool = True,
    panda: PandaModel = NOMINAL,
    camera: Camera = CAMERA,
    contact: ContactModel | None = None,
    supports: bool = False,
    change: SceneChange = UNCHANGED,
) -> mujoco.MjSpec:
    """The scene of a domain as an MjSpec, robot at its ready posture in keyframe "ready".

    timestep s. With `arm_collision` false only the last link, hand and fingers touch things (training: the other links never
    reach anything, and their pairs cost time). Joint torques act through seven motors, fingers through position servos;
    gravity is compensated for the robot, as the real one does by itself. contact: how rough and how hard everything is, but for
    the object's own surface (`contact_model`); default: the domain's. supports: give the object patches to stand on (`SUPPORT`), whose sizes may then be
    changed. change: what of the scene is other than believed. Parts of an object that is not rigid come after all else in the generalised positions.
    """
    domain, contact = change.domain(domain), change.contact(contact_model(domain, contact or domain.contact))
    spec = mujoco.MjSpec()
    spec.modelname = f"panda_{domain.name}"
    spec.compiler.degree = False
    spec.compiler.autolimits = True
    option = spec.option
    option.timestep = timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    set_friction_law(option, contact)
    # As the ray caster draws: one sample a pixel; a shadow map of 4096 would take five times as long as the rest.
    spec.visual.quality.offsamples, spec.visual.quality.shadowsize = 0, 1024
    _add_surroundings(spec, domain, camera, contact, change.lift)
    _add_robot(spec, panda, arm_collision, contact)
    parts = _add_object(spec, domain, contact)
    if supports:
        _add_supports(spec, domain, contact)
    key = spec.add_key(name="ready")
    home = domain.start
    key.qpos = [
        *panda.ready,
        0.0,
        0.0,
        np.mean(home.x),
        np.mean(home.y),
        home.surface + domain.half_size[2] + change.lift,
        1,
        0,
        0,
        0,
        *[0.0] * parts,
    ]
    key.ctrl = [0.0] * 9
    return spec


def load_model(domain: Task, **options) -> mujoco.MjModel:
    """The compiled scene; options as for `build_scene`."""
    return build_scene(domain, **options).compile()


def contact_model(domain: Task, contact: ContactModel) -> ContactModel:
    """The contact definition with the frictions of the domain's object, where it is another than its own."""
    if domain.object is None:
        return contact
    surface = domain.object.surface
    return replace(contact, table=surface.table.coefficient, finger=surface.finger.coefficient)


def set_friction_law(option: mujoco.MjOption, contact: ContactModel) -> None:
    """The options of a spec by which MuJoCo solves this contact."""
    option.iterations, option.ls_iterations = contact.iterations, contact.line_search
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC if contact.elliptic else mujoco.mjtCone.mjCONE_PYRAMIDAL
    option.impratio = contact.impratio


def surface_options(friction: float, compliance: Compliance) -> dict:
    """Surface options of a geom, as MuJoCo names them."""
    return dict(friction=[friction, TORSION, ROLLING], solref=compliance.solref, solimp=compliance.solimp)


def _add_surroundings(spec: mujoco.MjSpec, domain: Task, camera: Camera, contact: ContactModel, lift: float) -> None:
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.55, 0.6, 0.65],
        rgb2=[0.25, 0.27, 0.3],
        width=64,
        height=384,
    )
    world = spec.worldbody
    world.add_light(name="key", pos=[0.9, -0.6, 1.6], dir=[-0.35, 0.4, -1.2], diffuse=[0.7] * 3, castshadow=True)
    world.add_light(name="fill", pos=[0.6, 0.9, 1.4], dir=[-0.1, -0.6, -1.0], diffuse=[0.3] * 3, castshadow=False)
    fixed = dict(
        contype=ENVIRONMENT_BIT, conaffinity=OBJECT_BIT | ROBOT_BIT, **surface_options(contact.table, contact.hard)
    )
    world.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[0.0, 0.0, lift],
        size=[1.0, 1.0, 0.05],
        rgba=[0.62, 0.58, 0.52, 1],
        **fixed,
    )
    for box in domain.obstacles:
        world.add_geom(
            name=box.name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[*box.centre[:2], box.centre[2] + lift],
            size=box.half_size,
            rgba=[0.42, 0.45, 0.5, 1],
            **fixed,
        )
    # MuJoCo's camera looks along its -z with y up; the optical frame has z forward and y down.
    rotation = np.asarray(camera.rotation) @ np.diag([1.0, -1.0, -1.0])
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, rotation.flatten())
    world.add_camera(
        name=CAMERA_NAME,
        pos=camera.position,
        quat=quaternion,
        fovy=camera.fovy,
        resolution=[camera.width, camera.height],
    )


def _add_robot(spec: mujoco.MjSpec, panda: PandaModel, arm_collision: bool, contact: ContactModel) -> None:
    # The first two links cannot leave the space above the base. The last one stands beside the hand: a policy that is
    # trained without it reaches through the object with it.
    first_touching = 2 if arm_collision else len(panda.joints) - 1
    painted = surface_options(contact.links, contact.hard)
    body = _add_body(spec.worldbody, BASE_FRAME, panda.inertials["link0"])
    for capsule in _LINK_CAPSULES[0]:
        _add_shape(body, CapsuleShape(*capsule), _WHITE, **_SILENT)
    for i, joint in enumerate(panda.joints):
        body = _add_body(body, f"panda_link{i + 1}", panda.inertials[f"link{i + 1}"], panda.joint_frames[i])
        body.add_joint(
            name=joint,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[0, 0, 1],
            range=[panda.position_lower[i], panda.position_upper[i]],
            frictionloss=panda.frictionloss[i],
            damping=np.array([panda.damping[i], 0, 0]),
            armature=panda.armature[i],
        )
        for capsule in _LINK_CAPSULES[i + 1]:
            touching = _TOUCHING if i >= first_touching else _SILENT
            _add_shape(body, CapsuleShape(*capsule), _WHITE, **painted, **touching)
        actuator = spec.add_actuator(
            name=joint,
            target=joint,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            ctrlrange=[-panda.torque_limit[i], panda.torque_limit[i]],
        )
        actuator.set_to_motor()
    _add_hand(spec, body, panda, contact)


def _add_hand(spec: mujoco.MjSpec, link: mujoco.MjsBody, panda: PandaModel, contact: ContactModel) -> None:
    """The hand and its two fingers, on the last link."""
    hand = _add_body(link, "panda_hand", panda.inertials["hand"], panda.frames["link7_hand"])
    housing = surface_options(contact.housing, contact.hard)
    for shape in contact.hand.housing:
        _add_shape(hand, shape, _WHITE, **housing, **_TOUCHING)
    tcp = panda.frames["hand_tcp"]
    hand.add_site(name=TCP_FRAME, pos=tcp.position, quat=tcp.quaternion, size=[0.003, 0, 0], group=4)
    for i, finger in enumerate(panda.fingers):
        body = _add_body(
            hand, finger.replace("_joint", ""), panda.inertials["finger"], panda.frames[f"hand_finger{i + 1}"]
        )
        body.add_joint(
            name=finger,
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[0, 1, 0],
            range=[0, FINGER_MAX],
            damping=np.array([10.0, 0, 0]),
            armature=0.1,
        )
        # Where rubber is another matter than the rest, it decides: MuJoCo would average its compliance with the other's.
        decides = int(contact.rubber != contact.hard)
        rubber = dict(priority=decides, **surface_options(contact.finger, contact.rubber), **_TOUCHING)
        _add_shape(body, contact.hand.shaft, _DARK, SHAFT, **housing, **_TOUCHING)
        _add_shape(body, contact.hand.tip, _DARK, TIP, **rubber)
        actuator = spec.add_actuator(
            name=finger,
            target=finger,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            ctrlrange=[0, FINGER_MAX],
            forcerange=[-FINGER_FORCE, FINGER_FORCE],
        )
        actuator.set_to_position(kp=FINGER_STIFFNESS, kv=FINGER_DAMPING)


def _add_body(parent: mujoco.MjsBody, name: str, inertial: Inertial, frame: Frame | None = None) -> mujoco.MjsBody:
    """A body of the robot, its gravity compensated, at a frame of its parent."""
    body = parent.add_body(name=name, gravcomp=1.0)
    if frame is not None:
        body.pos, body.quat = frame.position, frame.quaternion
    body.mass, body.ipos, body.fullinertia = inertial.mass, inertial.com, inertial.inertia
    body.explicitinertial = True
    return body


def _add_shape(
    body: mujoco.MjsBody, shape: BoxShape | CapsuleShape, rgba: list[float], part: str = "", **collision
) -> None:
    """A geom of a body, named after it and its part, or its number."""
    named = dict(name=f"{body.name}_{part or len(body.geoms)}", rgba=rgba, group=1, **collision)
    if isinstance(shape, BoxShape):
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=shape.centre, size=shape.half_size, **named)
        return
    centre, half_axis = np.asarray(shape.centre), np.asarray(shape.half_axis)
    ends = [*(centre - half_axis), *(centre + half_axis)]
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[shape.radius, 0, 0], fromto=ends, **named)


def _add_object(spec: mujoco.MjSpec, domain: Task, contact: ContactModel) -> int:
    """The object that the domain is played with; the number of parts that move on it."""
    half = np.asarray(domain.half_size)
    body = spec.worldbody.add_body(name=OBJECT, pos=[0.5, 0, half[2]])
    body.add_freejoint(name=OBJECT)
    shape = dict(group=3, **surface_options(OBJECT_FRICTION, contact.hard))
    touching = dict(contype=OBJECT_BIT, conaffinity=ENVIRONMENT_BIT | ROBOT_BIT)
    is_soft = domain.object is not None and domain.object.compliance is not None
    body.add_geom(
        name=OBJECT,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=half,
        density=domain.density,
        **shape,
        **(_SILENT if is_soft else touching),
    )
    for corner, colour in zip(CORNERS, CORNER_COLOURS):
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=half / 2,
            pos=corner * half / 2,
            rgba=[*colour, 1],
            mass=0,
            group=2,
            contype=0,
            conaffinity=0,
        )
    return 0 if domain.object is None else add_parts(body, domain.object, {**shape, **touching})


def _add_supports(spec: mujoco.MjSpec, domain: Task, contact: ContactModel) -> None:
    """Patches a little proud of the object's faces, on which it stands on the table (not on obstacles).

    A box stands on its four corners here, where a real one stands on whatever is proud of it, and turns the more easily the
    nearer that is to its middle. Patches as large as they are made here change hardly anything.
    """
    spec.geom("table").conaffinity |= SUPPORT_BIT
    for axis in range(3):
        half = np.asarray(domain.half_size) * SUPPORT_SHARE
        half[axis] = domain.half_size[axis] + SUPPORT_PROUD
        spec.body(OBJECT).add_geom(
            name=f"{SUPPORT}{axis}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=half,
            mass=0,
            group=4,
            contype=SUPPORT_BIT,
            conaffinity=0,
            **surface_options(OBJECT_FRICTION, contact.hard),
        )


def main() -> None:
    """Print the scene of a domain, and of an object if one is named, as MJCF."""
    import argparse

    from np_description.domains import DOMAINS
    from np_description.objects.choice import DEFAULT, domain_with

    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("domain", choices=list(DOMAINS))
    parser.add_argument("object", nargs="?", default=DEFAULT)
    options = parser.parse_args()
    spec = build_scene(domain_with(options.domain, options.object))
    spec.compile()
    print(spec.to_xml())


if __name__ == "__main__":
    main()
