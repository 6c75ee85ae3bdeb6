"""The impedance law: its formula, its parity between NumPy and PyTorch, its bounds."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from np_control.dynamics import Dynamics
from np_control.impedance import DAMPING_RATIO_MAX, DAMPING_RATIO_MIN, STIFFNESS_MAX, STIFFNESS_MIN, damping, torque
from np_control.safety import LIMITS
from np_description.panda import NOMINAL

vectors = arrays(float, 7, elements=st.floats(-3, 3))
unit = arrays(float, 7, elements=st.floats(0, 1))
stiffnesses = unit.map(lambda u: STIFFNESS_MIN + u * (STIFFNESS_MAX - STIFFNESS_MIN))
ratios = unit.map(lambda u: DAMPING_RATIO_MIN + u * (DAMPING_RATIO_MAX - DAMPING_RATIO_MIN))


@given(vectors, vectors, vectors, stiffnesses, ratios, vectors)
def test_it_is_the_papers_law_joint_by_joint(q, dq, target, stiffness, ratio, coriolis):
    result = torque(q, dq, target, stiffness, ratio, coriolis)
    for i in range(7):
        expected = stiffness[i] * (target[i] - q[i]) - ratio[i] * stiffness[i] ** 0.5 * dq[i] + coriolis[i]
        assert result[i] == pytest.approx(expected, abs=1e-9)


@given(vectors, vectors, vectors, stiffnesses, ratios, vectors)
def test_numpy_and_torch_agree(q, dq, target, stiffness, ratio, coriolis):
    arguments = (q, dq, target, stiffness, ratio, coriolis)
    batch = torque(*(torch.as_tensor(np.stack([a, -a if a is q else a])) for a in arguments))
    np.testing.assert_allclose(batch[0].numpy(), torque(*arguments), atol=1e-6)
    np.testing.assert_allclose(batch[1].numpy(), torque(-q, *arguments[1:]), atol=1e-6)


@given(vectors, stiffnesses, ratios)
def test_at_the_target_at_rest_only_coriolis_is_left(q, stiffness, ratio):
    np.testing.assert_array_equal(torque(q, np.zeros(7), q, stiffness, ratio, np.arange(7.0)), np.arange(7.0))


def test_the_bounds_are_ordered_and_stable_at_500_hz():
    assert (STIFFNESS_MIN > 0).all() and (STIFFNESS_MAX > STIFFNESS_MIN).all()
    assert 0.5 <= DAMPING_RATIO_MIN < DAMPING_RATIO_MAX  # the paper's least ratio
    # Explicit sampling is stable while kd dt < 2 M; the least inertia a joint can show is in the safety
    # limits.
    most = damping(STIFFNESS_MAX, np.full(7, DAMPING_RATIO_MAX))
    assert (most * LIMITS.period < LIMITS.inertia).all()
    assert (LIMITS.inertia <= np.diag(Dynamics().mass_matrix(NOMINAL.ready))).all()
