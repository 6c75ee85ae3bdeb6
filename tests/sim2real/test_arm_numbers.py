"""Load, base and friction of an arm, whether the diagnosis names them or not."""

import numpy as np
import pytest
from arm_generator import Truth, record
from sim2real.arm_numbers import estimate_arm_numbers
from sim2real.consequences import Consequences
from sim2real.diagnosis import explain_gap
from sim2real.effects.patch import Patch
from sim2real.report.document import make_report, to_json
from sim2real.report.page import render

from np_description.panda import NOMINAL


def numbers(diagnosis):
    return {(one.quantity, one.component): one for one in estimate_arm_numbers(diagnosis)}


def test_a_load_and_a_level_base_are_measured(loaded):
    found = numbers(loaded[0])
    load = found["load", "arm"].estimate
    assert load.low < 0.3 < load.high and load.high - load.low < 0.06
    for name in ("base_roll", "base_pitch"):
        level = found[name, "arm"].estimate
        assert abs(level.value) < 1e-3 and level.high - level.low < 2e-3


def test_friction_includes_the_nominal_one_and_stands_in_for_other_laws(uneven):
    """Joint 1 has 0.5 Nm in one direction and 0.1 Nm in the other: 0.3 Nm on average."""
    diagnosis = uneven[0]
    assert [f.effect.id for f in diagnosis.findings if f.is_chosen] == ["asymmetric_coulomb_friction"]
    found = numbers(diagnosis)
    for j, joint in enumerate(NOMINAL.joints):
        one = found["coulomb_friction", joint]
        assert one.nominal == NOMINAL.frictionloss[j]
        assert one.estimate.value == pytest.approx(one.nominal + (0.3 if j == 0 else 0.0), abs=0.06)


def test_friction_and_load_at_once_are_told_apart():
    """More faults than the diagnosis names; each number is still within its interval in 13 of 15, which is rarer than one in
    twenty for intervals that hold in fewer than three of four."""
    level, viscous = np.array([0.3, 0, 0, 0.2, 0, 0.1, 0]), np.array([0, 0.3, 0, 0, 0.1, 0, 0])
    truth = Truth(coulomb_positive=level, coulomb_negative=level, viscous=viscous, payload=0.4)
    found = numbers(explain_gap([record(truth, seed=4)]))
    true = {("load", "arm"): 0.4}
    for j, joint in enumerate(NOMINAL.joints):
        true["coulomb_friction", joint] = NOMINAL.frictionloss[j] + level[j]
        true["viscous_friction", joint] = NOMINAL.damping[j] + viscous[j]
    holds = [found[key].estimate.low <= value <= found[key].estimate.high for key, value in true.items()]
    assert sum(holds) >= 13 and found["load", "arm"].estimate.value == pytest.approx(0.4, abs=0.02)


def test_a_change_between_recordings_has_no_numbers(loaded):
    log = loaded[1]
    assert estimate_arm_numbers(explain_gap([log], reference=[log])) == []


def test_the_page_and_the_report_have_them(loaded):
    diagnosis, log = loaded
    done = Consequences(Patch(), arm=tuple(estimate_arm_numbers(diagnosis)))
    report = make_report(diagnosis, [log], 0.0, done)
    assert to_json(report) and {row["unit"] for row in report["arm"]} == {"kg", "rad", "Nm", "Nms/rad"}
    text = render(report, diagnosis)
    load = next(row for row in report["arm"] if row["quantity"] == "load")
    assert "This arm" in text and f"{1000 * load['value']:.0f} ({1000 * load['ci95'][0]:.0f}" in text
