"""The rehearsal without its episodes: shares, what is kept, what is said, and the loop around withheld robots."""

import json
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import yaml

from np_bringup.commands.rehearse import parse
from np_bringup.rehearsal import playing, stages
from np_bringup.rehearsal.learning import Learning, carried
from np_bringup.rehearsal.page import render, sentence
from np_bringup.rehearsal.playing import Cell, patch_of, play_all, text_of
from np_bringup.rehearsal.shares import joined, parts, shapley, subsets, with_intervals
from np_bringup.rehearsal.stages import Rehearsal, rehearse
from np_effects.patch import Patch, PatchEffect

FRICTION = PatchEffect("coulomb_friction", "panda_joint4", {"level": 2.0})
GRIP = PatchEffect("gripper_friction", "contact", {"relative": -0.4})
CAMERA = PatchEffect("camera_extrinsics", "camera", {"x": 0.0, "y": 0.01})
TABLE = PatchEffect("table_height", "environment", {"height": 0.005})
BOTH = Patch((FRICTION, GRIP))
WEIGHTS = {"weights": "new", "weights_old_student": "old"}


class Here:
    """An executor that does everything at once, in this process."""

    def submit(self, case, /, *arguments) -> Future:
        done = Future()
        done.set_result(case(*arguments))
        return done


def losing(chances):
    """In place of episodes: a tenth of them each, of ten, is lost to an effect that `chances` names, by its tenths."""

    def play(cell, numbers):
        lost = {tenth for e in patch_of(cell.effects).effects for tenth in chances.get(e.effect, ())}
        if cell.weights:  # what training brings back, and the new student spoils
            lost = {tenth for tenth in lost if tenth > 2} | ({9} if cell.weights.endswith("/new") else set())
        return [number % 10 not in lost for number in numbers]

    return play


class TestShares:
    def test_of_two_that_meet_each_has_half_of_what_they_share(self):
        success = {
            frozenset(): np.ones(4),
            frozenset("a"): np.array([0, 1, 1, 1.0]),
            frozenset("b"): np.array([0, 0, 1, 1.0]),
            frozenset("ab"): np.array([0, 0, 1, 1.0]),
        }
        costs = shapley("ab", success)
        assert costs["a"].tolist() == [0.5, 0, 0, 0] and costs["b"].tolist() == [0.5, 1, 0, 0]

    def test_shares_sum_to_what_all_cost_together(self):
        names, rng = list("abcd"), np.random.default_rng(3)
        success = {some: rng.integers(0, 2, 30).astype(float) for some in subsets(names)}
        costs = shapley(names, success)
        lost = success[frozenset()] - success[frozenset(names)]
        assert len(success) == 16 and np.allclose(sum(costs.values()), lost)
        told = with_intervals(costs)
        assert list(told) == sorted(told, key=lambda name: -told[name]["value"])

    def test_many_effects_are_blamed_by_kind_then_by_module(self):
        joints = [replace(FRICTION, component=f"panda_joint{k}") for k in range(1, 8)]
        assert set(parts(BOTH)) == {"coulomb_friction at panda_joint4", "gripper_friction at contact"}
        assert set(parts(Patch((*joints, GRIP)))) == {"coulomb_friction", "gripper_friction"}
        whole = joined(parts(Patch((*joints, GRIP))), frozenset({"coulomb_friction"}))
        assert whole.effects == tuple(joints)


class TestPlaying:
    def test_what_was_played_is_not_played_again(self, tmp_path, monkeypatch):
        asked = []

        def play(cell, numbers):
            asked.extend(numbers)
            return [number != 3 for number in numbers]

        monkeypatch.setattr(playing, "play", play)
        cells = {"nominal": Cell("wall")}
        assert play_all(cells, 4, tmp_path, Here()) == {"nominal": [True, True, True, False]}
        assert play_all(cells, 7, tmp_path, Here())["nominal"] == [True, True, True, False, True, True, True]
        assert asked == [*range(7)]
        with pytest.raises(ValueError, match="expected successes of Cell"):
            play_all({"nominal": Cell("bump")}, 4, tmp_path, Here())

    def test_a_patch_comes_back_from_its_text(self):
        assert patch_of(text_of(BOTH)) == BOTH and text_of(Patch()) == "" and patch_of("") == Patch()

    def test_an_episode_is_played_with_what_the_cell_says(self):
        cell = Cell("wall", effects=text_of(Patch((replace(GRIP, parameters={"relative": -0.85}),))), seed=3)
        assert playing.play(replace(cell, effects=""), [0]) == [True]
        assert playing.play(cell, [0]) == [False]


@pytest.fixture
def told(tmp_path, monkeypatch):
    """A rehearsal with a stand-in for episodes and for training."""
    monkeypatch.setattr(playing, "play", losing({"coulomb_friction": (0, 1, 2), "gripper_friction": (2, 3)}))

    def learn(domain, patch, out, how, weights=""):
        rows = ["elapsed,success,episodes", "0,0.5,10", "60,0.9,10"]
        (out / "training").mkdir(parents=True)
        (out / "training" / "log.csv").write_text("\n".join(rows) + "\n")
        weights = {"weights": str(out / "new"), "weights_old_student": str(out / "old")}
        return {**weights, "device": "cpu", "train": {"wall_s": 60.0}}

    monkeypatch.setattr(stages, "learn", learn)
    reality = Cell("wall", "physx", text_of(BOTH))
    return rehearse(Rehearsal(Cell("wall"), tmp_path, reality, 20, 20), BOTH, Learning(1.0), Here())


class TestStages:
    def test_from_a_patch_to_what_comes_back(self, told, tmp_path):
        assert (told["success_nominal"], told["success_predicted"]) == (1.0, 0.6)
        assert (told["success_before"], told["success_after"], told["success_after_predicted"]) == (0.6, 0.9, 0.9)
        assert told["cause"] == "coulomb_friction at panda_joint4" and told["adopted"]
        assert told["learned"]["student"] == "old" and told["success"]["patched_new_student"]["value"] == 0.8
        costs = {name: cost["value"] for name, cost in told["costs"].items()}
        assert costs == pytest.approx({"coulomb_friction at panda_joint4": 0.25, "gripper_friction at contact": 0.15})
        assert json.loads((tmp_path / "rehearsal.json").read_text())["cause"] == told["cause"]

    def test_policies_that_are_no_better_are_not_taken(self, tmp_path, monkeypatch):
        monkeypatch.setattr(playing, "play", losing({"coulomb_friction": (5, 6)}))
        monkeypatch.setattr(stages, "learn", lambda *given: {**WEIGHTS, "device": "cpu", "train": {"wall_s": 1.0}})
        reality = Cell("wall", "physx", text_of(BOTH))
        told = rehearse(Rehearsal(Cell("wall"), tmp_path, reality, 10, 10), BOTH, Learning(1.0), Here())
        assert told["cause"] == "coulomb_friction at panda_joint4"  # the other one costs nothing
        assert not told["adopted"] and told["success_after"] == told["success_before"] == 0.8
        assert "keep the old ones" in sentence(told)

    def test_without_a_gap_nothing_is_trained(self, tmp_path, monkeypatch):
        monkeypatch.setattr(playing, "play", losing({}))
        told = rehearse(Rehearsal(Cell("wall"), tmp_path, None, 10, 10), Patch(), Learning(1.0), Here())
        assert told["weights"] is None and told["cause"] is None and told["success_before"] is None
        assert sentence(told) == "The doctor found no gap: there is nothing to train for."

    def test_what_training_does_not_have_is_left_out_of_it_in_words(self):
        patch, left = carried(Patch((CAMERA, TABLE)))
        assert patch == Patch((CAMERA,)) and left == ["table_height at environment"]

    def test_the_page_says_it_in_words(self, told, tmp_path):
        text = render(told, BOTH, tmp_path)
        assert "joint 4 has 2.00 Nm more dry friction" in text and text.count("<svg") == 3
        assert (
            sentence(told) in text and "Most of it goes to coulomb friction at panda joint4: 25 of 40 points." in text
        )

    def test_recordings_or_a_patch_but_not_both(self, capsys):
        for given in ([], ["bag", "--patch", "patch.yaml"], ["bag", "--minutes", "6"]):
            with pytest.raises(SystemExit):
                parse(given)
        assert "expected recordings, or --patch" in capsys.readouterr().err


class TestRobots:
    """The withheld robots, with a stand-in for PhysX."""

    def test_what_is_drawn_is_of_the_seed_and_grows_with_its_size(self):
        from np_blind.robot_cases import ORDER, drawn

        for number in range(len(ORDER)):
            domain, of_size = drawn(number, 5, 0)
            assert domain == ("bump" if "object" in ORDER[number] else ("wall", "bump")[number % 2])
            assert of_size(0.5) == drawn(number, 5, 0)[1](0.5)
            small, large = (of_size(size).effects for size in (0.2, 0.9))
            assert len(small) == len(ORDER[number].split())
            for one, other in zip(small, large):
                reach = [max(map(abs, e.parameters.values())) for e in (one, other)]
                assert 0 < reach[0] < reach[1]
            text_of(of_size(1.0)) and yaml.safe_load(text_of(of_size(1.0)))

    def test_all_that_is_drawn_is_physical(self, tmp_path):
        from np_blind.robot_cases import drawn
        from np_effects.patch import load_patch

        for seed in range(6):
            for number in range(12):
                file = tmp_path / "patch.yaml"
                file.write_text(text_of(drawn(number, seed, 0)[1](1.0)))
                assert load_patch(file).effects

    def test_a_size_is_found_that_loses_enough(self):
        from np_blind.robot_cases import drawn
        from np_blind.robot_sizes import MIDDLE, find_robot

        def loss(domain, patch):
            values = [abs(v) for e in patch.effects for v in e.parameters.values()]
            return 0.0 if patch.effects[0].effect == first else min(1.0, sum(values) / whole)

        first = drawn(3, 5, 0)[1](1.0).effects[0].effect
        whole = 0.5
        robot = find_robot(3, 5, loss, 32)
        assert MIDDLE[0] <= robot.loss <= MIDDLE[1] and robot.effects[0].effect != first

    def test_figures_of_robots(self):
        from np_blind.robot_figures import figures, mmrv, pearson

        def row(before, adopted, oracle, cause, costs, ablation):
            engine = {
                "nominal": [1] * 10,
                "before": [1] * before + [0] * (10 - before),
                "after": [1] * adopted + [0] * (10 - adopted),
                "adopted": [1] * adopted + [0] * (10 - adopted),
                "oracle": [1] * oracle + [0] * (10 - oracle),
            }
            costs = {name: {"value": value} for name, value in costs.items()}
            return {"engine": engine, "cause": cause, "costs": costs, "ablation": ablation, "adopted": True}

        rows = [
            row(6, 9, 10, "a at x", {"a at x": 0.3, "b": 0.1}, {"a": 0.3, "b": 0.2}),
            row(7, 6, 9, "b", {"b": 0.2}, {"c": 0.25}),
            {"error": "the time was over"},
        ]
        found = figures(rows)
        assert found["top cause named"]["value"] == 0.5 and found["worse than before"] == {"value": 1, "of": 2}
        assert found["lost success that returns, median"]["each"] == [0.75, -0.333]
        assert found["of the oracle's, median"]["each"] == [0.75, -0.5]
        assert found["rank correlation of costs with ablation"]["of"] == 3 and found["not finished"]["value"] == 1
        assert pearson([0.1, 0.5, 0.9], [0.2, 0.4, 0.6]) == pytest.approx(1.0)
        assert mmrv([0.1, 0.5, 0.9], [0.2, 0.4, 0.6]) == 0.0
        assert mmrv([0.5, 0.1, 0.9], [0.2, 0.4, 0.6]) == pytest.approx((0.2 + 0.2) / 3)

    def test_a_robot_that_is_settled_is_settled_once(self, tmp_path, monkeypatch):
        from np_blind import robot_answering
        from np_blind.robot_cases import Robot

        monkeypatch.setattr(playing, "play", losing({"coulomb_friction": (0, 1, 2), "gripper_friction": (2, 3)}))
        asked = []

        def diagnosis(log, tasks):
            asked.append(tasks)
            return log, {"arm": "identified"}

        def learn(domain, patch, out, how, weights=""):
            out.mkdir(parents=True, exist_ok=True)
            return {**WEIGHTS, "device": "cpu", "train": {"wall_s": 1.0}}

        monkeypatch.setattr("np_blind.robot_recording.recorded_arm", lambda patch, seed: patch)
        monkeypatch.setattr("np_blind.robot_recording.recorded_task", lambda patch, seed: seed)
        monkeypatch.setattr("np_blind.robot_recording.diagnosis", diagnosis)
        monkeypatch.setattr(stages, "learn", learn)
        judging = robot_answering.Judging(tmp_path, 1, 10, 10, Learning(1.0))
        robots = [Robot(0, "wall", BOTH.effects, 0.3, 32)]
        for _ in range(2):
            (row,) = robot_answering.settle_all(robots, judging, Here(), robot_answering.Turns([]))
        assert "error" not in row, row["error"]
        assert asked == [[1000, 1001]]
        assert row["ablation"] == pytest.approx({"coulomb_friction": 0.2, "gripper_friction": 0.1})
        assert sum(row["engine"]["oracle"]) == sum(row["engine"]["adopted"]) == 9
        assert robot_answering.answered(robots, judging) == [row]

    def test_no_stage_is_begun_when_the_time_is_over(self, tmp_path, monkeypatch):
        from np_blind import robot_answering
        from np_blind.robot_cases import Robot

        monkeypatch.setattr(playing, "play", losing({}))
        judging = robot_answering.Judging(tmp_path, 1, 10, 10, Learning(1.0), until=0.0)
        robots = [Robot(0, "wall", BOTH.effects, 0.3, 32)]
        (row,) = robot_answering.settle_all(robots, judging, Here(), robot_answering.Turns([]))
        assert row["error"] == "the time was over"

    def test_a_recording_is_what_the_doctor_reads(self):
        from np_blind.robot_recording import record_arm
        from np_diagnosis.arm.model import panda
        from np_diagnosis.checks.plausibility import check
        from np_sim_bridge.mujoco_engine import MujocoEngine

        log = record_arm(Patch((FRICTION,)), 3, MujocoEngine, ("sweep_4",))
        check(log, panda())
        assert 20 < log.duration < 24 and log.phases[0][1].experiment == "sweep_4" and log.commands.has_law
        assert np.abs(log.commands.target[:, 3] - log.position[:, 3]).max() > 1e-3

    def test_policies_of_a_matrix_are_ranked_within_a_robot(self):
        from np_blind.robot_matrix import figures

        rows = [(0, 0.9, 0.5, 0.5), (0, 1.0, 0.3, 0.3), (1, 0.9, 0.8, 0.8), (1, 1.0, 0.9, 0.9)]
        table = [dict(zip(("robot", "nominal", "patched", "engine"), row)) for row in rows]
        found = figures(table)
        assert found["patched"] == pytest.approx({"r": 1.0, "mmrv": 0.0, "mean_absolute_error": 0.0})
        assert found["nominal"]["mmrv"] == pytest.approx(0.1) and found["cells"] == 4

    def test_who_may_be_last_lets_others_go_first(self):
        from np_blind.robot_answering import Turns

        turns, order = Turns([0]), []

        def train(name, last):
            with turns(last) as gpu:
                order.append((name, gpu))

        with ThreadPoolExecutor(2) as threads:
            with turns() as gpu:
                assert gpu == 0
                threads.submit(train, "oracle", True)
                threads.submit(train, "own", False)
                with turns._changed:
                    assert turns._changed.wait_for(lambda: turns._first, 10)  # it waits
                order.append("free")
        assert order == ["free", ("own", 0), ("oracle", 0)]

    def test_pages_of_results_say_what_came_of_every_robot(self):
        from pages.robots import matrix, robots

        engine = {"nominal": [1] * 10, "before": [1, 0] * 5, "after": [1] * 9 + [0], "adopted": [1] * 9 + [0]}
        done = {
            "robot": 0,
            "domain": "wall",
            "truth": text_of(BOTH),
            "found": text_of(Patch((FRICTION,))),
            "cause": "coulomb_friction at panda_joint4",
            "costs": {"coulomb_friction at panda_joint4": {"value": 0.3}},
            "ablation": {"coulomb_friction": 0.4, "gripper_friction": 0.1},
            "adopted": True,
            "success": {name: {"value": value} for name, value in (("nominal", 1.0), ("patched", 0.6))},
            "engine": engine,
        }
        rows = [done, {"robot": 1, "domain": "bump", "truth": text_of(BOTH), "error": "the time was over"}]
        from np_blind.robot_figures import figures

        about = {"drawn": 12, "episodes": 10, "minutes": 2.0, "gpus": 2, "wall_s": 60.0}
        sealed = {"key_sha256": "a" * 64, "doctor_sha256": "b" * 64}
        headline, body = robots({**about, **sealed, "figures": figures(rows), "rows": rows})
        assert headline.startswith("2 of 12 robots: top cause named 1.00 of 1")
        assert "| 0.50 (0.60) | 0.90 |" in body and "the time was over" in body
        sides = {"r": 0.9, "mmrv": 0.02, "mean_absolute_error": 0.1}
        cell = {"robot": 0, "domain": "wall", "policy": "soft_on", "nominal": 1.0, "patched": 0.5, "engine": 0.4}
        table = {"figures": {"nominal": sides, "patched": sides, "cells": 1}, "episodes": 10, "table": [cell]}
        assert "| 0 wall | soft on | 1 | 0.5 | 0.4 |" in matrix(table)[1]
