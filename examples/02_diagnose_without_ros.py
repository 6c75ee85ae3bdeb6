"""The diagnosis as a library, without ROS: an arm of six joints with 0.4 kg in its hand that reports motor currents."""

from pathlib import Path

import mujoco
import numpy as np

from sim2real import diagnose, load_arm, load_log

MODEL = Path(__file__).parent / "arms/six_hinges.xml"
TORQUE_PER_AMPERE = np.array([11.0, 12.0, 10.5, 7.5, 8.0, 7.0])  # Nm/A; the diagnosis does not get them
MASS = 0.4  # kg, at the tool point


def record(path: Path, seconds: float = 80.0) -> None:
    """Simulate the loaded arm under a joint controller and write 200 rows a second of times, joints and currents."""
    spec = mujoco.MjSpec.from_file(str(MODEL))
    load = {"mass": MASS, "ipos": np.zeros(3), "inertia": [1e-9] * 3, "explicitinertial": True}
    spec.body("wrist_3_link").add_body(pos=spec.site("tool").pos.copy(), **load)
    model = spec.compile()
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    data.qpos[:] = posture = [0.2, -0.9, 1.2, -0.5, 0.4, 0.3]
    rate, phase = rng.uniform(0.5, 2.8, (3, 6)), rng.uniform(0, 6.28, (3, 6))  # rad/s, rad
    rows: dict[str, list] = {"t_s": [], "q_rad": [], "dq_rad_s": [], "current_A": []}
    for step in range(int(seconds / model.opt.timestep)):
        t = step * model.opt.timestep
        target = posture + 0.2 * np.sin(rate * t + phase).sum(axis=0)
        torque = 2000 * (target - data.qpos) - 100 * data.qvel
        if step % 5 == 0:
            current = torque / TORQUE_PER_AMPERE + rng.normal(0, 0.004, 6)
            for name, values in zip(rows, (t, data.qpos.copy(), data.qvel.copy(), current)):
                rows[name].append(values)
        data.qfrc_applied[:] = torque
        mujoco.mj_step(model, data)
    np.savez(path, **rows)


if __name__ == "__main__":
    file = Path("loaded.npz")
    record(file)
    arm = load_arm(MODEL, tip="tool")
    diagnosis = diagnose([load_log(file, arm.joints)], arm)
    print(diagnosis.summary())
