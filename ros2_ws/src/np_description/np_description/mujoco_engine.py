"""The engine of `sim_bridge`: MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np

from np_description.camera import CAMERA, Camera
from np_description.contact.depths import PUSHERS
from np_description.contact.model import ContactModel
from np_description.contact.penetration import kind_of
from np_description.control_rate import PERIOD_NS, SECOND
from np_description.domains import Pose, Task
from np_description.panda import JOINT_NAMES, NOMINAL, STATE_NAMES, PandaModel
from np_description.scene import OBJECT, load_model
from np_description.scene_change import UNCHANGED, SceneChange

DIVERGED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)


class MujocoEngine:
    """An Engine of MuJoCo; arguments as for MakeEngine. contact: how rough and how hard everything is; default: the domain's."""

    def __init__(
        self,
        domain: Task,
        *,
        substeps: int = 1,
        camera: Camera = CAMERA,
        panda: PandaModel = NOMINAL,
        contact: ContactModel | None = None,
        change: SceneChange = UNCHANGED,
    ):
        timestep = PERIOD_NS / SECOND / substeps
        self.model = load_model(domain, timestep=timestep, camera=camera, panda=panda, contact=contact, change=change)
        self.data = data = mujoco.MjData(self.model)
        # Views of MuJoCo's own memory: making one costs as much as reading it.
        self._qpos, self._qvel, self._drive = data.qpos, data.qvel, data.qfrc_actuator
        self._ctrl, self._applied, self._warnings = data.ctrl, data.qfrc_applied, data.warning.number
        self._substeps = substeps
        joints = [self.model.joint(name) for name in STATE_NAMES]
        self._position = np.array([joint.qposadr[0] for joint in joints])
        self._velocity = np.array([joint.dofadr[0] for joint in joints])
        self._motors = np.array([self.model.actuator(name).id for name in JOINT_NAMES])
        self._fingers = np.array([self.model.actuator(name).id for name in STATE_NAMES[len(JOINT_NAMES) :]])
        self._arm = self._velocity[: len(JOINT_NAMES)]
        self._object = int(self.model.joint(OBJECT).qposadr[0])
        self._kinds = [kind_of(self.model.geom(geom).name) for geom in range(self.model.ngeom)]

    def reset(self, start: Pose) -> None:
        """As in Engine."""
        mujoco.mj_resetDataKeyframe(self.model, self.data, self.model.key("ready").id)
        self.data.qpos[self._object : self._object + 7] = [*start.position, *start.quaternion]

    def place(self, position: np.ndarray, velocity: np.ndarray | float = 0.0) -> None:
        """Put the arm's joints at (7,) rad, with a velocity (7,) rad/s."""
        self.data.qpos[self._position[: len(JOINT_NAMES)]] = position
        self.data.qvel[self._arm] = velocity
        mujoco.mj_forward(self.model, self.data)

    def joints(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As in Engine."""
        return self._qpos.take(self._position), self._qvel.take(self._velocity), self._drive.take(self._velocity)

    def object_pose(self) -> Pose:
        """As in Engine."""
        pose = self.data.qpos[self._object : self._object + 7].copy()
        return Pose(pose[:3], pose[3:])

    def configuration(self) -> np.ndarray:
        """As in Engine."""
        return self.data.qpos.copy()

    def pressing(self) -> dict[str, float]:
        """As in Engine."""
        found: dict[str, float] = {}
        force = np.zeros(6)
        for number, contact in enumerate(self.data.contact):
            mujoco.mj_contactForce(self.model, self.data, number, force)
            for kind in {self._kinds[geom] for geom in contact.geom} & {*PUSHERS}:
                found[kind] = found.get(kind, 0.0) + float(np.linalg.norm(force[:3]))
        return found

    def step(self, torque: np.ndarray, extra: np.ndarray, opening: float) -> None:
        """As in Engine; the text is MuJoCo's warning."""
        self._ctrl[self._motors], self._ctrl[self._fingers] = torque, opening
        self._applied[self._arm] = extra
        mujoco.mj_step(self.model, self.data, self._substeps)
        for warning in DIVERGED:
            # On these MuJoCo resets the scene to its default, which would pass for a measurement.
            if self._warnings[warning]:
                raise FloatingPointError(warning.name)
