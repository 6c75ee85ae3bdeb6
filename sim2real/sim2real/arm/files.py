"""Any arm from its file: MJCF, or URDF. What does not make one chain of hinges with mass is refused.

MuJoCo reads both. Of a URDF it keeps `<limit effort>` and `<dynamics>`, not `<limit velocity>`, which is read here; what is
only drawn or touched is taken out before, so that no mesh has to be found. A URDF has no word for rotors: `armature` is zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from sim2real.arm import rigid_body as rigid
from sim2real.arm.model import Arm, arm_from_model

LEAST_INERTIA = 1e-9  # kg m^2 that a joint has to turn
KINDS = {0: "free", 1: "ball", 2: "slide", 3: "hinge"}  # of mujoco.mjtJoint


def load_arm(path: str | Path, joints: Sequence[str] | None = None, tip: str | None = None) -> Arm:
    """An arm from an MJCF or URDF file: all its hinges, or those named, base to tip; other joints are held where they are.
    It rests in the first key posture of an MJCF, or at zero, within its limits.

    tip: site or body (of a URDF: link) at the tool point; None: the last body that the last joint carries. Raises ValueError
    for a file that MuJoCo cannot read, joints that are no hinges, no chain, or move no mass, and a tip that the last joint
    does not carry.
    """
    path = Path(path)
    model, speeds = _read_model(path)
    kinds = {model.joint(j).name: KINDS[int(model.jnt_type[j])] for j in range(model.njnt)}
    names = list(joints) if joints else [name for name, kind in kinds.items() if kind == "hinge"]
    if not names:
        raise ValueError(f"{path}: expected hinges, got {_describe_joints(kinds)}")
    for name in names:
        if kinds.get(name) != "hinge":
            what = f"a {kinds[name]}" if name in kinds else "no joint of it"
            raise ValueError(
                f"{path}: expected hinges as joints of the arm, got {name!r}, {what}; it has {_describe_joints(kinds)}"
            )
    try:
        arm = arm_from_model(model, names)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    if not np.array_equal(arm.parent, np.arange(len(arm)) - 1):
        raise ValueError(
            f"{path}: expected one chain of hinges base to tip, got {', '.join(names)}; --joints names those of the arm"
        )
    turned = rigid.drive_inertia(replace(arm, armature=np.zeros(len(arm))), arm.reference)
    if (turned < LEAST_INERTIA).any():
        raise ValueError(
            f"{path}: expected links with mass, got none that {arm.joints[int(np.argmin(turned))]} turns: "
            "the file needs inertials"
        )
    posture = model.key_qpos[0] if model.nkey else model.qpos0
    rest = np.clip(posture[[model.joint(name).qposadr[0] for name in names]], arm.position_lower, arm.position_upper)
    limits = np.array([speeds.get(name, limit) for name, limit in zip(names, arm.velocity_limit)])
    arm = replace(arm, name=path.stem, velocity_limit=limits, rest=rest)
    return arm if tip is None else replace(arm, tip=_locate_tip(path, model, arm, tip))


def _read_model(path: Path) -> tuple[mujoco.MjModel, dict[str, float]]:
    """The model, and the speed limits rad/s that a URDF states, by joint."""
    try:
        root = ElementTree.parse(path).getroot()
        if root.tag != "robot":
            return mujoco.MjModel.from_xml_path(str(path)), {}
        for link in root.iter("link"):
            for part in [*link.findall("visual"), *link.findall("collision")]:
                link.remove(part)
        own = root.find("mujoco")
        if own is not None:
            root.remove(own)
        # Links that are fixed to others stay bodies of their own: a tool point may be one of them.
        ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", fusestatic="false")
        speeds = {
            joint.get("name", ""): float(joint.find("limit").get("velocity"))
            for joint in root.findall("joint")
            if joint.find("limit") is not None and joint.find("limit").get("velocity") is not None
        }
        model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    except (OSError, ValueError, ElementTree.ParseError) as error:
        raise ValueError(f"{path}: expected an MJCF or URDF file of an arm, got: {error}") from error
    return model, {name: speed for name, speed in speeds.items() if speed > 0}


def _locate_tip(path: Path, model: mujoco.MjModel, arm: Arm, tip: str) -> np.ndarray:
    """Place (3,) m in the last link of a site or body."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    last = model.jnt_bodyid[model.joint(arm.joints[-1]).id]
    site, body = (mujoco.mj_name2id(model, kind, tip) for kind in (mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_BODY))
    place = data.site_xpos[site] if site >= 0 else data.xpos[body]
    carrier = int(model.site_bodyid[site]) if site >= 0 else body
    while carrier > 0 and carrier != last:
        carrier = int(model.body_parentid[carrier])
    if carrier != last:
        raise ValueError(f"{path}: expected a site or body that {arm.joints[-1]} carries as tool point, got {tip!r}")
    return data.xmat[last].reshape(3, 3).T @ (place - data.xanchor[model.joint(arm.joints[-1]).id])


def _describe_joints(kinds: dict[str, str]) -> str:
    return ", ".join(f"{name} ({kind})" for name, kind in kinds.items()) or "no joints"
