"""The limits that the hardware driver runs with; no hardware extra needed."""

import sys

import numpy as np
import pytest

from np_control.safety import LIMITS
from np_description.force_reflex import FORCE_REFLEX, ForceReflex
from np_franka.client import ArmError
from np_franka.limits import CYCLE_NS, FR3_LIMITS
from np_franka.robots import ROBOTS


def test_guards_at_the_robots_rate_keep_the_deadlines_of_the_contract():
    assert FR3_LIMITS.period_ns == CYCLE_NS
    for name in ("late_periods", "missed_periods"):
        assert getattr(FR3_LIMITS, name) * CYCLE_NS == getattr(LIMITS, name) * LIMITS.period_ns
    assert FR3_LIMITS.silence_ns == LIMITS.silence_ns
    assert FR3_LIMITS.torque_rate * FR3_LIMITS.period == 0.5 * LIMITS.torque_rate * LIMITS.period


def test_the_range_is_within_the_pandas_and_leaves_room_to_move():
    assert (FR3_LIMITS.position_lower >= LIMITS.position_lower).all()
    assert (FR3_LIMITS.position_upper <= LIMITS.position_upper).all()
    assert (FR3_LIMITS.wall_upper - FR3_LIMITS.wall_lower > 2.0).all()
    assert (FR3_LIMITS.torque == LIMITS.torque).all() and (FR3_LIMITS.velocity == LIMITS.velocity).all()


def test_collision_thresholds_are_below_what_the_joints_can_give():
    reflex = FORCE_REFLEX
    assert (reflex.torques(FR3_LIMITS.torque) < FR3_LIMITS.torque).all()
    assert reflex.wrench().tolist() == [reflex.force] * 3 + [reflex.moment] * 3
    assert np.allclose(ForceReflex(torque=0.5).torques(FR3_LIMITS.torque), FR3_LIMITS.torque / 2)


def test_the_name_of_the_robot_chooses_its_limits():
    assert ROBOTS["fr3"].limits is FR3_LIMITS
    panda = ROBOTS["panda"].limits
    for name in ("position_lower", "position_upper", "velocity", "torque"):
        assert (getattr(panda, name) == getattr(LIMITS, name)).all()
    assert panda.period_ns == CYCLE_NS
    assert (panda.position_upper > FR3_LIMITS.position_upper).any()


@pytest.mark.parametrize("robot", list(ROBOTS))
def test_a_client_that_is_not_installed_is_named(robot, monkeypatch):
    monkeypatch.setitem(sys.modules, ROBOTS[robot].package, None)
    monkeypatch.delitem(sys.modules, ROBOTS[robot].module, raising=False)
    with pytest.raises(ArmError, match=f"robot:={robot}: expected the package {ROBOTS[robot].package}"):
        ROBOTS[robot].load()
