"""The loop around withheld robots, with stand-ins for PhysX, for what is recorded and for training."""

import json
import re
import threading
from dataclasses import replace

import numpy as np
import pytest
import yaml
from finetune_doubles import BOTH, FRICTION, WEIGHTS, Here, losing
from sim2real.effects.patch import Patch

from np_evaluation.finetune import rollouts as playing
from np_evaluation.finetune import stages
from np_evaluation.finetune.learning import Learning
from np_evaluation.finetune.rollouts import text_of


def test_what_is_drawn_is_of_the_seed_and_grows_with_its_size():
    from np_blind.robots.cases import ORDER, draw_robot

    for number in range(len(ORDER)):
        domain, of_size = draw_robot(number, 5, 0)
        assert domain == ("bump" if "object" in ORDER[number] else ("wall", "bump")[number % 2])
        assert of_size(0.5) == draw_robot(number, 5, 0)[1](0.5)
        small, large = (of_size(size).effects for size in (0.2, 0.9))
        assert len(small) == len(ORDER[number].split())
        for one, other in zip(small, large):
            reach = [max(map(abs, e.parameters.values())) for e in (one, other)]
            assert 0 < reach[0] < reach[1]
        text_of(of_size(1.0)) and yaml.safe_load(text_of(of_size(1.0)))


def test_all_that_is_drawn_is_physical(tmp_path):
    from sim2real.effects.patch import load_patch

    from np_blind.robots.cases import draw_robot

    for seed in range(6):
        for number in range(12):
            file = tmp_path / "patch.yaml"
            file.write_text(text_of(draw_robot(number, seed, 0)[1](1.0)))
            assert load_patch(file).effects


def test_a_size_is_found_that_loses_enough():
    from np_blind.robots.cases import draw_robot
    from np_blind.robots.effect_sizes import MIDDLE, find_robot

    def loss(domain, patch):
        values = [abs(v) for e in patch.effects for v in e.parameters.values()]
        return 0.0 if patch.effects[0].effect == first else min(1.0, sum(values) / whole)

    first = draw_robot(3, 5, 0)[1](1.0).effects[0].effect
    whole = 0.5
    robot = find_robot(3, 5, loss, 32)
    assert MIDDLE[0] <= robot.loss <= MIDDLE[1] and robot.effects[0].effect != first


@pytest.mark.parametrize("edge", (0.35, 0.4, 0.55))
def test_from_an_edge_a_size_is_not_far(edge):
    from np_blind.robots.cases import LOSS, draw_robot
    from np_blind.robots.effect_sizes import TRIED, find_robot

    whole = sum(abs(v) for e in draw_robot(1, 5, 0)[1](1.0).effects for v in e.parameters.values())
    asked = []

    def steep(domain, patch):  # nothing, and 6 % of the size later everything
        size = sum(abs(v) for e in patch.effects for v in e.parameters.values()) / whole
        asked.append(size)
        return float(np.clip((size / edge - 0.98) / 0.06, 0, 1))

    robot = find_robot(1, 5, steep, 24)
    assert LOSS[0] <= robot.loss <= LOSS[1] and len(asked) <= TRIED and max(asked) < 2 * edge


def test_fewer_pairs_are_played_where_fewer_say_enough(tmp_path, monkeypatch):
    from np_blind.robots.effect_sizes import Measured

    asked = []

    def play(cell, numbers):
        asked.extend(numbers if cell.effects else ())
        return [not cell.effects or number % every != 0 for number in numbers]

    monkeypatch.setattr(playing, "run_rollouts", play)
    for every, pairs in ((1, 8), (2, 16), (4, 32)):
        asked.clear()
        assert Measured(Here(), 32, tmp_path / str(every)).loss("wall", BOTH) == 1 / every
        assert asked == [*range(pairs)]
    asked.clear()
    assert Measured(Here(), 32, tmp_path / "4").loss("wall", BOTH) == 0.25 and not asked


def test_figures_of_robots():
    from np_blind.robots.figures import figures
    from np_blind.robots.prediction import mmrv, pearson

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


def test_shares_that_return_have_an_interval_and_a_picture(tmp_path):
    from np_blind.robots.figures import figures
    from np_blind.robots.plot import plot_robots

    engine = {"nominal": [1] * 10, "before": [1] * 5 + [0] * 5, "adopted": [1] * 8 + [0] * 2, "after": None}
    row = {"engine": engine, "ablation": {"payload": 0.5}, "costs": {}, "cause": None, "kept": "corrected"}
    name = "lost success that returns, median"
    assert "ci95" not in figures([row] * 5)[name]
    found = figures([row] * 12)[name]
    low, high = found["ci95"]
    assert found["value"] == pytest.approx(0.6) and 0.3 < low < 0.6 < high < 0.9
    told = {"robot": 3, "domain": "wall", "success": {"patched": {"value": 0.5}, "patched_corrected": {"value": 0.8}}}
    plot_robots([row | told, {"engine": {}}], tmp_path / "robots.svg")
    assert (tmp_path / "robots.svg").stat().st_size > 1000
    other = told | {"success": {"patched": {"value": 0.4}}}
    found = figures([row | one for one in [told] * 3 + [other] * 3])  # .5 and .8 of .5 before; corrected is not known
    assert found["mean error of stages"]["value"] == pytest.approx(0.05) and found["mean error of stages"]["of"] == 6
    assert found["r of stages"]["value"] is None and found["MMRV of stages"]["value"] == 0


def test_a_robot_that_is_settled_is_settled_once(tmp_path, monkeypatch):
    from np_blind.robots import evaluation as robot_answering
    from np_blind.robots.cases import Robot

    monkeypatch.setattr(playing, "run_rollouts", losing({"coulomb_friction": (0, 1, 2), "gripper_friction": (2, 3)}))
    asked = []

    def diagnosis(log, tasks):
        asked.append(tasks)
        return log, {"arm": "identified"}

    def learn(domain, patch, out, how, *rest):
        out.mkdir(parents=True, exist_ok=True)
        return {**WEIGHTS, "device": "cpu", "train": {"wall_s": 1.0}}

    monkeypatch.setattr("np_blind.robots.recording.record_arm_physx", lambda patch, seed: patch)
    monkeypatch.setattr("np_blind.robots.recording.record_task_physx", lambda patch, seed: seed)
    monkeypatch.setattr("np_blind.robots.recording.diagnose_robot", diagnosis)
    monkeypatch.setattr(stages, "train_and_distill", learn)
    judging = robot_answering.EvaluationConfig(tmp_path, 1, 10, 10, Learning(1.0))
    robots = [Robot(0, "wall", BOTH.effects, 0.3, 32)]
    for _ in range(2):
        (row,) = robot_answering.evaluate_robots(robots, judging, Here(), robot_answering.GpuPool([]))
    assert "error" not in row, row["error"]
    assert asked == [[1000, 1001]]
    assert row["ablation"] == pytest.approx({"coulomb_friction": 0.2, "gripper_friction": 0.1})
    assert row["ablation_scores"] == pytest.approx(row["ablation"])  # the stand-in's scores are 0 and 1
    taken = {name.partition(" at ")[0]: cost["taken_out"]["value"] for name, cost in row["costs"].items()}
    assert taken == pytest.approx(row["ablation"])
    assert sum(row["engine"]["oracle"]) == sum(row["engine"]["adopted"]) == 9


def test_where_corrections_are_all_the_oracle_takes_no_training(tmp_path, monkeypatch):
    from np_blind.robots import evaluation as robot_answering
    from np_blind.robots.cases import Robot

    both = stand_ins(monkeypatch, None)  # would raise
    robots = [Robot(0, "wall", (FRICTION,), 0.3, 32)]
    judging = robot_answering.EvaluationConfig(tmp_path, 1, 10, 10, None)
    assert judging.asks_oracle(robots[0]) and not judging.asks_oracle(both[0])
    assert not replace(judging, oracle="none").asks_oracle(robots[0])
    assert replace(judging, how=Learning(1.0)).asks_oracle(both[0])
    (row,) = robot_answering.evaluate_robots(robots, judging, Here(), robot_answering.GpuPool([]))
    assert "error" not in row and row["engine"]["oracle"] == row["engine"]["corrected"]


def test_a_recording_is_what_the_diagnosis_reads():
    from sim2real.arm.model import panda
    from sim2real.checks.plausibility import check_plausibility

    from np_blind.robots.recording import record_arm
    from np_description.mujoco_engine import MujocoEngine

    log = record_arm(Patch((FRICTION,)), 3, MujocoEngine, ("sweep_4",))
    check_plausibility(log, panda())
    assert 20 < log.duration < 24 and log.phases[0][1].experiment == "sweep_4" and log.commands.has_law
    assert np.abs(log.commands.target[:, 3] - log.position[:, 3]).max() > 1e-3


def test_policies_of_a_matrix_are_ranked_within_a_robot():
    from np_blind.robots.matrix import figures

    rows = [(0, 0.9, 0.5, 0.5), (0, 1.0, 0.3, 0.3), (1, 0.9, 0.8, 0.8), (1, 1.0, 0.9, 0.9)]
    table = [dict(zip(("robot", "nominal", "patched", "engine"), row)) for row in rows]
    found = figures(table, 10)
    assert found["patched"] == pytest.approx({"r": 1.0, "mmrv": 0.0, "mean_absolute_error": 0.0})
    assert found["nominal"]["mmrv"] == pytest.approx(0.1) and found["cells"] == 4
    more = [{**row, "robot": row["robot"] + 2 * number} for number in range(3) for row in table]
    low, high = figures(more, 10)["nominal"]["mmrv_ci95"]
    assert figures(more, 10)["patched"]["r_ci95"] == pytest.approx([1.0, 1.0]) and low < 0.1 < high
    # Of .3 and .5, or .8 and .9, ten episodes do not show which is more; a million do.
    few, many = (figures(more, episodes)["exact"] for episodes in (10, 1_000_000))
    assert few["r"] < 0.9 < many["r"] and many["mmrv"] == 0.0 < few["mmrv"]


def test_a_matrix_takes_the_released_policies_episodes_from_the_set(tmp_path):
    from np_blind.robots.cases import Robot
    from np_blind.robots.evaluation import TASKS, reality_of
    from np_blind.robots.matrix import scores_of_released

    robots = [Robot(n, "wall", BOTH.effects, 0.3, 32) for n in (0, 1)]
    nominal = playing.RolloutCell("wall", seed=TASKS)
    cells = {"patched": replace(nominal, effects=text_of(BOTH)), "reality": reality_of(robots[0])}
    for number, episodes in ((0, 20), (1, 10)):
        (tmp_path / f"robot_0{number}").mkdir()
        (tmp_path / f"robot_0{number}" / "patch.yaml").write_text(text_of(BOTH))
        kept = playing.CachedScores(tmp_path / f"robot_0{number}" / "episodes", cells)
        for name, score in (("patched", 0.75), ("reality", 0.5)):
            kept.add(name, range(episodes), [score] * episodes)
    playing.CachedScores(tmp_path / "nominal", {"wall_mujoco": nominal}).add("wall_mujoco", range(20), [1.0] * 20)
    names = ("nominal_wall_released", "patched_0_released", "engine_0_released")
    assert scores_of_released(robots, tmp_path, 20) == dict(zip(names, ([1.0] * 20, [0.75] * 20, [0.5] * 20)))


def stand_ins(monkeypatch, learn, lost=None):
    """In place of recordings, diagnosis and training; a robot with two effects, both of which the diagnosis finds."""
    from np_blind.robots.cases import Robot

    monkeypatch.setattr(
        playing, "run_rollouts", losing(lost or {"coulomb_friction": (0, 1, 2), "gripper_friction": (2, 3)})
    )
    monkeypatch.setattr("np_blind.robots.recording.record_arm_physx", lambda patch, seed: patch)
    monkeypatch.setattr("np_blind.robots.recording.record_task_physx", lambda patch, seed: seed)
    monkeypatch.setattr("np_blind.robots.recording.diagnose_robot", lambda log, tasks: (log, {"arm": "identified"}))
    monkeypatch.setattr(stages, "train_and_distill", learn)
    return [Robot(0, "wall", BOTH.effects, 0.3, 32)]


def test_where_training_dies_the_row_has_what_is_known(tmp_path, monkeypatch):
    from np_blind.robots import evaluation as robot_answering
    from np_blind.robots.figures import figures

    def learn(*given):
        raise OSError("np_training.train ended with status 1: out of memory")

    robots = stand_ins(monkeypatch, learn)
    judging = robot_answering.EvaluationConfig(tmp_path, 1, 10, 10, Learning(1.0), oracle="none")
    (row,) = robot_answering.evaluate_robots(robots, judging, Here(), robot_answering.GpuPool([]))
    assert (
        re.search('File "benchmark/np_blind/(?s:.*)out of memory', row["error"])
        and row["cause"] == "coulomb_friction at panda_joint4"
    )
    assert row["success"]["patched"]["value"] == 0.6 and sum(row["engine"]["before"]) == 6
    assert row["ablation"] == pytest.approx({"coulomb_friction": 0.2, "gripper_friction": 0.1})
    found = figures([row])
    assert found["top cause named"]["value"] == 1 and found["lost success that returns, median"]["of"] == 0
    stand_ins(monkeypatch, lambda *given: {**WEIGHTS, "device": "cpu", "train": {"wall_s": 1.0}})
    (row,) = robot_answering.evaluate_robots(robots, judging, Here(), robot_answering.GpuPool([]))
    assert "error" not in row and sum(row["engine"]["adopted"]) == 9  # the same again goes on


def test_an_interrupted_loop_ends_what_is_under_way(tmp_path, monkeypatch):
    from np_blind.robots import evaluation as robot_answering

    training, ended = threading.Event(), []

    def learn(domain, patch, out, how, weights, is_over):
        training.set()
        while not is_over():
            threading.Event().wait(0.01)
        ended.append(True)
        raise OSError("ended")

    robots = stand_ins(monkeypatch, learn)
    judging = robot_answering.EvaluationConfig(tmp_path, 1, 10, 10, Learning(1.0), oracle="none")

    def interrupted(futures):
        training.wait(10)
        raise KeyboardInterrupt

    monkeypatch.setattr(robot_answering, "as_completed", interrupted)
    with pytest.raises(KeyboardInterrupt):
        robot_answering.evaluate_robots(robots, judging, Here(), robot_answering.GpuPool([]))
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join(10)
    assert ended and json.loads((tmp_path / "robot_00/row.json").read_text())["error"]


def test_a_robot_that_is_not_found_costs_the_others_nothing(tmp_path, monkeypatch):
    from np_blind.robots import effect_sizes as robot_sizes

    def find(number, seed, loss, episodes):
        if number:
            raise ValueError(f"robot {number}: none")
        return loss("wall", BOTH)

    monkeypatch.setattr(playing, "run_rollouts", losing({"coulomb_friction": (0, 1, 2), "gripper_friction": (2, 3)}))
    monkeypatch.setattr(robot_sizes, "find_robot", find)
    found, why = robot_sizes.find_robots(2, 5, Here(), 10, tmp_path)
    assert found == pytest.approx([0.4]) and why == ["robot 1: none"]
    monkeypatch.setattr(playing, "run_rollouts", None)  # all of it is kept
    assert robot_sizes.find_robots(2, 5, Here(), 10, tmp_path)[0] == found
