"""What is asked of the chain's set once it is answered: the experiment that a class names, and harm on more windows."""

import numpy as np
import pytest

from np_blind.chain.cases import draw
from np_blind.chain.harm import patch_of, told
from np_blind.chain.put_down import ask, is_settled

TURNED = draw(19, 20)[18]


def test_an_object_that_is_put_down_where_it_is_measured_settles_a_turned_camera():
    row = ask(TURNED, 20)
    assert row["verdict"] == "identified" and row["settled"] and row["named"] == [["camera_extrinsics"]]
    value, low, high = row["sizes"]["camera_turn"]["camera_turn_x"]
    assert low < value < high and value == pytest.approx(TURNED.gap["camera_extrinsics"]["turn_x"], abs=0.002)


@pytest.mark.parametrize(
    "named", [[], [["camera_extrinsics", "keypoint_bias"]], [["camera_extrinsics"], ["table_height"]]]
)
def test_a_class_or_what_is_not_there_settles_nothing(named):
    assert is_settled(TURNED, [["camera_extrinsics"]]) and not is_settled(TURNED, named)


def test_harm_is_asked_of_what_was_measured_in_all_windows_that_are_known():
    row = {"named": [["table_friction"]], "intervals": {"table": {"value": 0.5}, "mass": {"value": 0.3}}}
    (given,) = patch_of(row).effects
    assert given.effect == "table_friction" and given.parameters == {"relative": pytest.approx(0.25)}
    one = {"believed": [1.0, 2.0], "patch": [1.2, 2.4], "truth": [0.5, np.nan]}
    found = told({"recordings": [one, {**one, "truth": [0.5, 1.0]}]})
    assert found["windows"] == 3 and found["patch_removes"] == pytest.approx([-0.2] * 3)
    assert found["truth_removes"][0] == pytest.approx(0.5)
