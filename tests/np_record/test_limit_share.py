"""Shares of the arm's limits: 1 at the limit, whatever the joint; what many episodes come to."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from np_description.limit_share import LIMIT_NAMES, limit_shares, summary
from np_description.panda import JOINT_NAMES, NOMINAL, STATE_NAMES
from np_record.bag import BagError
from np_record.bulk import read_joint_rows, serialize_joint_states

share = st.floats(0, 1.2)


@given(share, share, st.floats(-1, 1), st.integers(0, 6))
def test_each_limit_counts_by_itself(speed, torque, place, joint):
    middle = (NOMINAL.position_upper + NOMINAL.position_lower) / 2
    half = (NOMINAL.position_upper - NOMINAL.position_lower) / 2
    unit = np.eye(7)[joint]
    found = limit_shares(
        middle + place * half * unit, -speed * NOMINAL.velocity_limit * unit, torque * NOMINAL.torque_limit * unit
    )
    assert found.shape == (3, 7)
    np.testing.assert_allclose(found, np.outer([speed, torque, abs(place)], unit), atol=1e-12)


def test_episodes_are_summed_up_by_their_fastest_joint():
    episodes = [np.full((3, 7), 0.2) for _ in range(100)]
    episodes[7][0, 3] = 0.9
    figures = summary(episodes)
    assert tuple(figures) == LIMIT_NAMES
    assert figures["velocity"]["median"] == 0.2 and figures["torque"]["q99"] == 0.2
    assert figures["velocity"]["by_joint_q99"][3] > figures["velocity"]["by_joint_q99"][2] == 0.2
    assert summary([]) == {}


def states(count, names=STATE_NAMES):
    values = np.arange(3.0 * count * len(names)).reshape(3, count, len(names))
    return list(serialize_joint_states(np.arange(count), names, *values)), values


def test_rows_of_serialized_states_are_read_by_name():
    messages, values = states(4)
    rows = read_joint_rows(messages, JOINT_NAMES[::-1])
    np.testing.assert_array_equal(rows, values[:, :, :7][:, :, ::-1].transpose(1, 0, 2))


def test_states_that_cannot_be_read_are_left_out():
    messages, values = states(4)
    broken = values[:, 1:2].copy()
    broken[0, 0, 2] = np.nan
    bad = list(serialize_joint_states(np.zeros(1, np.int64), STATE_NAMES, *broken))
    other, _ = states(1, ("wrist",))
    rows = read_joint_rows([messages[0], bad[0], other[0], messages[2]], JOINT_NAMES)
    np.testing.assert_array_equal(rows, values[:, [0, 2], :7].transpose(1, 0, 2))
    assert read_joint_rows([], JOINT_NAMES).shape == (0, 3, 7)


def test_a_name_that_is_missing_is_named():
    with pytest.raises(BagError, match="panda_joint7 is not in"):
        read_joint_rows(states(1, STATE_NAMES[:6])[0], JOINT_NAMES)
