"""A slow push of a flat object: force and moment of the table's friction from the object's own motion.

Friction of a plane contact is normal to a limit surface in the space of force and moment (Goyal, Ruina and Papadopoulos,
Wear 1991); an ellipsoid comes near it (Howe and Cutkosky, IJRR 1996), and with it a push is quasi-static as by Lynch and Mason
(IJRR 1996). Convex polynomials are closer for a few points of support (Zhou et al., ICRA 2016); how far the ellipsoid is from
four corners is asked in the tests. Nothing here needs the mass: the table's friction is one force, mu m g, unless the object
is accelerated by more than a small share of mu g.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.task.pushing import Windows
from sim2real.thresholds import THRESHOLDS

MODEL = THRESHOLDS.push_model
CHANNELS = ("force", "direction", "moment", "touch", "tip")


@dataclass(frozen=True)
class Pushed:
    """What a slow push depends on; pairs are x, y. The object is a square block whose frame has its axes along the sides.

    friction: N, force of sliding friction without rotation. support: radius of the limit surface over the side of the block, .30 to
    .72 between a patch and four corners (.383: uniform pressure). tip_friction: coefficient of tip on block. half_side: m.
    centre: m, of friction, from the middle of the block. anisotropy: half the relative difference of friction along and across
    the table's x axis, and along and across its diagonal. speed: d log(friction) / d log(speed). place: 1/m, gradient of
    log(friction) over the table.

    What is not the object's: marker: m, middle of the block in the tracked frame. heading: rad, of the block in it. registration:
    m, what the tip's position lacks in the world's frame. sensor_turn: rad, of the force about the vertical. bias: N, left on it.
    """

    friction: float = 1.0
    support: float = 0.46
    tip_friction: float = 0.25
    half_side: float = 0.05
    centre: tuple[float, float] = (0.0, 0.0)
    anisotropy: tuple[float, float] = (0.0, 0.0)
    speed: float = 0.0
    place: tuple[float, float] = (0.0, 0.0)
    marker: tuple[float, float] = (0.0, 0.0)
    heading: float = 0.0
    registration: tuple[float, float] = (0.0, 0.0)
    sensor_turn: float = 0.0
    bias: tuple[float, float] = (0.0, 0.0)


def wrench(pushed: Pushed, velocity: np.ndarray, rate: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force (w, 2) N and moment (w,) Nm about the centre of friction that keep a block going.

    velocity (w, 2) m/s of that centre and rate (w,) rad/s, in the table's frame; along (w,): factor of friction there and then.
    """
    (a, b), (x, y) = pushed.anisotropy, velocity.T
    radius = 2 * pushed.half_side * pushed.support
    pull = np.column_stack([(1 + 2 * a) * x + 2 * b * y, 2 * b * x + (1 - 2 * a) * y])
    size = np.sqrt(np.maximum((velocity * pull).sum(axis=1), 0) + (radius * rate) ** 2) + 1e-12
    level = pushed.friction * along / size
    return level[:, None] * pull, level * radius**2 * rate


def residuals(pushed: Pushed, seen: Windows) -> np.ndarray:
    """What a push shows beyond the model, (w, 5) in the order of CHANNELS. Numbers of `pushed` may be of each window, (w,).

    force: log of measured over predicted force. direction: rad, of measured from predicted force. moment: m, by how much the
    predicted force passes the place where it would turn the block as it turns. touch: m, from the tip's surface to the face.
    tip: rad, of measured force to the edge of the tip's cone of friction where the tip slides, beyond it where it sticks.
    """
    heading = seen.yaw + pushed.heading
    middle = _turn(seen.yaw, pushed.marker)
    offset = _turn(heading, pushed.centre)
    face = _turn(heading, seen.face.T)
    tip = (
        seen.tip + np.column_stack(np.broadcast_arrays(*pushed.registration, seen.yaw))[:, :2] - seen.position - middle
    )
    contact = tip - seen.tip_radius[:, None] * face
    velocity = seen.velocity + _cross(seen.rate, middle + offset)
    force, moment = wrench(pushed, velocity, seen.rate, _along(pushed, seen, velocity))
    arm = contact - offset
    missed = (arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0] - moment) / (np.hypot(*force.T) + 1e-12)
    sensed = force + np.column_stack(np.broadcast_arrays(*pushed.bias, seen.yaw))[:, :2]
    measured = _turn(pushed.sensor_turn, seen.force.T)
    touch = (tip * face).sum(axis=1) - pushed.half_side - seen.tip_radius
    slip = seen.tip_velocity - seen.velocity - _cross(seen.rate, middle + contact)
    inward = slip[:, 0] * face[:, 1] - slip[:, 1] * face[:, 0]
    return np.column_stack(
        [
            np.log(np.hypot(*measured.T) + 1e-12) - np.log(np.hypot(*sensed.T) + 1e-12),
            _between(sensed, measured),
            missed,
            touch,
            _beyond_cone(pushed, _between(-face, measured), inward),
        ]
    )


def _along(pushed: Pushed, seen: Windows, velocity: np.ndarray) -> np.ndarray:
    """Factor (w,) of friction by speed and place, one at the usual speed and at the table's origin."""
    speed = np.log(np.maximum(np.hypot(*velocity.T), MODEL.slowest) / MODEL.usual_speed)
    x, y = seen.position.T
    return np.exp(pushed.speed * speed + pushed.place[0] * x + pushed.place[1] * y)


def _beyond_cone(pushed: Pushed, angle: np.ndarray, slip: np.ndarray) -> np.ndarray:
    """rad (w,) of the angle of force in the face beyond what the cone says; slip (w,) m/s of the tip, positive as the angle."""
    cone = np.arctan(pushed.tip_friction)
    sliding = np.clip((np.abs(slip) - MODEL.no_slip) / (MODEL.sure_slip - MODEL.no_slip), 0, 1)
    return angle - (sliding * np.sign(slip) * cone + (1 - sliding) * np.clip(angle, -cone, cone))


def _turn(angle: np.ndarray | float, vector: Sequence[float | np.ndarray]) -> np.ndarray:
    """Vectors of components x, y, each () or (w,), turned by angles () or (w,) rad: (w, 2)."""
    x, y = vector
    turned = np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y
    return np.column_stack(turned)


def _cross(rate: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Velocity (w, 2) of points at arms (w, 2) about what turns at rates (w,)."""
    return np.column_stack([-rate * arm[:, 1], rate * arm[:, 0]])


def _between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Angles (w,) rad from one (w, 2) to another."""
    return np.arctan2(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0], (one * other).sum(axis=1))
