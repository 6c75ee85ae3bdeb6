"""Sealed sets that another version diagnoses again: what is better, what is worse, and what is chance."""

import json

import pytest

from np_blind.arm import regression
from np_blind.arm.evaluation.scoring import Score


def single(case, right, covered=()):
    return Score(
        case, "single", ["payload@arm"], 4.0, "identified", [], module=right, covered=list(covered), harm=False
    )


def clean(case, alarm):
    return Score(case, "null", [], 0.0, "no_gap", [], false_alarm=alarm, harm=False)


def test_only_cases_of_which_one_is_right_count():
    assert regression.compare_paired([True] * 40, [True] * 40)[0] == 0.0
    difference, (low, high) = regression.compare_paired(
        [True] * 40 + [False] * 2, [True] * 38 + [False] * 2 + [True] * 2
    )
    assert difference == 0.0 and low < 0 < high
    difference, (low, high) = regression.compare_paired([True] * 40, [True] * 30 + [False] * 10)
    assert difference == pytest.approx(-0.25) and high < -0.1 and low > -0.5


def test_figures_are_of_the_cases_that_both_have():
    former = [single(n, True) for n in range(30)] + [clean(n, False) for n in range(30, 60)]
    now = [single(n, n >= 12) for n in range(20)] + [clean(n, n < 50) for n in range(30, 60)]
    rows = {row["figure"]: row for row in regression.compare(former, now)}
    assert (
        rows["module"]["answers"] == [20, 20]
        and rows["module"]["lost"] == list(range(12))
        and rows["module"]["is_worse"]
    )
    assert rows["false_alarm"]["is_worse"] and rows["false_alarm"]["lost"] == list(range(30, 50))
    assert not rows["harm"]["is_worse"] and "pair" not in rows


def test_intervals_are_counted_and_not_paired():
    former, now = [single(0, True, [True] * 50)], [single(0, True, [True] * 20 + [False] * 20)]
    (row,) = [r for r in regression.compare(former, now) if r["figure"] == "covered"]
    assert row["answers"] == [50, 40] and row["former"] == 1.0 and row["now"] == 0.5 and row["is_worse"]


def test_sets_together_keep_cases_of_one_number_apart():
    one, other = [single(1, True)], [single(1, False)]
    former, now = regression.together([(one, other), (other, one)])
    rows = {row["figure"]: row for row in regression.compare(former, now)}
    assert rows["module"]["answers"] == [2, 2] and rows["module"]["gained"] == [1001] and rows["module"]["lost"] == [1]


def test_results_of_two_keys_are_not_compared(tmp_path, capsys):
    paths = []
    for name, key in (("a", "1" * 64), ("b", "2" * 64)):
        paths.append(tmp_path / name)
        figures = {"key_sha256": key, "diagnosis_sha256": "d", "seed": 1}
        paths[-1].write_text(json.dumps({"figures": figures, "cases": []}))
    with pytest.raises(SystemExit):
        regression.main([*map(str, paths), "--out", str(tmp_path / "out.json")])
    assert "expected results of one key" in capsys.readouterr().err
