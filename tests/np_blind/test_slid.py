"""What is read of others' recordings of things that slide, on made ones whose friction and delay are known."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from np_blind.camera.slid import HALF, RATE, STEP, carried, main, replay, tossed


def tray(coefficients, delays, seed=0):
    """Runs of a block on a tray that goes .4 m and back."""
    rng, made = np.random.default_rng(seed), {}
    for k, (coefficient, delay) in enumerate(zip(coefficients, delays)):
        at = np.arange(0.0, 3.0, STEP)
        share = np.clip((at - 0.5) / 0.8, 0.0, 1.0)
        way = 0.4 * (10 * share**3 - 15 * share**4 + 6 * share**5)
        pulls = np.gradient(np.gradient(way, STEP), STEP)
        slid = replay(pulls, coefficient)
        seen = np.arange(0.2, 2.8, 0.02)
        hand, camera = np.zeros((600, 7)), np.zeros((len(seen), 8))
        hand[:, 0] = np.arange(600) * 0.005
        hand[:, 2] = np.interp(hand[:, 0], at, way)
        camera[:, 0], camera[:, 3] = seen, np.interp(seen - delay, at, slid)
        camera[:, 1:4] += 2e-5 * rng.standard_normal((len(seen), 3))
        made |= {f"run_{k}/ee_pose": hand, f"run_{k}/camera": camera}
    return made


def test_a_tray_whose_runs_agree_tells_friction_and_delay():
    found = carried(tray([0.22, 0.22], [0.06, 0.06]))
    assert found["verdict"] == "told" and not found["doubt"]
    for run in found["runs"].values():
        assert run["friction"] == pytest.approx(0.22, abs=0.021) and run["delay"] == pytest.approx(0.06, abs=0.011)
        assert run["left"] < 0.15


@pytest.mark.parametrize(
    ("coefficients", "delays", "doubt"),
    [([0.22, 0.22], [0.02, 0.2], "another time in each run"), ([0.2, 0.26], [0.06, 0.06], "coefficients of")],
)
def test_a_tray_whose_runs_differ_says_nothing(coefficients, delays, doubt):
    found = carried(tray(coefficients, delays))
    assert found["verdict"] == "undetermined" and doubt in found["doubt"]


def test_a_block_holds_on_a_tray_that_is_slow_and_stops_by_friction():
    pulls = np.r_[np.full(500, 1.0), np.full(500, 4.0), np.zeros(1000)]
    slid = replay(pulls, 0.2)
    assert slid[499] == 0.0 and slid[-1] == slid[-200] < slid[999] < 0
    gained = (4.0 - 0.2 * 9.81) * 1.0  # m/s
    assert slid[-1] == pytest.approx(-gained / 2 - gained**2 / (2 * 0.2 * 9.81), rel=0.01)


def tosses(mu, count, seed=3):
    """Cubes that slide to rest, as the published ones are written."""
    rng, made, at = np.random.default_rng(seed), {}, np.arange(70) / RATE
    for k in range(count):
        way, speed = rng.uniform(0, 2 * np.pi), rng.uniform(0.9, 1.3)
        along = np.where(at < speed / (mu * 9.81), speed * at - mu * 9.81 * at**2 / 2, speed**2 / (2 * mu * 9.81))
        row = np.zeros((len(at), 19))
        row[:, :3] = np.column_stack([along * np.cos(way), along * np.sin(way), np.full(len(at), HALF)])
        row[:, :3] = (row[:, :3] + 1e-4 * rng.standard_normal((len(at), 3))) / HALF
        row[:, 3:7] = Rotation.from_rotvec([0, 0, way]).as_quat()[[3, 0, 1, 2]]
        made[f"toss_{k}"] = row
    return made


@pytest.mark.parametrize(("mu", "named"), [(0.25, ["table_friction"]), (0.18, [])])
def test_tosses_tell_the_tables_friction_and_name_it_where_it_is_another(mu, named):
    found = tossed(tosses(mu, 45))
    value, low, high = found["friction"]
    assert low <= mu <= high and found["slides"] >= 40 and found["named"] == named
    assert value == pytest.approx(mu, rel=0.02) and found["groups"]["5"]["held"] >= 0.8 * found["groups"]["5"]["groups"]


def test_the_command_writes_what_it_prints_and_says_what_is_missing(tmp_path, capsys):
    np.savez(tmp_path / "tosses.npz", **tosses(0.25, 45))
    np.savez(tmp_path / "tray.npz", **tray([0.22], [0.06]))
    options = ["--tosses", str(tmp_path / "tosses.npz"), "--tray", str(tmp_path / "tray.npz")]
    assert main([*options, "--out", str(tmp_path / "out.json")]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads((tmp_path / "out.json").read_text())
    with pytest.raises(SystemExit):
        main(["--tosses", "nowhere.npz", "--tray", str(tmp_path / "tray.npz")])
    assert "expected a file, got nowhere.npz" in capsys.readouterr().err
