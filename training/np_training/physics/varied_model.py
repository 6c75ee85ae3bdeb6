"""What differs between the worlds of a batched simulator: friction, masses, sizes, stiffness of contacts, fingertips, patches.

MuJoCo Warp keeps an array of a model's field for every world where it is told to; PyTorch tensors alias these arrays here. Whatever is
not set is as nominal, and everything is set in terms of the nominal: nothing adds up from one episode to the next.
"""

from __future__ import annotations

import mujoco
import torch
import warp as wp

from np_common.rotations import quaternion_multiply
from np_description.contact.model import HARD
from np_description.contact.penetration import kind_of
from np_description.domains import Task
from np_description.scene import OBJECT, SUPPORT, SUPPORT_PROUD, SUPPORT_SHARE, TIP

# A body's mass has to change together with that of its subtree, which centres of mass are divided by.
FIELDS = (
    "geom_friction",
    "body_mass",
    "body_subtreemass",
    "body_inertia",
    "geom_solimp",
    "geom_solref",
    "geom_size",
    "geom_pos",
    "geom_quat",
    "body_ipos",
    "dof_frictionloss",
    "dof_damping",
    "dof_armature",
)
"""Of the model, that MuJoCo Warp has to keep for every world."""


class VariedModel:
    """What the model of each world has of its own.

    friction (worlds, geoms, 3), mass (worlds, bodies) kg, subtree_mass (worlds, bodies) kg, inertia (worlds, bodies, 3) kg m2 about the
    principal axes: the simulator's own arrays; scale (worlds, 3): of the object's edges, as `resize` has it; object_body: its index.
    """

    def __init__(self, batched, model: mujoco.MjModel, domain: Task, supports: bool, device: torch.device) -> None:
        """batched: MuJoCo Warp's model of `model` with FIELDS for every world; supports: whether the object has patches to stand on."""
        self.friction, self.mass, self.subtree_mass, self.inertia, self._solimp, self._solref, self._size, *rest = (
            wp.to_torch(getattr(batched, name)) for name in FIELDS
        )
        place, self._centre, self._joints = rest[:2], rest[2], rest[3:]
        self._nominal_joints = [array[0, :7].clone() for array in self._joints]
        worlds, self._nominal_creep = len(self.mass), float(model.opt.impratio) ** -0.5
        # Of a world's own too, beside the fields of the model.
        batched.opt.impratio_invsqrt = wp.full(
            worlds, self._nominal_creep, dtype=float, device=batched.geom_friction.device
        )
        self._creep = wp.to_torch(batched.opt.impratio_invsqrt)
        self._tips = [geom for geom in range(model.ngeom) if model.geom(geom).name.endswith(f"_{TIP}")]
        self._place, self._tip_place = place, [array[0, self._tips].clone() for array in place]
        self._impedance = _odds_and_width(torch.tensor(model.geom_solimp[:, :3], dtype=torch.float32, device=device))
        self._hard_impedance = _odds_and_width(torch.tensor(HARD.hard.solimp[:3], dtype=torch.float32, device=device))
        self._reference = torch.tensor(model.geom_solref, dtype=torch.float32, device=device)
        self.object_body = model.body(OBJECT).id
        self._object_mass, self._whole_mass = float(model.body_mass[self.object_body]), float(model.body_mass.sum())
        self._object_inertia = torch.tensor(model.body_inertia[self.object_body], dtype=torch.float32, device=device)
        fixed = {"table", *(box.name for box in domain.obstacles)}
        names = [model.geom(geom).name for geom in range(model.ngeom)]
        # Indices of the geoms of the surroundings, of the fingers and of housing and links, and their friction.
        self._rubbing = [
            (torch.tensor(geoms, device=device), torch.tensor(model.geom_friction[geoms, 0]).to(self.friction))
            for geoms in (
                [geom for geom, name in enumerate(names) if name in fixed],
                [geom for geom, name in enumerate(names) if kind_of(name) == "finger"],
                [geom for geom, name in enumerate(names) if kind_of(name) in ("housing", "link")],
            )
        ]
        self._supports = [model.geom(f"{SUPPORT}{axis}").id for axis in range(3)] if supports else []
        self._half_size = torch.tensor(domain.half_size, dtype=torch.float32, device=device)
        self.scale = torch.ones(worlds, 3, device=device)
        self._nominal_centre = torch.tensor(model.body_ipos[self.object_body], dtype=torch.float32, device=device)
        self._object_geom = model.geom(OBJECT).id

    def randomise(
        self,
        where: torch.Tensor,
        table: torch.Tensor,
        finger: torch.Tensor,
        mass: torch.Tensor,
        housing: torch.Tensor | None = None,
    ) -> None:
        """Scale nominal friction of the surroundings, of the fingers and (None: not) of housing and links, and the object's
        mass, by factors (n,)."""
        for (geoms, friction), factor in zip(self._rubbing, (table, finger, housing)):
            if factor is not None:
                self.friction[where[:, None], geoms, 0] = friction * factor[:, None]
        self.mass[where, self.object_body] = self._object_mass * mass
        self.subtree_mass[where, self.object_body] = self._object_mass * mass
        self.subtree_mass[where, 0] = self._whole_mass + self._object_mass * (mass - 1)
        self._turn_inertia(where)

    def resize(self, where: torch.Tensor, scale: torch.Tensor) -> None:
        """Make the object's edges `scale` (n, 3) times as long as nominally, up to LARGEST; it weighs what it weighed.
        What it stands on is as large as ever before `support` is called."""
        self.scale[where] = scale
        self._size[where, self._object_geom] = self._half_size * scale
        for axis, geom in enumerate(self._supports):
            self._size[where, geom] = self._half_size * SUPPORT_SHARE * scale
            self._size[where, geom, axis] = self._half_size[axis] * scale[:, axis] + SUPPORT_PROUD
        self._turn_inertia(where)

    def _turn_inertia(self, where: torch.Tensor) -> None:
        """Inertia about each axis goes by the squares of the two other edges, as a box's does."""
        old, new = self._half_size.square(), (self._half_size * self.scale[where]).square()
        factor = (new.sum(-1, keepdim=True) - new) / (old.sum() - old)
        mass = self.mass[where, self.object_body] / self._object_mass
        self.inertia[where, self.object_body] = self._object_inertia * factor * mass[:, None]

    def shift_centre(self, where: torch.Tensor, share: torch.Tensor) -> None:
        """Put the object's centre of mass shares (n, 3) of its edges, those of now, beside its nominal place."""
        self._centre[where, self.object_body] = self._nominal_centre + 2 * self._half_size * self.scale[where] * share

    def wear(self, where: torch.Tensor, friction: torch.Tensor, damping: torch.Tensor, armature: torch.Tensor) -> None:
        """Scale friction, damping and armature of the arm's joints by factors (n, 7)."""
        for array, nominal, factor in zip(self._joints, self._nominal_joints, (friction, damping, armature)):
            array[where, :7] = nominal * factor

    def stiffen(
        self,
        where: torch.Tensor,
        stiffness: torch.Tensor,
        damping: torch.Tensor,
        time_constant: torch.Tensor | float = 1.0,
        friction: torch.Tensor | float = 1.0,
        onset: torch.Tensor | float = 0.0,
    ) -> None:
        """Scale stiffness, damping ratio and time constant of every contact, and impratio, how much stiffer friction is, by factors (n,).
        onset (n,): share of the way from the model's contacts to HARD, in the logarithms of odds, width and impratio.

        At rest a contact gives way by (1 - d) / d of what it would without its spring's share d of the impedance, so that
        stiffness is scaled by scaling d / (1 - d); the time constant, which sets the step, is a factor of its own.
        """
        onset = onset * torch.ones_like(damping)
        share = onset[:, None, None]
        impedance = self._impedance ** (1 - share) * self._hard_impedance**share
        odds = impedance[..., :2] * stiffness[:, None, None]
        self._solimp[where, :, :2] = odds / (1 + odds)
        self._solimp[where, :, 2] = impedance[..., 2]
        creep = self._nominal_creep ** (1 - onset) * HARD.impratio ** (-0.5 * onset)
        factors = torch.stack([time_constant * torch.ones_like(damping), damping], -1)
        self._solref[where] = self._reference * factors[:, None]
        self._creep[where] = creep * (friction * torch.ones_like(damping)) ** -0.5

    def bend(self, where: torch.Tensor, length: torch.Tensor, turn: torch.Tensor) -> None:
        """Let fingertips reach length (n, 2) m further than the hand's drawing says, and turn them by vectors (n, 2, 3) rad, in the fingers' frames."""
        (position, rotation), (old, before) = self._place, self._tip_place
        position[where[:, None], self._tips, 2] = old[:, 2] + length
        half = torch.cat([torch.ones_like(turn[..., :1]), turn / 2], -1)
        rotation[where[:, None], self._tips] = quaternion_multiply(
            half / half.norm(dim=-1, keepdim=True), before.expand_as(half)
        )

    def support(self, where: torch.Tensor, shares: torch.Tensor) -> None:
        """Let the object stand on the table on patches whose sides are shares (n, 3) of its own."""
        for axis, geom in enumerate(self._supports):
            sides = [k for k in range(3) if k != axis]
            self._size[where[:, None], geom, sides] = (
                self._half_size[sides] * shares[:, sides] * self.scale[where][:, sides]
            )


def _odds_and_width(solimp: torch.Tensor) -> torch.Tensor:
    """MuJoCo's solimp (..., 3) with odds d / (1 - d) in place of its impedances d."""
    return torch.cat([solimp[..., :2] / (1 - solimp[..., :2]), solimp[..., 2:]], -1)
