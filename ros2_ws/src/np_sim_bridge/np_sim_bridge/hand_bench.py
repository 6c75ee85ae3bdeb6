"""A leaned hand presses a box on a wall and draws it along: contact of the whole scene against rigid theory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from np_common.rotations import matrix_from_six, vector_from_matrix
from np_control.kinematics import forward_kinematics, jacobian, solve_ik
from np_description.domains import WALL, Pose, Task
from np_description.engine import MakeEngine
from np_description.objects.choice import place_object
from np_description.objects.spec import Friction
from np_description.objects.table import rows_of
from np_description.panda import NOMINAL
from np_sim_bridge.schedule import PERIOD, SECOND

STEP = PERIOD / SECOND  # s
PRESS, SPEED, DISTANCE = 10.0, 0.1, 0.04  # N, m/s, m
DIRECTIONS = {"up": (0.0, 0.0, 1.0), "sideways": (0.0, 1.0, 0.0), "both": (0.0, np.sqrt(0.5), np.sqrt(0.5))}
# Hand axes in the base frame: the pads lean by 20 to 25 degrees about both of their sides, so that each touches with a corner.
OUT_OF_HAND, FINGERS_OPEN = np.array([0.16, 0.31, -0.94]), np.array([0.19, -0.94, -0.28])
_OUT_OPEN_SIDE = matrix_from_six(np.concatenate([OUT_OF_HAND, FINGERS_OPEN]))
LEANED = _OUT_OPEN_SIDE[:, ::-1] * [-1, 1, 1]  # its columns are z, y and -x
BEFORE, BESIDE, ABOVE = 0.024, -0.005, 0.015  # m, of T_E from the box: before its face, beside and above its middle
ALONG, ALONG_DAMPING, PRESS_DAMPING = 2000.0, 150.0, 60.0  # N/m, N s/m, N s/m
TURNING, TURNING_DAMPING, NULL_DAMPING = 60.0, 3.0, 1.0  # Nm/rad, Nm s/rad, Nm s/rad


def _roughen(friction: float) -> Task:
    """The wall's task whose surroundings have this coefficient of friction."""
    spec = rows_of(WALL.name)["default"].spec
    table = Friction(friction, "the bench")
    return place_object(WALL, replace(spec, surface=replace(spec.surface, table=table)))


def draw_along_wall(make: MakeEngine, direction: str, friction: float | None = None) -> float:
    """The box stands at the wall. The hand presses it there for 1 s, then is drawn along the wall too.

    The hand is led along y and z of the base by a spring and pushes along x with PRESS N. Rubber holds what the wall's friction and the
    weight pull at, and damps what friction shakes, so the hand never leaves the box. direction: a key of DIRECTIONS; friction: coefficient of wall and
    table, None: as `make` has it. Gives the share of steps without touch while it is drawn.
    """
    domain = WALL if friction is None else _roughen(friction)
    way, half = np.array(DIRECTIONS[direction]), domain.half_size
    (wall,) = domain.obstacles
    box = np.array([wall.centre[0] - wall.half_size[0] - half[0], 0.0, half[2]])
    start = box + [-half[0] - BEFORE, BESIDE, ABOVE]
    ready = solve_ik(np.array(NOMINAL.ready), start, LEANED, iterations=200)
    engine = make(domain, panda=replace(NOMINAL, ready=ready))
    engine.reset(Pose(box, np.array([1.0, 0, 0, 0])))
    still, drawn, apart = round(1.0 / STEP), round(DISTANCE / SPEED / STEP), 0
    for k in range(still + drawn):
        position, speed = (values[:7] for values in engine.joints()[:2])
        (hand, turned), matrix = forward_kinematics(position), jacobian(position)
        twist = matrix @ speed
        velocity = way * SPEED * (k >= still)
        goal = start + way * SPEED * STEP * max(0, k - still)
        force = ALONG * (goal - hand) + ALONG_DAMPING * (velocity - twist[:3])
        force[0] = PRESS - PRESS_DAMPING * twist[0]
        moment = TURNING * vector_from_matrix(LEANED @ turned.T) - TURNING_DAMPING * twist[3:]
        rest = speed - np.linalg.pinv(matrix) @ twist
        engine.step(matrix.T @ np.concatenate([force, moment]) - NULL_DAMPING * rest, np.zeros(7), 0.0)
        apart += k >= still and "finger" not in engine.pressing()
    return apart / drawn
