"""Finetuning without its episodes: shares, what is kept, what is said."""

import json
import threading
from concurrent.futures import Future
from dataclasses import replace

import numpy as np
import pytest
from bags import record_episode
from finetune_doubles import BOTH, FRICTION, GRIP, WEIGHTS, Here, losing
from sim2real.effects.patch import Patch, PatchEffect, load_patch

from np_evaluation.commands import finetune as command
from np_evaluation.commands.finetune import parse
from np_evaluation.finetune import rollouts as playing
from np_evaluation.finetune import stages
from np_evaluation.finetune.learning import Learning, split_trainable
from np_evaluation.finetune.page import render, sentence
from np_evaluation.finetune.rollouts import RolloutCell, patch_of, run_all_rollouts, text_of
from np_evaluation.finetune.shapley_values import join_patches, shapley, split_patch, subsets, with_intervals
from np_evaluation.finetune.stages import FinetuneSettings, run_finetune

CAMERA = PatchEffect("camera_extrinsics", "camera", {"x": 0.0, "y": 0.01})
TABLE = PatchEffect("table_height", "environment", {"height": 0.005})


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
        assert set(split_patch(BOTH)) == {"coulomb_friction at panda_joint4", "gripper_friction at contact"}
        assert set(split_patch(Patch((*joints, GRIP)))) == {"coulomb_friction", "gripper_friction"}
        whole = join_patches(split_patch(Patch((*joints, GRIP))), frozenset({"coulomb_friction"}))
        assert whole.effects == tuple(joints)


class TestPlaying:
    def test_what_was_played_is_not_played_again(self, tmp_path, monkeypatch):
        asked = []

        def play(cell, numbers):
            asked.extend(numbers)
            return [number != 3 for number in numbers]

        monkeypatch.setattr(playing, "run_rollouts", play)
        cells = {"nominal": RolloutCell("wall")}
        assert run_all_rollouts(cells, 4, tmp_path, Here()) == {"nominal": [True, True, True, False]}
        assert run_all_rollouts(cells, 7, tmp_path, Here())["nominal"] == [True, True, True, False, True, True, True]
        assert asked == [*range(7)]
        with pytest.raises(ValueError, match="expected scores of RolloutCell"):
            run_all_rollouts({"nominal": RolloutCell("bump")}, 4, tmp_path, Here())

    def test_where_an_episode_raises_the_others_are_kept(self, tmp_path, monkeypatch):
        def play(cell, numbers):
            if 0 in numbers:
                raise RuntimeError("a fault")
            return [True for _ in numbers]

        class Pool(Here):
            def submit(self, case, /, *arguments):
                try:
                    return super().submit(case, *arguments)
                except RuntimeError as error:
                    failed = Future()
                    failed.set_exception(error)
                    return failed

        monkeypatch.setattr(playing, "run_rollouts", play)
        with pytest.raises(RuntimeError, match="a fault"):
            run_all_rollouts({"nominal": RolloutCell("wall")}, 6, tmp_path, Pool())
        assert list(json.loads((tmp_path / "nominal.json").read_text())["score"]) == ["2", "3", "4", "5"]

    def test_a_patch_comes_back_from_its_text(self):
        assert patch_of(text_of(BOTH)) == BOTH and text_of(Patch()) == "" and patch_of("") == Patch()

    @pytest.mark.slow
    def test_an_episode_is_played_with_what_the_cell_says(self):
        cell = RolloutCell("wall", effects=text_of(Patch((replace(GRIP, parameters={"relative": -0.85}),))), seed=3)
        assert 0.5 < playing.run_rollouts(replace(cell, effects=""), [0])[0] <= 1.0
        assert playing.run_rollouts(cell, [0]) == [0.0]


@pytest.fixture
def told(tmp_path, monkeypatch):
    """Finetuning with a stand-in for episodes and for training."""
    monkeypatch.setattr(playing, "run_rollouts", losing({"coulomb_friction": (0, 1, 2), "gripper_friction": (2, 3)}))

    def learn(domain, patch, out, how, *rest):
        rows = ["elapsed,success,episodes", "0,0.5,10", "60,0.9,10"]
        (out / "training").mkdir(parents=True)
        (out / "training" / "log.csv").write_text("\n".join(rows) + "\n")
        weights = {"weights": str(out / "new"), "weights_old_student": str(out / "old")}
        return {**weights, "device": "cpu", "train": {"wall_s": 60.0}}

    monkeypatch.setattr(stages, "train_and_distill", learn)
    reality = RolloutCell("wall", "physx", text_of(BOTH))
    return run_finetune(FinetuneSettings(RolloutCell("wall"), tmp_path, reality, 20, 20), BOTH, Learning(1.0), Here())


class TestStages:
    def test_from_a_patch_to_what_comes_back(self, told, tmp_path):
        assert (told["success_nominal"], told["success_predicted"]) == (1.0, 0.6)
        assert (told["success_before"], told["success_after"], told["success_after_predicted"]) == (0.6, 0.9, 0.9)
        assert told["cause"] == "coulomb_friction at panda_joint4" and told["kept"] == "trained"
        assert told["learned"]["student"] == "old" and told["success"]["patched_new_student"]["value"] == 0.8
        costs = {name: cost["value"] for name, cost in told["costs"].items()}
        assert costs == pytest.approx({"coulomb_friction at panda_joint4": 0.25, "gripper_friction at contact": 0.15})
        assert json.loads((tmp_path / "finetune.json").read_text())["cause"] == told["cause"]

    def test_what_training_waits_for_is_nothing_where_it_goes_on_beside(self, tmp_path, monkeypatch):
        begun = threading.Event()

        def play(cell, numbers):
            assert begun.wait(10)
            return [True for _ in numbers]

        monkeypatch.setattr(playing, "run_rollouts", play)
        monkeypatch.setattr(stages, "train_and_distill", lambda *given: begun.set() or {**WEIGHTS, "device": "cuda 0"})
        told = run_finetune(
            FinetuneSettings(RolloutCell("wall"), tmp_path, None, 4, 4, beside=True), BOTH, Learning(1.0, 0), Here()
        )
        assert told["learned"]["device"] == "cuda 0"

    def test_policies_that_are_no_better_are_not_taken(self, tmp_path, monkeypatch):
        monkeypatch.setattr(playing, "run_rollouts", losing({"gripper_friction": (5, 6)}))
        monkeypatch.setattr(
            stages, "train_and_distill", lambda *given: {**WEIGHTS, "device": "cpu", "train": {"wall_s": 1.0}}
        )
        reality = RolloutCell("wall", "physx", text_of(BOTH))
        told = run_finetune(
            FinetuneSettings(RolloutCell("wall"), tmp_path, reality, 10, 10), BOTH, Learning(1.0), Here()
        )
        assert told["cause"] == "gripper_friction at contact"  # the other one costs nothing
        assert told["kept"] == "before" and told["success_after"] == told["success_before"] == 0.8
        assert "keep the old ones" in sentence(told)

    def test_without_a_gap_nothing_is_trained(self, tmp_path, monkeypatch):
        monkeypatch.setattr(playing, "run_rollouts", losing({}))
        told = run_finetune(
            FinetuneSettings(RolloutCell("wall"), tmp_path, None, 10, 10), Patch(), Learning(1.0), Here()
        )
        assert told["weights"] is None and told["cause"] is None and told["success_before"] is None
        assert sentence(told) == "The diagnosis found no gap: there is nothing to train for."

    def test_what_training_does_not_have_is_left_out_of_it_in_words(self):
        patch, left = split_trainable(Patch((CAMERA, TABLE)))
        assert patch == Patch((CAMERA,)) and left == ["table_height at environment"]

    def test_the_page_says_it_in_words(self, told, tmp_path):
        text = render(told, BOTH, tmp_path)
        assert "joint 4 has 2.00 Nm more dry friction" in text and text.count("<svg") == 3
        assert (
            sentence(told) in text and "Most of it goes to coulomb friction at panda joint4: 25 of 40 points." in text
        )

    def test_last_words_of_libraries_cost_no_training(self, tmp_path):
        from np_evaluation.finetune.learning import _last_json

        assert _last_json(['{"steps": 3}', "{0} devices left", "leaked semaphores"], tmp_path) == {"steps": 3}
        with pytest.raises(OSError, match="expected a line of JSON"):
            _last_json(["Killed"], tmp_path)

    def test_training_leaves_the_diagnosis_as_it_is(self, tmp_path, monkeypatch):
        from np_evaluation.finetune import learning

        def run(arguments, log, *rest):
            if arguments[0] == "np_training.distill":
                (tmp_path / "weights").mkdir()
                (tmp_path / "weights" / "post_contact_wall.safetensors").write_bytes(b"new")
            return {"effects": arguments[arguments.index("--effects") + 1]}

        monkeypatch.setattr(learning, "_run", run)
        (tmp_path / "patch.yaml").write_text(text_of(BOTH))
        told = learning.train_and_distill("wall", Patch((GRIP,)), tmp_path, Learning(1.0))
        assert load_patch(tmp_path / "patch.yaml") == BOTH
        assert load_patch(told["train"]["effects"]) == load_patch(told["distil"]["effects"]) == Patch((GRIP,))
        assert (tmp_path / "weights_old_student" / "post_contact_wall.safetensors").read_bytes() == b"new"

    @pytest.mark.parametrize(("seen", "wanted"), [(None, "1"), ("2,3", "3")])
    def test_a_training_has_the_gpu_of_those_that_are_seen(self, tmp_path, monkeypatch, seen, wanted):
        from np_evaluation.finetune import learning

        code = "import json, os; print(json.dumps({'gpu': os.environ['CUDA_VISIBLE_DEVICES']}))"
        (tmp_path / "tells_its_gpu.py").write_text(code)
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
        if seen:
            monkeypatch.setenv("CUDA_VISIBLE_DEVICES", seen)
        assert learning._run(["tells_its_gpu"], tmp_path / "log", 1.0, "gpu", 1) == {"gpu": wanted}

    def test_recordings_or_a_patch_but_not_both(self, capsys):
        for given in ([], ["bag", "--patch", "patch.yaml"], ["bag", "--minutes", "6"]):
            with pytest.raises(SystemExit):
                parse(given)
        assert "expected recordings, or --patch" in capsys.readouterr().err

    def test_a_diagnosis_is_of_its_own_recordings(self, tmp_path, monkeypatch):
        asked = []

        def ask(module, bags, out, options=()):
            asked.append(bags)
            if "bag_0" in bags[0]:
                raise OSError("diagnose refuses")
            return BOTH.effects

        monkeypatch.setattr(stages, "_diagnose", ask)
        monkeypatch.setattr(stages, "_has_keypoints", lambda bag: False)
        bags, out = [tmp_path / f"bag_{number}" for number in range(3)], tmp_path / "out"
        with pytest.raises(OSError, match="refuses"):
            stages.diagnose_bags(bags[:1], out)
        for _ in range(2):
            assert stages.diagnose_bags(bags[1:2], out) == BOTH
        with pytest.raises(ValueError, match="expected the recordings that it is of, .*bag_1, got others: .*--out"):
            stages.diagnose_bags(bags[2:], out)
        assert len(asked) == 2

    @pytest.mark.parametrize(
        ("said", "domain", "error"),
        [
            ({"domain": "card"}, "wall", "expected a recording of `excite`, or episodes of wall, got episodes of card"),
            ({"domain": "card"}, "card", "asked"),
            ({"domain": "bump", "suite": "task", "experiments": ["touch"]}, "wall", "asked"),
            ({"experiments": ["sweep_2"]}, "wall", "asked"),
        ],
    )
    def test_episodes_are_of_the_domain_and_what_excite_recorded_of_any(
        self, tmp_path, monkeypatch, capsys, said, domain, error
    ):
        def diagnosed(bags, out):
            raise OSError("asked")

        monkeypatch.setattr(command, "diagnose_bags", diagnosed)
        bag = record_episode(tmp_path / "bag", 50, information=said)
        assert command.main([str(bag), "--domain", domain, "--out", str(tmp_path / "out")]) == 1
        assert error in json.loads(capsys.readouterr().out.splitlines()[-1])["error"]
