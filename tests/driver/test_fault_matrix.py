"""Every fault, in every mode in which it can be: nothing goes over a limit, and there is a way back."""

import fault_cases
import pytest


@pytest.mark.parametrize("name, control", fault_cases.PAIRS)
def test_no_limit_is_passed_and_the_arm_can_be_used_again(name, control):
    row = fault_cases.run(name, control)
    assert not fault_cases.over_limit(row), row
    assert row.after in ("ready", "moving"), row
    assert row.peak_speed_share > 0.3, f"the arm hardly moved, which shows nothing: {row}"
