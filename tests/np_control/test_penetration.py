"""Depths of contact: what is put into each other is as deep as it was put, and summed up by what touches."""

import json

import numpy as np
import pytest

from np_common.rotations import matrix_from_quaternion
from np_control.kinematics import forward_kinematics, solve_ik
from np_description.contact.depths import PAIRS, DepthHistogram
from np_description.contact.penetration import Penetration
from np_description.domains import CARD, WALL, Pose
from np_description.panda import NOMINAL

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
DOWN = matrix_from_quaternion(np.array([0.0, 1.0, 0.0, 0.0]))
TIP = 0.0584 + 0.0458 + 0.008 - 0.1034  # m, by which the fingertips' capsules reach beyond T_E


def joints(position):
    """Seven joints and closed fingers, with T_E at `position`, the hand down."""
    q = NOMINAL.ready.copy()
    for _ in range(40):
        q = solve_ik(q, np.asarray(position), DOWN)
    assert np.linalg.norm(forward_kinematics(q)[0] - position) < 1e-4
    return np.concatenate([q, np.zeros(2)])


def away():
    return joints([0.4, 0.2, 0.4])


@pytest.mark.parametrize("sunk", [0.0005, 0.002, 0.004])
def test_an_object_is_as_deep_in_the_table_as_it_was_put(sunk):
    pose = Pose(np.array([0.5, 0.0, CARD.half_size[2] - sunk]), UPRIGHT)
    assert Penetration(CARD).depths(away(), pose) == {"object-surroundings": pytest.approx(sunk, abs=1e-6)}


@pytest.mark.parametrize("sunk", [0.001, 0.003])
def test_a_fingertip_is_as_deep_in_the_card_as_it_was_put(sunk):
    pose = Pose(np.array([0.5, 0.0, CARD.half_size[2] + 1e-4]), UPRIGHT)
    top = 2 * CARD.half_size[2] + 1e-4
    found = Penetration(CARD).depths(joints([0.5, 0.0, top - sunk + TIP]), pose)
    assert set(found) == {"finger-object"}
    assert found["finger-object"] == pytest.approx(sunk, abs=2e-4)


def test_the_housing_is_told_from_the_fingers():
    pose = Pose(np.array([0.45, 0.0, 0.1]), UPRIGHT)
    found = Penetration(WALL).depths(joints([0.45, 0.0, 0.05]), pose)
    assert "housing-object" in found or "link-object" in found


def test_nothing_touches_nothing():
    pose = Pose(np.array([0.5, 0.0, 0.3]), UPRIGHT)
    assert Penetration(CARD).depths(away(), pose) == {}


def test_what_is_not_finite_is_refused():
    with pytest.raises(ValueError, match="expected finite joints and pose"):
        Penetration(CARD).depths(np.full(9, np.nan), Pose(np.zeros(3), UPRIGHT))


def test_the_summary_leaves_rubber_out_and_counts_who_pushes():
    moments = [{"finger-object": 0.004}, {"finger-object": 0.002, "object-surroundings": 0.0002}, {}]
    moments += [{"housing-object": 0.001, "finger-object": 0.001}] + [{"object-surroundings": 0.0002}] * 6
    parts = [DepthHistogram(), DepthHistogram()]
    for number, moment in enumerate(moments):
        parts[number % 2].add(moment)
    found = DepthHistogram.summary(DepthHistogram(json.loads(json.dumps(part.as_dict()))) for part in parts)
    assert (found.median, found.largest) == (0.2, 1.0)
    assert found.by_pair["finger-object"] == {"median": 2.0, "q99": pytest.approx(3.96), "max": 4.0}
    assert found.pushed_otherwise == pytest.approx(1 / 3) and set(found.by_pair) <= set(PAIRS)


def test_of_nothing_there_is_nothing_to_say():
    assert DepthHistogram.summary([]).as_dict() == {
        "median": None,
        "q99": None,
        "max": None,
        "by_pair": {},
        "pushed_by_housing_or_links": None,
    }
