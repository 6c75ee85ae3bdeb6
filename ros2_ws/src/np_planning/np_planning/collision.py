"""Collision checks of the arm in a domain's scene, by MuJoCo's own geometry.

The model is np_description's scene with two changes. The robot's links also collide with each other, and contacts are
reported from `clearance` m before they touch. So "no contact" means "at least that far away".
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import mujoco
import numpy as np

from np_description.domains import Pose, Task
from np_description.panda import BASE_FRAME, NOMINAL, PandaModel
from np_description.scene import OBJECT, OBJECT_BIT, ROBOT_BIT, build_scene

_SELF_BIT = 8  # beside the bits of np_description.scene: robot against robot
_TOOL = ("panda_hand", *(finger.replace("_joint", "") for finger in NOMINAL.fingers))


@dataclass(frozen=True)
class CloseBodies:
    """Two bodies that touch or come too close: names and distance m, negative for penetration."""

    first: str
    second: str
    distance: float

    @property
    def by_tool(self) -> bool:
        """Hand or finger against object or surroundings, which is what a manipulation policy does on purpose."""
        return (self.first in _TOOL) != (self.second in _TOOL) and not any(
            name.startswith("panda_link") for name in (self.first, self.second)
        )

    def __str__(self) -> str:
        state = f"{-self.distance * 1e3:.1f} mm deep in" if self.distance < 0 else f"{self.distance * 1e3:.1f} mm from"
        return f"{self.first} is {state} {self.second}"


class CollisionModel:
    """The arm among the fixed surroundings and the object, posture by posture. Not thread safe.

    clearance m: nearest approach to surroundings and object that counts as free.
    """

    def __init__(self, domain: Task, *, clearance: float = 0.005, panda: PandaModel = NOMINAL) -> None:
        self.domain, self.clearance, self.panda = domain, clearance, panda
        self.model = self._build()
        self.data = mujoco.MjData(self.model)
        self.checks = 0
        """Postures looked at so far; planning budgets count these instead of time."""

    def place(self, object_pose: Pose | None, opening: float) -> None:
        """Put the object at its pose in the base frame (None: out of the way) and open each finger by `opening` m."""
        position = np.array([0.0, 0.0, -10.0]) if object_pose is None else object_pose.position
        quaternion = np.array([1.0, 0, 0, 0]) if object_pose is None else object_pose.quaternion
        self.data.qpos[7:9] = opening
        self.data.qpos[9:12], self.data.qpos[12:16] = position, quaternion

    def is_free(self, joints) -> bool:
        """Whether nothing is nearer than the clearance, nor the arm in itself, at joints (7,) rad."""
        self.checks += 1
        self.data.qpos[:7] = joints
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        return self.data.ncon == 0

    def touches(self, joints) -> list[CloseBodies]:
        """Every pair nearer than the clearance at joints (7,) rad, the deepest first."""
        if self.is_free(joints):
            return []
        contact, found = self.data.contact, {}
        for pair, distance in zip(contact.geom, contact.dist):
            names = tuple(self._name(geom) for geom in pair)
            found[names] = min(found.get(names, np.inf), float(distance))
        touches = [CloseBodies(*names, distance) for names, distance in found.items()]
        return sorted(touches, key=lambda touch: touch.distance)

    def _name(self, geom: int) -> str:
        """What people call a geom: its body's name, or its own where it belongs to the surroundings."""
        body = self.model.geom_bodyid[geom]
        return self.model.body(body).name if body else self.model.geom(geom).name

    def _build(self) -> mujoco.MjModel:
        spec = build_scene(self.domain.as_rigid_box, panda=self.panda)
        for geom in spec.geoms:
            if geom.group == 1:  # robot
                geom.contype |= _SELF_BIT
                geom.conaffinity |= _SELF_BIT
            elif geom.contype:  # surroundings and object, which need not meet each other here
                geom.conaffinity = ROBOT_BIT
                geom.contype = OBJECT_BIT if geom.name == OBJECT else geom.contype
                geom.margin = self.clearance
        _exclude_neighbours(spec)
        return spec.compile()


def _exclude_neighbours(spec: mujoco.MjSpec) -> None:
    """Exclude pairs of robot bodies at most two apart in the chain.

    The joint limits keep those apart, while the capsules, fatter than the links, may overlap.
    """
    rank = {BASE_FRAME: 0} | {f"panda_link{i}": i for i in range(1, 8)} | {_TOOL[0]: 8, _TOOL[1]: 9, _TOOL[2]: 9}
    for first, second in combinations(rank, 2):
        if abs(rank[first] - rank[second]) <= 2:
            spec.add_exclude(bodyname1=first, bodyname2=second)
