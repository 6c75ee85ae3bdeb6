"""The doctor against arms of known and of unknown gap."""

import os
from pathlib import Path

import numpy as np
import pytest
from arm_generator import Truth, record

from np_diagnosis.contract import check
from np_diagnosis.diagnosis import diagnose
from np_diagnosis.nominal import rigid_body_only, without_hand
from np_diagnosis.reading import read
from np_diagnosis.report import make_report
from np_diagnosis.signals import sample

REAL = Path(os.environ.get("NP_REAL_DATA", Path(__file__).resolve().parents[3] / "shared" / "real"))


def at(joint, value):
    array = np.zeros(7)
    array[joint - 1] = value
    return array


def examine(truth, seed=0):
    log = record(truth, seed=seed)
    check(log)
    diagnosis = diagnose(sample([log]))
    return diagnosis, make_report(diagnosis, [log], 0.0)


@pytest.mark.parametrize("truth, seed", [(Truth(), 0), (Truth(inertia_error=0.03, late=0.002), 1)])
def test_a_clean_arm_has_no_gap(truth, seed):
    diagnosis, report = examine(truth, seed)
    assert diagnosis.verdict == "no_gap"
    assert report["effects"] == [] and report["where"] == [] and abs(diagnosis.shrink) < 0.05


def test_coulomb_friction_is_found_in_its_joint():
    diagnosis, report = examine(Truth(coulomb_positive=at(4, 0.3), coulomb_negative=at(4, 0.3)))
    result = diagnosis.joints[3]
    found = [f for f in result.findings if f.is_chosen]
    assert [f.effect.id for f in found] == ["coulomb_friction"]
    level = found[0].parameters["level"]
    assert level.value == pytest.approx(0.3, abs=0.02) and level.high - level.low < 0.1
    assert result.after < 0.15 * result.before
    assert all(r.verdict == "no_gap" for r in diagnosis.joints if r is not result)
    assert report["where"][0]["component"] == "panda_joint4"
    assert report["where"][0]["module"] == "joint_dynamics"


def test_asymmetry_is_not_told_from_an_offset_while_moving():
    diagnosis, report = examine(Truth(coulomb_positive=at(1, 0.5), coulomb_negative=at(1, 0.1)))
    assert diagnosis.joints[0].verdict == "ambiguous" == diagnosis.verdict
    chosen = [f for f in diagnosis.joints[0].findings if f.is_chosen]
    assert {"coulomb_friction", "torque_offset"} <= {
        i for f in chosen for i in (f.effect.id, *f.equivalent_to)
    }
    assert report["next_experiment"]["name"].startswith("standstill")
    levels = chosen[0].parameters
    assert chosen[0].effect.id == "asymmetric_coulomb_friction"
    assert levels["level_positive"].value == pytest.approx(0.5, abs=0.04)
    assert levels["level_negative"].value == pytest.approx(0.1, abs=0.04)


def test_a_payload_is_one_cause_and_not_seven():
    diagnosis, _ = examine(Truth(payload=0.3))
    chosen = [f for f in diagnosis.arm if f.is_chosen]
    assert [f.effect.id for f in chosen] == ["payload"]
    mass = chosen[0].parameters["mass"]
    assert mass.value == pytest.approx(0.3, abs=0.01)
    assert not [f for r in diagnosis.joints for f in r.findings if f.is_chosen]
    assert diagnosis.shrink > 0.9 and diagnosis.shrink_interval[0] > 0.8


def test_what_no_catalogue_knows_stays_unexplained():
    diagnosis, report = examine(Truth(waviness=at(2, 1.0)))
    assert diagnosis.verdict == "unexplained" == diagnosis.joints[1].verdict
    assert not [f for f in diagnosis.joints[1].findings if f.is_chosen]
    assert any(place["module"] == "unknown" for place in report["where"])


def test_the_public_panda_log(capsys):
    """Gaz et al. 2019: 10 contiguous blocks, half a second apart, bare flange, no nominal friction."""
    path = REAL / "panda_gaz2019" / "gaz2019_traj1.npz"
    if not path.exists():
        pytest.skip(f"{path} is not there; NP_REAL_DATA names the folder with real recordings")
    panda = rigid_body_only(without_hand())
    log = read(path)
    check(log, panda)
    diagnosis = diagnose(sample([log]), panda)
    with capsys.disabled():
        print(
            f"\nPanda log: {diagnosis.before:.3f} -> {diagnosis.after:.3f} Nm,",
            ", ".join(
                f"{r.joint[-1]}: {r.verdict} {r.before:.3f} -> {r.after:.3f}" for r in diagnosis.joints
            ),
        )
    assert diagnosis.blocks == 10
    assert diagnosis.after <= 0.285
    assert {diagnosis.joints[1].verdict, diagnosis.joints[2].verdict} == {"unexplained"}
