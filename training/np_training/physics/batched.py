"""Many copies of the scene on one device: MuJoCo Warp under the impedance law, or in operational space.

One call of `advance` is one policy period: `substeps` physics steps, each with the control law in front, all
in one captured CUDA graph (with effects that have a memory, step by step). PyTorch tensors alias the simulator's arrays, so resets and observations need no
copies.
"""

from __future__ import annotations

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp

from np_control.operational_space import chosen_gains
from np_description.domains import Domain
from np_description.panda import NOMINAL
from np_description.penetration import kind_of
from np_description.rotations import quaternion_from_matrix, quaternion_multiply, xyzw_from_wxyz
from np_description.scene import OBJECT, SUPPORT, SUPPORT_PROUD, SUPPORT_SHARE, TIP, load_model
from np_policy.action import Target
from np_training.physics.batched_contacts import BatchedContacts
from np_training.physics.batched_effects import batched_effects
from np_training.physics.batched_kinematics import forward_kinematics
from np_training.physics.batched_operational_space import make_gains, operational_space_kernel, watch_share
from np_training.physics.chain import make_chain
from np_training.physics.config import LARGEST, PhysicsConfig, check_trainable

# A body's mass has to change together with that of its subtree, which centres of mass are divided by.
RANDOMISED = (
    "geom_friction",
    "body_mass",
    "body_subtreemass",
    "body_inertia",
    "geom_solimp",
    "geom_solref",
    "geom_size",
    "geom_pos",
    "geom_quat",
)
CAPACITY = (
    mjw.OverflowType.NEFC
    | mjw.OverflowType.NJMAX_NNZ
    | mjw.OverflowType.BROADPHASE
    | mjw.OverflowType.NARROWPHASE
    | mjw.OverflowType.CCD
)
REMEMBERED = 0.05  # s, after which drives and sensors have forgotten an episode before: the largest delay of theirs
HOLD_STIFFNESS, HOLD_DAMPING_RATIO = 100.0, 1.0  # while an episode's first target is on its way
ARM, OBJECT_POSITION, OBJECT_QUATERNION = slice(0, 7), slice(9, 12), slice(12, 16)


@wp.kernel
def impedance_kernel(
    substep: int,
    limit: wp.array2d(dtype=float),
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    bias: wp.array2d(dtype=float),
    gravity: wp.array2d(dtype=float),
    command: wp.array3d(dtype=float),
    delay: wp.array(dtype=int),
    noise: wp.array2d(dtype=float),
    margin: wp.array(dtype=float),
    ctrl: wp.array2d(dtype=float),
    over: wp.array3d(dtype=int),
    peak: wp.array3d(dtype=float),
):
    """np_control.impedance.torque for joint j of world i; a test holds both to the same result.

    command (6, worlds, 7): joint target, stiffness, damping ratio of the last period, then of this one, which
    takes effect after `delay` substeps. limit (2, 7): of velocity and torque; margin (worlds,): share of them that is allowed:
    torque is cut there; over, peak (2, worlds, 7): substeps of this period with a velocity beyond its margin, or a torque beyond its limit before the
    cut, and the largest shares of the limits. Reckoned in double precision: in single, 80 Nm come out up to 2e-5 Nm off.
    """
    i, j = wp.tid()
    new = 0
    if substep >= delay[i]:
        new = 3
    stiffness = wp.float64(command[new + 1, i, j])
    damping = wp.float64(command[new + 2, i, j]) * wp.sqrt(stiffness)
    error = wp.float64(command[new, i, j]) - wp.float64(qpos[i, j])
    coriolis = wp.float64(bias[i, j]) - wp.float64(gravity[i, j])
    wanted = stiffness * error - damping * wp.float64(qvel[i, j]) + coriolis + wp.float64(noise[i, j])
    torque = wp.float32(wanted)
    watch_share(substep, 0, i, j, wp.abs(qvel[i, j]) / limit[0, j], margin[i], over, peak)
    watch_share(substep, 1, i, j, wp.abs(torque) / limit[1, j], 1.0, over, peak)
    most = margin[i] * limit[1, j]
    ctrl[i, j] = wp.clamp(torque, -most, most)


class BatchedPhysics:
    """`worlds` copies of a domain's scene.

    qpos (worlds, 16): 7 joints, 2 fingers, object position, object quaternion wxyz; qvel (worlds, 15);
    command (6, worlds, 7), see `impedance_kernel` and `operational_space_kernel`; delay (worlds,) substeps;
    noise (worlds, 7) Nm; fingers (worlds,) m; over (2, worlds, 7): physics steps of the last period beyond
    the limits of joint velocity, and of torque as commanded; peak (2, worlds, 7): the largest shares of them; margin (worlds,):
    share of the data sheet's joint velocity that counts as the limit, and of its torque; seen_q rad, m, seen_dq (worlds, 9):
    what the sensors say of joints and fingers; scale (worlds,): size of the object, as `resize` has it. Raises ValueError for an object that is not rigid.
    """

    def __init__(self, domain: Domain, worlds: int, device: str, config: PhysicsConfig = PhysicsConfig()) -> None:
        check_trainable(domain)
        self.config, self.worlds, self.device = config, worlds, torch.device(device)
        panda = config.effects.panda()
        model = load_model(
            domain,
            timestep=config.timestep,
            arm_collision=False,
            panda=panda,
            contact=config.contact,
            supports=config.supports,
            change=config.effects.scene_change(),
        )
        model.opt.iterations, model.opt.ls_iterations = config.iterations, config.ls_iterations
        # Boxes then meet by their faces and edges, as in MuJoCo itself, not by the general convex algorithm, which takes
        # three to five times as long.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_NATIVECCD
        if config.resizes:  # bounds, beyond which no contact is looked for, have to hold the largest object that comes
            own = model.geom_bodyid == model.body(OBJECT).id
            model.geom_rbound[own] *= LARGEST
            model.geom_aabb[own] *= LARGEST
        self.host_model = model
        self._wp_device = wp.get_device(device)
        if self._wp_device.is_cuda:
            # A captured graph holds the work of one stream: torch has to queue on Warp's.
            torch.cuda.set_stream(wp.stream_to_torch(wp.get_stream(self._wp_device)))
        with wp.ScopedDevice(self._wp_device):
            self.model = mjw.put_model(model, batch_sizes=dict.fromkeys(RANDOMISED, worlds))
            data = mujoco.MjData(model)
            mujoco.mj_resetDataKeyframe(model, data, 0)
            mujoco.mj_forward(model, data)
            # Counted by take_overflowed, not printed. Steps short of convergence are the normal case.
            self.model.opt.warn_overflow = 0
            # Of a world's own too, beside the fields of the model.
            self.model.opt.impratio_invsqrt = wp.full(worlds, float(model.opt.impratio) ** -0.5, dtype=float)
            self.data = mjw.put_data(model, data, nworld=worlds, nconmax=config.contacts, njmax=config.constraints)
            self._command = wp.zeros((6, worlds, 7), dtype=float)
            self._delay = wp.zeros(worlds, dtype=int)
            self._noise = wp.zeros((worlds, 7), dtype=float)
            self._limit = wp.array(np.stack([NOMINAL.velocity_limit, NOMINAL.torque_limit]), dtype=float)
            self._over = wp.zeros((2, worlds, 7), dtype=int)
            self._peak = wp.zeros((2, worlds, 7), dtype=float)
            self._margin = wp.full(worlds, 1.0, dtype=float)
            self._chain = make_chain(self._wp_device.alias)
            self._gains = make_gains(model.M_rowadr[ARM], self._wp_device)
        d = self.data
        self._overflow = wp.to_torch(d.overflow)
        self.qpos, self.qvel, self.ctrl = (wp.to_torch(a) for a in (d.qpos, d.qvel, d.ctrl))
        self._stale = [wp.to_torch(a) for a in (d.qacc_warmstart, d.qfrc_bias, d.qfrc_gravcomp)]
        self.command, self.delay, self.noise, self.over, self.peak, self.margin = (
            wp.to_torch(a) for a in (self._command, self._delay, self._noise, self._over, self._peak, self._margin)
        )
        self._effects = batched_effects(config.effects, config.timestep, device)
        # What the sensors say of joints and fingers, which the control law and the policies go by: the truth itself without them.
        self.seen_q, self.seen_dq = self.qpos[:, :9], self.qvel[:, :9]
        self._seen = [d.qpos, d.qvel]
        if self._effects is not None:
            self.seen_q, self.seen_dq = self.qpos[:, :9].clone(), self.qvel[:, :9].clone()
            self._seen = [wp.from_torch(self.seen_q), wp.from_torch(self.seen_dq)]
            self._extra = wp.to_torch(d.qfrc_applied)
            self._since = torch.zeros(worlds, dtype=torch.long, device=self.device)  # steps since a world was placed
        self.hold(torch.arange(worlds, device=self.device), self.qpos[:, ARM])
        self.friction, self.mass, self.subtree_mass, self.inertia, self._solimp, self._solref, self._size, *place = (
            wp.to_torch(getattr(self.model, name)) for name in RANDOMISED
        )
        self._creep = wp.to_torch(self.model.opt.impratio_invsqrt)
        self._tips = [geom for geom in range(model.ngeom) if model.geom(geom).name.endswith(f"_{TIP}")]
        self._place, self._tip_place = place, [array[0, self._tips].clone() for array in place]
        self._impedance = torch.tensor(model.geom_solimp[:, :2], dtype=torch.float32, device=self.device)
        self._reference = torch.tensor(model.geom_solref, dtype=torch.float32, device=self.device)
        self._nominal_creep = float(model.opt.impratio) ** -0.5
        self.object_body = model.body(OBJECT).id
        self._object_mass, self._whole_mass = float(model.body_mass[self.object_body]), float(model.body_mass.sum())
        self._object_inertia = torch.tensor(
            model.body_inertia[self.object_body], dtype=torch.float32, device=self.device
        )
        fixed = {"table", *(box.name for box in domain.obstacles)}
        names = [model.geom(geom).name for geom in range(model.ngeom)]
        # Indices of the geoms of the surroundings, of the fingers and of housing and links, and their friction.
        self._rubbing = [
            (torch.tensor(geoms, device=self.device), torch.tensor(model.geom_friction[geoms, 0]).to(self.friction))
            for geoms in (
                [geom for geom, name in enumerate(names) if name in fixed],
                [geom for geom, name in enumerate(names) if kind_of(name) == "finger"],
                [geom for geom, name in enumerate(names) if kind_of(name) in ("housing", "link")],
            )
        ]
        self._supports = [model.geom(f"{SUPPORT}{axis}").id for axis in range(3)] if config.supports else []
        self._half_size = torch.tensor(domain.half_size, dtype=torch.float32, device=self.device)
        self.scale = torch.ones(worlds, device=self.device)
        self._object_geom = model.geom(OBJECT).id
        self.contacts = BatchedContacts(names, self.data, worlds)
        # Where fixed geoms are in the world is worked out once, when the data are made: it may be moved there.
        self._geom_position, self._geom_rotation = wp.to_torch(d.geom_xpos), wp.to_torch(d.geom_xmat)
        self._obstacles = {model.geom(box.name).id: box.centre[2] for box in domain.obstacles}
        self._graph = None

    @property
    def fingers(self) -> torch.Tensor:
        """Commanded finger openings (worlds, 2) m."""
        return self.ctrl[:, 7:9]

    @property
    def geoms(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Positions (worlds, geoms, 3) m and rotations (worlds, geoms, 3, 3) of the scene's geoms, at the last physics step's beginning."""
        return self._geom_position, self._geom_rotation

    def hold(self, where: torch.Tensor, q: torch.Tensor) -> None:
        """Command the worlds `where` (n,) to stay at joints q (n, 7) rad, now and in the period to come."""
        gains = torch.full_like(q, HOLD_STIFFNESS), torch.full_like(q, HOLD_DAMPING_RATIO)
        rows = self._rows(q, Target(*forward_kinematics(q), *gains))
        self.command[:, where] = torch.cat([rows, rows])

    def aim(self, joints: torch.Tensor, target: Target) -> None:
        """Command of a new period: `target` of every world, and the joints (worlds, 7) rad that solve it."""
        self.command[:3] = self.command[3:].clone()
        self.command[3:] = self._rows(joints, target)

    def _rows(self, joints: torch.Tensor, target: Target) -> torch.Tensor:
        if self.config.controller == "osc":
            pose = torch.cat([target.position, xyzw_from_wxyz(quaternion_from_matrix(target.rotation))], -1)
            return torch.stack([joints, pose, chosen_gains(target.stiffness, target.damping_ratio)])
        return torch.stack([joints, target.stiffness, target.damping_ratio])

    def advance(self) -> None:
        """One policy period under the current commands."""
        if self._effects is not None:
            self._advance_with_effects()
            return
        if not self._wp_device.is_cuda:
            with wp.ScopedDevice(self._wp_device):
                self._period()
            return
        if self._graph is None:
            with wp.ScopedDevice(self._wp_device):
                saved = self.qpos.clone(), self.qvel.clone()
                self._period()  # compiles every kernel before the capture
                with wp.ScopedCapture() as capture:
                    self._period()
                self._graph = capture.graph
                self.qpos.copy_(saved[0])
                self.qvel.copy_(saved[1])
        wp.capture_launch(self._graph)

    def _period(self) -> None:
        for substep in range(self.config.substeps):
            self._command_torque(substep)
            mjw.step(self.model, self.data)

    def _command_torque(self, substep: int) -> None:
        d = self.data
        state = [*self._seen, d.qfrc_bias, d.qfrc_gravcomp]
        command = [self._command, self._delay, self._noise, self._margin]
        out = [d.ctrl, self._over, self._peak]
        if self.config.controller == "osc":
            wp.launch(
                operational_space_kernel,
                dim=self.worlds,
                inputs=[substep, self._chain, self._gains, self._limit, *state, d.M, *command],
                outputs=out,
            )
        else:
            wp.launch(
                impedance_kernel,
                dim=(self.worlds, 7),
                inputs=[substep, self._limit, *state, *command],
                outputs=out,
            )

    def _advance_with_effects(self) -> None:
        """A period in which what is commanded, felt and measured passes through the effects; the step alone is captured."""
        effects, q, dq, ctrl = self._effects, self.qpos[:, ARM], self.qvel[:, ARM], self.ctrl[:, ARM]
        with wp.ScopedDevice(self._wp_device):
            for substep in range(self.config.substeps):
                self._command_torque(substep)
                ctrl.copy_(torch.where(self._is_fresh, ctrl, effects.drive(ctrl, q)))
                self._extra[:, ARM] = effects.extra(q, dq)
                self._step()
                self._since += 1
                self._sense()

    def _step(self) -> None:
        """A physics step that is captured by itself."""
        if not self._wp_device.is_cuda:
            mjw.step(self.model, self.data)
        elif self._graph is None:
            mjw.step(self.model, self.data)  # compiles every kernel before the capture
            with wp.ScopedCapture() as capture:
                mjw.step(self.model, self.data)
            self._graph = capture.graph
        else:
            wp.capture_launch(self._graph)

    @property
    def _is_fresh(self) -> torch.Tensor:
        """Worlds (worlds, 1) that drives and sensors remember otherwise than they are: they were just placed anew."""
        return (self._since < round(REMEMBERED / self.config.timestep))[:, None]

    def _sense(self) -> None:
        q, dq = self.qpos[:, ARM], self.qvel[:, ARM]
        seen = self._effects.sense(q.clone(), dq.clone(), self.ctrl[:, ARM].clone())
        for kept, truth, said in zip((self.seen_q, self.seen_dq), (self.qpos, self.qvel), seen):
            kept.copy_(truth[:, :9])
            kept[:, ARM] = torch.where(self._is_fresh, kept[:, ARM], said)

    def place(self, where: torch.Tensor, qpos: torch.Tensor, sunk: torch.Tensor | float = 0.0) -> None:
        """Put the worlds `where` (n,) at rest at qpos (n, 16), with the obstacles sunk (n,) m below where they are."""
        self.qpos[where] = qpos
        self.qvel[where] = 0
        if self._effects is not None:
            self.seen_q[where], self.seen_dq[where], self._since[where] = qpos[:, :9], 0.0, 0
        for array in self._stale:  # of the state before: solver warm start and Coriolis terms
            array[where] = 0
        for geom, height in self._obstacles.items():
            self._geom_position[where, geom, 2] = height - sunk

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
        """Make the object `scale` (n,) times as large as it is nominally, up to LARGEST; it weighs what it weighed.
        What it stands on is as large as ever before `support` is called."""
        self.scale[where] = scale
        self._size[where, self._object_geom] = self._half_size * scale[:, None]
        for axis, geom in enumerate(self._supports):
            self._size[where, geom] = self._half_size * SUPPORT_SHARE * scale[:, None]
            self._size[where, geom, axis] = self._half_size[axis] * scale + SUPPORT_PROUD
        self._turn_inertia(where)

    def _turn_inertia(self, where: torch.Tensor) -> None:
        factor = self.mass[where, self.object_body] / self._object_mass * self.scale[where].square()
        self.inertia[where, self.object_body] = self._object_inertia * factor[:, None]

    def stiffen(
        self,
        where: torch.Tensor,
        stiffness: torch.Tensor,
        damping: torch.Tensor,
        time_constant: torch.Tensor | float = 1.0,
        friction: torch.Tensor | float = 1.0,
    ) -> None:
        """Scale stiffness, damping ratio and time constant of every contact, and impratio, how much stiffer friction is, by factors (n,).

        At rest a contact gives way by (1 - d) / d of what it would without its spring's share d of the impedance, so that
        stiffness is scaled by scaling d / (1 - d); the time constant, which sets the step, is a factor of its own.
        """
        odds = self._impedance / (1 - self._impedance) * stiffness[:, None, None]
        self._solimp[where, :, :2] = odds / (1 + odds)
        factors = torch.stack([time_constant * torch.ones_like(damping), damping], -1)
        self._solref[where] = self._reference * factors[:, None]
        self._creep[where] = self._nominal_creep * (friction * torch.ones_like(damping)) ** -0.5

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
                self._half_size[sides] * shares[:, sides] * self.scale[where, None]
            )

    def take_overflowed(self) -> torch.Tensor:
        """Number () of worlds that lacked room for a contact or a constraint since the last call: these were
        dropped."""
        count = ((self._overflow & int(CAPACITY)) != 0).sum()
        self._overflow.zero_()
        return count

    def overflow(self) -> dict[str, int]:
        """Contacts and constraints in use now against capacity."""
        return {
            "contacts": int(self.data.nacon.numpy()[0]),
            "contact_capacity": self.data.naconmax,
            "constraints": int(self.data.nefc.numpy().max()),
            "constraint_capacity": self.data.njmax,
        }
