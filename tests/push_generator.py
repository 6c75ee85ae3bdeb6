"""Slow pushes of a square block whose friction is added up over points of support: no ellipsoid, and nothing of the doctor's.

Every point slides with Coulomb friction of its own (pressure, and a coefficient that waves over the table). A round tip drags the
block: of all rotations about the point of contact the one that takes the least power happens, and where the force would leave the
tip's cone of friction the tip slides along the face until it does not. All pushes are moved at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

PERIOD = 0.04  # s
FREE = 0.5  # s before contact
HEIGHT = 0.02  # m
EDGE = 0.9  # of the half side, beyond which the tip is taken off
FASTEST = 8.0  # rad/s
OWN = 1e-4  # m/s, below which a point of support creeps


@dataclass(frozen=True)
class World:
    """A block, its table and tip. support: 'corners' or 'patch'; centre: m, of pressure; magnet: N/(m/s) of drag on it, for none 0."""

    weight_friction: float = 1.2  # N: coefficient times weight
    tip_friction: float = 0.3
    half_side: float = 0.05
    support: str = "patch"
    centre: tuple[float, float] = (0.0, 0.0)
    waves: float = 0.05  # of the coefficient over the table, relative
    drag: float = 0.0  # N/(m/s)
    magnet: float = 0.0  # N towards the table's origin


@dataclass(frozen=True)
class Sensing:
    """What the instruments add."""

    force: float = 0.05  # N, white
    shaking: float = 0.1  # N at 13 Hz
    bias: float = 0.3  # N
    place: float = 2e-4  # m
    angle: float = 1e-3  # rad
    clock: float = 0.005  # s between streams
    tip_radius: float = 0.004


def support(world: World) -> tuple[np.ndarray, np.ndarray]:
    """Points (p, 2) m and friction (p,) N of each, the centre of pressure where it is asked to be."""
    if world.support == "corners":
        line = np.array([-1.0, 1.0]) * world.half_side
    else:
        line = (np.arange(7) - 3) / 3.5 * world.half_side
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    tilt = np.array(world.centre) / np.mean(points[:, 0] ** 2)
    share = 1 + points @ tilt
    assert (share > 0).all(), "a block does not stand on a centre of pressure that far out"
    return points, world.weight_friction * share / share.sum()


def pushes(worlds, sensing: Sensing, rng: np.random.Generator, level: float = 0.12, duration: float = 2.4):
    """(force (n, 4), tip (m, 4), pose (k, 8)) of one push of each world; level: spread of friction from run to run, of its log."""
    count = len(worlds)
    both = [support(w) for w in worlds]
    size = max(len(p) for p, _ in both)
    points = np.array([np.pad(p, ((0, size - len(p)), (0, 0))) for p, _ in both])
    weight = np.array([np.pad(f, (0, size - len(f))) for _, f in both]) * np.exp(level * rng.normal(size=(count, 1)))
    mu, half = (np.array([getattr(w, name) for w in worlds]) for name in ("tip_friction", "half_side"))
    drag, magnet, waves = (np.array([getattr(w, name) for w in worlds]) for name in ("drag", "magnet", "waves"))
    face = rng.integers(4, size=count) * np.pi / 2  # outward normal in the block's frame
    yaw = rng.uniform(-np.pi, np.pi, count)
    speed = rng.uniform(0.03, 0.08, count)
    direction = yaw + face + np.pi + rng.uniform(-0.35, 0.35, count)
    along = rng.uniform(-0.4, 0.4, count) * half  # of contact along the face
    place = rng.uniform(-0.1, 0.1, (count, 2)) - 0.5 * speed[:, None] * duration * _unit(direction)
    phase, number = rng.uniform(0, 2 * np.pi, (count, 1)), rng.uniform(20, 60, (count, 1, 2))
    velocity = speed[:, None] * _unit(direction)
    rows, every = [], np.arange(count)
    for _ in range(round(duration / PERIOD)):
        normal, across = _unit(yaw + face), _unit(yaw + face + np.pi / 2)
        contact = half[:, None] * normal + along[:, None] * across
        ground = _rotate(yaw[:, None], points)
        local = weight * (1 + waves[:, None] * np.sin(((place[:, None] + ground) * number).sum(-1) + phase))

        pull = drag[:, None] * velocity + magnet[:, None] * place / (np.hypot(*place.T)[:, None] + 0.02)

        def dragged(which, slip):
            at_contact = velocity[which] - slip[:, None] * across[which]
            at_middle = contact[which, 1] * pull[which, 0] - contact[which, 0] * pull[which, 1]
            return _dragged(at_contact, ground[which] - contact[which, None], local[which], at_middle)

        force, _ = dragged(every, np.zeros(count))
        force = force + pull
        angle = _angle(-normal, force)
        sign = -np.sign(angle)  # of slip along `across`; force along -across is a positive angle
        slides = np.flatnonzero(np.abs(angle) > np.arctan(mu))
        low, high = np.zeros(len(slides)), 3 * speed[slides]
        for _ in range(10 if len(slides) else 0):
            middle = (low + high) / 2
            trial, _ = dragged(slides, sign[slides] * middle)
            beyond = -sign[slides] * _angle(-normal[slides], trial + pull[slides]) > np.arctan(mu[slides])
            low, high = np.where(beyond, middle, low), np.where(beyond, high, middle)
        slip = np.zeros(count)
        slip[slides] = sign[slides] * high
        force, rate = dragged(every, slip)
        force = force + pull
        rows.append((place.copy(), yaw.copy(), place + contact, normal.copy(), force, np.abs(along) < EDGE * half))
        at_contact = velocity - slip[:, None] * across
        place = place + PERIOD * (at_contact - rate[:, None] * np.column_stack([-contact[:, 1], contact[:, 0]]))
        yaw, along = yaw + PERIOD * rate, along + PERIOD * slip
    places, yaws, contacts, normals, forces, on = (np.array(v) for v in zip(*rows))
    length = np.where(on.all(axis=0), len(on), np.argmin(on, axis=0))
    return [
        _sensed(*(v[:k, n] for v in (places, yaws, contacts, normals, forces)), velocity[n], sensing, rng)
        for n, k in enumerate(length)
    ]


def _dragged(
    velocity: np.ndarray, arms: np.ndarray, weight: np.ndarray, more: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Force (b, 2) and rate (b,) of blocks whose point of contact has this velocity (b, 2):
    friction's moment about it and `more` (b,) Nm add up to nothing."""
    high = np.full(len(velocity), FASTEST)
    low = -high
    for _ in range(18):
        rate = (low + high) / 2
        v = velocity[:, None] + rate[:, None, None] * np.stack([-arms[..., 1], arms[..., 0]], axis=-1)
        friction = weight[..., None] * v / np.sqrt((v * v).sum(-1, keepdims=True) + OWN**2)
        moment = (arms[..., 0] * friction[..., 1] - arms[..., 1] * friction[..., 0]).sum(-1) + more
        low, high = np.where(moment < 0, rate, low), np.where(moment < 0, high, rate)
    return friction.sum(axis=1), rate


def _sensed(place, yaw, contact, normal, force, velocity, sensing, rng):
    """The three streams of one push, with stamps of their own, from a stretch before contact on."""
    time = np.arange(len(yaw)) * PERIOD + FREE
    tip = contact + sensing.tip_radius * normal
    clocks = rng.uniform(-sensing.clock, sensing.clock, 3)
    end = time[-1] - 0.05

    def sampled(period, values, clock, before):
        """Stamps and values, straight between steps; before: what it is before contact, by the time until then."""
        stamps = np.arange(0.02, end, period) + rng.uniform(0, 0.2 * period, len(np.arange(0.02, end, period)))
        inner = np.column_stack([np.interp(stamps, time, column) for column in values.T])
        early = stamps < time[0]
        inner[early] = before(stamps[early] - time[0])
        return stamps + clock, inner

    stamps, seen = sampled(0.01, force, clocks[0], lambda t: np.zeros((len(t), 2)))
    shaking = sensing.shaking * np.sin(2 * np.pi * 13 * stamps[:, None] + rng.uniform(0, 6, 2))
    seen = seen + sensing.bias * rng.normal(size=2) + shaking + sensing.force * rng.normal(size=seen.shape)
    forces = np.column_stack([stamps, seen, np.zeros(len(stamps))])
    stamps, seen = sampled(0.012, tip, clocks[1], lambda t: tip[0] + t[:, None] * velocity)
    tips = np.column_stack([stamps, seen, np.full(len(stamps), HEIGHT)])
    stamps, seen = sampled(0.01, place, clocks[2], lambda t: np.tile(place[0], (len(t), 1)))
    angle = np.interp(stamps - clocks[2], time, yaw) + sensing.angle * rng.normal(size=len(stamps))
    seen = seen + sensing.place * rng.normal(size=seen.shape)
    flat = np.zeros((len(stamps), 2))
    poses = np.column_stack([stamps, seen, flat[:, :1], flat, np.sin(angle / 2), np.cos(angle / 2)])
    return forces, tips, poses


def _unit(angle):
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _rotate(angle, vector):
    x, y = np.moveaxis(vector, -1, 0)
    return np.stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y], axis=-1)


def _angle(one, other):
    return np.arctan2(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0], (one * other).sum(axis=1))
