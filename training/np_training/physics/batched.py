"""Many copies of the scene on one device: MuJoCo Warp under the impedance law.

One call of `advance` is one policy period: `substeps` physics steps, each with the control law in front, all
in one captured CUDA graph (with effects that have a memory, step by step). PyTorch tensors alias the simulator's arrays, so resets and observations need no
copies.
"""

from __future__ import annotations

import mujoco
import mujoco_warp as mjw
import torch
import warp as wp

from np_description.domains import Task
from np_description.scene import OBJECT, load_model
from np_policy.action import Target
from np_training.physics.batched_contacts import BatchedContacts
from np_training.physics.batched_effects import batched_effects
from np_training.physics.batched_forces import BatchedForces
from np_training.physics.batched_impedance import impedance_kernel, nominal_guards
from np_training.physics.batched_kinematics import forward_kinematics
from np_training.physics.config import LARGEST, PhysicsConfig, check_trainable
from np_training.physics.fused_solver import choose_step
from np_training.physics.varied_model import FIELDS, VariedModel

wp.config.log_level = (
    wp.LOG_WARNING
)  # else a line for each of some fifty modules; `train_stage` reports when all are there
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


class BatchedPhysics:
    """`worlds` copies of a domain's scene.

    qpos (worlds, 16): 7 joints, 2 fingers, object position, object quaternion wxyz; qvel (worlds, 15);
    command (6, worlds, 7), see `impedance_kernel`; delay (worlds,) substeps;
    noise (worlds, 7) Nm; fingers (worlds,) m; over (2, worlds, 7): physics steps of the last period beyond
    the limits of joint velocity, and of torque as commanded; peak (2, worlds, 7): the largest shares of them; margin (worlds,):
    share of the data sheet's joint velocity that counts as the limit, and of its torque; applied (worlds, 7) Nm: torque of the last step; seen_q rad, m, seen_dq (worlds, 9):
    what the sensors measure of joints and fingers; varied: what worlds differ in; forces: what the robot feels. Raises ValueError for an object that is not rigid.
    """

    def __init__(self, domain: Task, worlds: int, device: str, config: PhysicsConfig = PhysicsConfig()) -> None:
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
            self.model = mjw.put_model(model, batch_sizes=dict.fromkeys(FIELDS, worlds))
            data = mujoco.MjData(model)
            mujoco.mj_resetDataKeyframe(model, data, 0)
            mujoco.mj_forward(model, data)
            # Counted by take_overflowed, not printed. Steps short of convergence are the normal case.
            self.model.opt.warn_overflow = 0
            self.varied = VariedModel(self.model, model, domain, config.supports, self.device)
            self.data = mjw.put_data(model, data, nworld=worlds, nconmax=config.contacts, njmax=config.constraints)
            self._solve_step = choose_step(self.model, self.data, config.fused)
            self._command = wp.zeros((6, worlds, 7), dtype=float)
            self._delay = wp.zeros(worlds, dtype=int)
            self._noise = wp.zeros((worlds, 7), dtype=float)
            self._guards = nominal_guards(config.timestep, device)
            self._applied = wp.zeros((worlds, 7), dtype=float)
            self._over = wp.zeros((2, worlds, 7), dtype=int)
            self._peak = wp.zeros((2, worlds, 7), dtype=float)
            self._margin = wp.full(worlds, 1.0, dtype=float)
        d = self.data
        self._overflow = wp.to_torch(d.overflow)
        self.qpos, self.qvel, self.ctrl = (wp.to_torch(a) for a in (d.qpos, d.qvel, d.ctrl))
        self._stale = [wp.to_torch(a) for a in (d.qacc_warmstart, d.qfrc_bias, d.qfrc_gravcomp)]
        self.applied = wp.to_torch(self._applied)
        self.command, self.delay, self.noise, self.over, self.peak, self.margin = (
            wp.to_torch(a) for a in (self._command, self._delay, self._noise, self._over, self._peak, self._margin)
        )
        self._effects = batched_effects(config.effects, config.timestep, device)
        # What the sensors measure of joints and fingers, the input of the control law and the policies; without effects the true state.
        self.seen_q, self.seen_dq = self.qpos[:, :9], self.qvel[:, :9]
        self._seen = [d.qpos, d.qvel]
        if self._effects is not None:
            self.seen_q, self.seen_dq = self.qpos[:, :9].clone(), self.qvel[:, :9].clone()
            self._seen = [wp.from_torch(self.seen_q), wp.from_torch(self.seen_dq)]
            self._extra = wp.to_torch(d.qfrc_applied)
            self._since = torch.zeros(worlds, dtype=torch.long, device=self.device)  # steps since a world was placed
        self.hold(torch.arange(worlds, device=self.device), self.qpos[:, ARM])
        names = [model.geom(geom).name for geom in range(model.ngeom)]
        self.contacts = BatchedContacts(names, self.data, worlds)
        with wp.ScopedDevice(self._wp_device):
            self.forces = BatchedForces(self.data, worlds, config.timestep, names)
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
                self.applied.zero_()
                self.forces.place(torch.arange(self.worlds, device=self.device))
        wp.capture_launch(self._graph)

    def _period(self) -> None:
        for substep in range(self.config.substeps):
            self._command_torque(substep)
            self._solve_step(self.model, self.data)
            self.forces.watch(substep)

    def _command_torque(self, substep: int) -> None:
        d = self.data
        state = [*self._seen, d.qfrc_bias, d.qfrc_gravcomp]
        command = [self._command, self._delay, self._noise, self._margin]
        out = [self._applied, d.ctrl, self._over, self._peak]
        wp.launch(
            impedance_kernel,
            dim=(self.worlds, 7),
            inputs=[substep, self._guards, *state, *command],
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
                self.forces.watch(substep)
                self._since += 1
                self._sense()

    def _step(self) -> None:
        """A physics step that is captured by itself."""
        if not self._wp_device.is_cuda:
            self._solve_step(self.model, self.data)
        elif self._graph is None:
            self._solve_step(self.model, self.data)  # compiles every kernel before the capture
            with wp.ScopedCapture() as capture:
                self._solve_step(self.model, self.data)
            self._graph = capture.graph
        else:
            wp.capture_launch(self._graph)

    @property
    def _is_fresh(self) -> torch.Tensor:
        """Worlds (worlds, 1) that were just placed anew: the memory of their drives and sensors does not fit their state."""
        return (self._since < round(REMEMBERED / self.config.timestep))[:, None]

    def _sense(self) -> None:
        q, dq = self.qpos[:, ARM], self.qvel[:, ARM]
        seen = self._effects.sense(q.clone(), dq.clone(), self.ctrl[:, ARM].clone())
        for kept, truth, reading in zip((self.seen_q, self.seen_dq), (self.qpos, self.qvel), seen):
            kept.copy_(truth[:, :9])
            kept[:, ARM] = torch.where(self._is_fresh, kept[:, ARM], reading)

    def place(self, where: torch.Tensor, qpos: torch.Tensor, sunk: torch.Tensor | float = 0.0) -> None:
        """Put the worlds `where` (n,) at rest at qpos (n, 16), with the obstacles sunk (n,) m below where they are."""
        self.qpos[where] = qpos
        self.qvel[where] = 0
        self.applied[where] = 0
        self.forces.place(where)
        if self._effects is not None:
            self.seen_q[where], self.seen_dq[where], self._since[where] = qpos[:, :9], 0.0, 0
        for array in self._stale:  # of the state before: solver warm start and Coriolis terms
            array[where] = 0
        for geom, height in self._obstacles.items():
            self._geom_position[where, geom, 2] = height - sunk

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
