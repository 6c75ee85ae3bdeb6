"""The identification command on a reference arm: tiny, the same code as at full length."""

import json

import numpy as np
import pytest
from sim2real.excitation.suite import make_suite

from np_blind.baselines import identify
from np_blind.baselines.identify_reference import known_arm, record
from np_blind.baselines.methods import gap
from np_blind.baselines.plant import panda_plant


@pytest.fixture(scope="module")
def sinusoid():
    truth = known_arm(1)
    return truth, record(truth, make_suite(["sinusoid_7"]), 1)


def test_a_reference_arm_is_explained_by_its_own_parameters(sinusoid):
    truth, recorded = sinusoid
    assert recorded[0].name == "sinusoid_7" and recorded[0].activity.argmax() == 6
    before, after = gap(panda_plant(), recorded, {}), gap(panda_plant(), recorded, truth)
    assert after[6] < 0.2 * before[6]


def test_a_split_leaves_nothing_out_and_shares_nothing(sinusoid):
    _, recorded = sinusoid
    fitted, held_out = identify.split(recorded, 0.6)
    joined = np.concatenate([fitted[0].target, held_out[0].target])
    assert np.array_equal(joined, recorded[0].target) and len(fitted[0]) == round(0.6 * len(recorded[0]))


def test_the_command_reports_error_parameters_and_time(sinusoid, monkeypatch, tmp_path, capsys):
    truth, recorded = sinusoid
    monkeypatch.setattr(
        identify, "simulate_recording", lambda seed: (recorded, [recorded[0].cut(slice(0, 1000))], truth)
    )
    options = "--window 1.5 --windows 1 --generations 4 --population 6 --iterations 1 --simulate --threads 1"
    monkeypatch.setattr("sys.argv", ["identify", *options.split(), "--out", str(tmp_path)])
    identify.main()
    last = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert last["none"]["gap_after_mrad"] == last["none"]["gap_before_mrad"]
    assert 0 <= last["paper"]["frictionloss_error_median"]
    assert last["sysid_3"]["gap_after_mrad"] < last["none"]["gap_after_mrad"]
    result = json.loads((tmp_path / "identification.json").read_text())
    assert set(result["methods"]) == {"none", "paper", "sysid_3", "sysid_6"}
    assert len(result["methods"]["paper"]["values"]["damping"]) == 7 and result["budget"]["generations"] == 4
    assert (tmp_path / "identification.png").stat().st_size > 10_000


def test_recordings_or_a_simulation_must_be_named(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["identify"])
    with pytest.raises(SystemExit):
        identify.main()
    assert "expected recordings, or --simulate" in capsys.readouterr().err
