"""The closed loop at 500 Hz: what arms do with the suite's targets under impedance control, as recorded.

The impedance law, the gains' slew and the torque guards are those of np_control; sensing, delays and noise
are here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from sim2real.excitation.suite import READY, Segment, end_stamp, schedule_starts

from np_blind.arm.plant.blind_arm import PERIOD, BatchedArms
from np_blind.arm.plant.physics import Physics
from np_blind.arm.plant.rigid_arm import JOINTS
from np_blind.arm.plant.unknown_fault_physics import eccentric_encoder_error, encoder_slip
from np_blind.arm.plant.unknown_fault_physics_wide import measured_speed
from np_control.impedance import torque as impedance_torque
from np_control.impedance import velocity_feedforward_offset
from np_control.safety import LIMITS, limit_torque, slew_gains

WRIST = np.array([1, 1, 1, 1, 0.4, 0.4, 0.3])
ANGLE_NOISE = 1e-5  # rad
SPEED_NOISE = 1.5e-3  # rad/s
TORQUE_NOISE = 0.03  # Nm, white, and as much again that is correlated over COLOUR s
COLOUR = 0.08
CHUNK = 500  # periods of noise drawn at a time
HISTORY = 8  # periods over which a measurement may be late
RUNAWAY = 20.0  # rad/s, ten times what the guards of any joint allow
SETTLING = 1_000_000_000  # ns at rest before the plan


class Diverged(RuntimeError):
    """Arms that ran away. arms: their rows in the batch; time_s: of the run."""

    def __init__(self, arms: tuple[int, ...], time_s: float):
        super().__init__(arms, time_s)
        self.arms, self.time_s = arms, time_s

    def __str__(self) -> str:
        return f"arms {self.arms} of the batch were faster than {RUNAWAY:g} rad/s after {self.time_s:.3f} s"


@dataclass(frozen=True, eq=False)
class Targets:
    """What the controller receives at each period: (n, 7) rad, rad/s, rad/s^2, gains (n, 2, 7).

    Before row `first` the arm is held where it was found. starts: stamps, ns, of the segments of `plan`.
    """

    plan: tuple[Segment, ...]
    starts: tuple[int, ...]
    first: int
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    gains: np.ndarray

    def __len__(self) -> int:
        return len(self.position)

    def until(self, seconds: float) -> Targets:
        """The targets of its first `seconds`."""
        rows = slice(int(min(seconds / LIMITS.period, len(self))))
        names = ("position", "velocity", "acceleration", "gains")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})


def make_targets(plan: Sequence[Segment]) -> Targets:
    """The targets of a plan, sampled as the controller samples its trajectories."""
    starts = schedule_starts(plan, SETTLING)
    count = end_stamp(plan, SETTLING) // LIMITS.period_ns
    position = np.tile(plan[0].positions[0], (count, 1))
    velocity, acceleration = np.zeros_like(position), np.zeros_like(position)
    own = plan[0].gains  # before the first segment too
    wanted = np.tile(own, (count, 1, 1))
    for segment, start in zip(plan, starts):
        begin = start // LIMITS.period_ns
        trajectory = segment.trajectory
        for row in range(begin, count):
            elapsed = (row - begin) * LIMITS.period
            position[row], velocity[row], acceleration[row] = trajectory.sample_with_acceleration(elapsed)
            if elapsed >= trajectory.duration:
                break
        position[row:], wanted[begin:] = position[row], segment.gains
    gains, now = np.empty_like(wanted), own
    for row in range(count):
        if not np.array_equal(now, wanted[row]):
            now = slew_gains(LIMITS, now, wanted[row], LIMITS.period)
        gains[row] = now
    first = starts[0] // LIMITS.period_ns
    return Targets(tuple(plan), tuple(starts), first, position, velocity, acceleration, gains)


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """Recordings of B arms, all (n, B, 7): measured position, velocity and effort; angle and speed of the
    motors; target position and velocity; command, of the state with the same row; applied: what the backend's
    guards let through, held from lost packets on.
    """

    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    motor_position: np.ndarray
    motor_velocity: np.ndarray
    target: np.ndarray
    target_velocity: np.ndarray
    command: np.ndarray
    applied: np.ndarray


def run(
    physics: Physics,
    targets: Targets,
    seeds: Sequence[Sequence[int]] | None,
    progress: Callable[[int], None] = lambda _: None,
) -> RecordedRun:
    """Move the arms through the targets. seeds: of each arm's noise; None for sensors without any.

    progress(row) is called now and then. Raises Diverged.
    """
    arms, count = len(physics), len(targets)
    roots = seeds if seeds is not None else [[i] for i in range(arms)]
    streams, chances = ([np.random.default_rng([*root, k]) for root in roots] for k in (1, 2))
    plant = BatchedArms(physics, READY, chances)
    sensors = Sensors(physics, streams if seeds is not None else None)
    keep = (
        1.0 if not physics.filter_time.any() else 1.0 - np.exp(-PERIOD / np.maximum(physics.filter_time, 1e-9))[:, None]
    )
    record = RecordedRun(*(np.empty((count, arms, JOINTS)) for _ in range(9)))
    torque = filtered = np.zeros((arms, JOINTS))
    for row in range(count):
        q, dq, effort, theta, omega = sensors.read(plant)
        safe = np.abs(dq) < RUNAWAY  # not so where it is not a number
        if not safe.all():
            raise Diverged(tuple(np.flatnonzero(~safe.all(axis=1)).tolist()), plant.time)
        if row == 0:
            held = np.clip(q, LIMITS.position_lower, LIMITS.position_upper)
        target = held if row < targets.first else np.broadcast_to(targets.position[row], q.shape)
        velocity, acceleration = targets.velocity[row], targets.acceleration[row]
        stiffness, ratio = targets.gains[row]
        matrix, coriolis = plant.begin(q, dq)
        feedforward = coriolis + matrix @ acceleration
        kp = stiffness * physics.stiffness_factor
        rho = ratio * physics.damping_factor / np.sqrt(physics.stiffness_factor)
        wanted = impedance_torque(
            q, dq, velocity_feedforward_offset(target, velocity, stiffness, ratio), kp, rho, feedforward
        )
        filtered = filtered + keep * (wanted - filtered)
        torque, _ = limit_torque(LIMITS, filtered, torque, q, dq)
        applied = plant.step(torque)
        for name, values in (
            ("position", q),
            ("velocity", dq),
            ("effort", effort),
            ("motor_position", theta),
            ("motor_velocity", omega),
            ("target", target),
            ("target_velocity", velocity),
            ("command", torque),
            ("applied", applied),
        ):
            getattr(record, name)[row] = values
        if row % 500 == 0:
            progress(row)
    return record


def run_stable_arms(
    physics: Physics, targets: Targets, seeds: Sequence[Sequence[int]] | None
) -> tuple[RecordedRun | None, list[int], dict[int, float]]:
    """(recording of the arms that stay, their rows in `physics`, s after which each other row ran away).

    An arm that runs away leaves the others as they are; None where all do. Arguments as of `run`.
    """
    staying, lost = list(range(len(physics))), {}
    while staying:
        try:
            own = None if seeds is None else [seeds[arm] for arm in staying]
            return run(physics.take(staying), targets, own), staying, lost
        except Diverged as error:
            lost |= {staying[row]: error.time_s for row in error.arms}
            staying = [arm for row, arm in enumerate(staying) if row not in error.arms]
    return None, [], lost


class Sensors:
    """What the sensors of the arms show at the beginning of a period: late, biased, rounded, noisy.

    streams: of each arm's noise; None for none. torque_noise (7,) Nm, white, and as much again over COLOUR s.
    """

    def __init__(
        self,
        physics: Physics,
        streams: list[np.random.Generator] | None,
        torque_noise: np.ndarray = TORQUE_NOISE * WRIST,
    ):
        self._physics, self._streams, self._torque_noise = physics, streams, torque_noise
        arms, self._joints = physics.inertials.mass.shape
        self._past: list[tuple[np.ndarray, np.ndarray]] = []
        self._row = 0
        self._slow = np.zeros((arms, self._joints))
        self._noise = np.zeros((CHUNK, arms, 5, self._joints))

    def read(self, plant: BatchedArms) -> tuple[np.ndarray, ...]:
        """(angle, speed, effort, motor angle, motor speed), each (B, 7)."""
        p = self._physics
        q, dq, theta, omega = self._late(plant)
        noise = self._draw()
        angle, share = eccentric_encoder_error(p, q)
        angle = angle + encoder_slip(p, plant.time)
        q, dq = q + p.encoder_bias + angle + ANGLE_NOISE * noise[:, 0], measured_speed(p, dq) * (1.0 + share)
        q = np.where(p.quantum > 0, np.round(q / np.maximum(p.quantum, 1e-9)) * p.quantum, q)
        dq = dq + SPEED_NOISE * noise[:, 1]
        keep = np.exp(-PERIOD / COLOUR)
        self._slow = keep * self._slow + np.sqrt(1 - keep**2) * noise[:, 2]
        effort = plant.torque + self._torque_noise * (noise[:, 3] + self._slow)
        return q, dq, effort, theta + ANGLE_NOISE * noise[:, 4], omega + SPEED_NOISE * noise[:, 1]

    def _late(self, plant: BatchedArms) -> tuple[np.ndarray, ...]:
        """Angle and speed of links, then of motors, `measurement_delay` ago."""
        delay = self._physics.measurement_delay
        if not delay.any():
            return plant.q, plant.dq, plant.theta, plant.omega
        state = np.hstack([plant.q, plant.theta]), np.hstack([plant.dq, plant.omega])
        self._past = [*self._past[-HISTORY:], state]
        periods = np.minimum(delay / PERIOD, len(self._past) - 1)
        whole = np.floor(periods).astype(int)
        part = (periods - whole)[:, None]
        angles, speeds = (np.array([state[k] for state in self._past[::-1]]) for k in (0, 1))
        rows, older = np.arange(len(delay)), np.minimum(whole + 1, len(self._past) - 1)
        speed = (1 - part) * speeds[whole, rows] + part * speeds[older, rows]
        n = self._joints
        # Back along the mean speed from the sample that follows.
        angle = angles[whole, rows] - 0.5 * (speeds[whole, rows] + speed) * part * PERIOD
        return angle[:, :n], speed[:, :n], angle[:, n:], speed[:, n:]

    def _draw(self) -> np.ndarray:
        """Noise (B, 5, 7) of unit variance, times the arm's own level."""
        if self._streams is None:
            return self._noise[0]
        row = self._row % CHUNK
        if row == 0:
            draws = [stream.standard_normal((CHUNK, 5, self._joints)) for stream in self._streams]
            self._noise = self._physics.noise[None, :, None, None] * np.stack(draws, axis=1)
        self._row += 1
        return self._noise[row]
