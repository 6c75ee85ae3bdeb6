"""The first half of a card episode through the driver: released weights, RRT*, keypoints of a card that
stands still."""

from itertools import dropwhile

import pytest
from approach import approach
from moving_arm import SLOW


@pytest.mark.parametrize("control", ["topic", "onboard"])
def test_the_hand_comes_to_the_pre_contact_pose(control):
    row = approach(control, SLOW)
    # `phase` is latched: whether its first value, idle, is still seen depends on when the nodes found one
    # another.
    phases = list(dropwhile(lambda phase: phase == "idle", row["phases"]))
    assert phases == ["pre", "approach", "post"]
    assert row["state"] == "moving" and row["plan_points"] > 10
    assert row["peak_speed_share"] < 1
    assert row["end_joint_error_rad"] < 0.02
    assert row["end_hand_error_mm"] < 5 and row["end_hand_error_deg"] < 1
