"""The limits that the hardware driver runs with; no hardware extra needed."""

import numpy as np
from np_control.safety import LIMITS
from np_franka.limits import CYCLE_NS, FR3_LIMITS, Collision


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
    collision = Collision()
    assert (collision.torques(FR3_LIMITS) < FR3_LIMITS.torque).all()
    assert collision.wrench().tolist() == [collision.force] * 3 + [collision.moment] * 3
    assert np.allclose(Collision(torque=0.5).torques(FR3_LIMITS), FR3_LIMITS.torque / 2)
