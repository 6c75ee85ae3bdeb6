"""Files of results and their summary."""

import json
import math
import sys
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from packages import packages_of, sources

from np_bringup.task_graph import task_graph
from np_common.intervals import wilson_interval
from np_description.objects.choice import domain_with, embed_object_text, read_domain
from np_evaluation import run_episodes as playing
from np_evaluation.commands import demo
from np_evaluation.commands import evaluate as command
from np_evaluation.results import PartialResults, Results, split_runs
from np_evaluation.scoring import CODE, breakdown, code_sha256, result_of, summary
from np_record.outcome import Outcome

SETTINGS = {
    "domain": "card",
    "seed": 0,
    "keypoints": "truth",
    "weights_sha256": {"a": "1"},
}


def good(number):
    return result_of(number, Outcome("succeeded", "", 0.004, 0.02, True, 6.0), 3.0)


def test_what_the_first_contact_was_worth_is_said_where_there_were_more():
    again = result_of(1, Outcome("succeeded", "", 0.004, 0.02, True, 40.0, contacts=2), 9.0)
    figures = summary([good(0), again])
    assert figures["success"] == 1.0 and figures["first_contact"]["success"] == 0.5
    assert "first_contact" not in summary([good(0)])


def test_results_survive_and_continue(tmp_path):
    results = Results(tmp_path, SETTINGS)
    results.add(good(0))
    results.add(breakdown(1, "node approach ended with signal SIGKILL", 2.0))
    again = Results(tmp_path, SETTINGS)
    assert again.results == results.results and again.path == results.path
    again.add(good(2))
    assert [r.episode for r in Results(tmp_path, SETTINGS).results] == [0, 1, 2]


@pytest.mark.parametrize("cut", [1, 20, 100])
def test_a_line_cut_off_is_run_again(tmp_path, cut):
    results = Results(tmp_path, SETTINGS)
    for number in range(3):
        results.add(good(number))
    text = results.path.read_text()
    results.path.write_text(text[:-cut])
    again = Results(tmp_path, SETTINGS)
    assert [r.episode for r in again.results] == [0, 1]
    again.add(good(2))
    assert results.path.read_text() == text


def test_parts_of_other_processes_are_collected_and_what_a_killed_run_left_of_them_counts(tmp_path):
    results = Results(tmp_path, SETTINGS)
    results.add(good(1))
    assert results.missing(5) == [range(0, 1), range(2, 5)] and results.missing(2) == [range(0, 1)]
    for numbers in (range(0, 1), range(2, 5)):
        part = PartialResults(results.part(numbers))
        for number in numbers:
            part.add(good(number))
    assert results.finished() == 5 and [r.episode for r in results.results] == [1]
    cut = results.part(range(2, 5))
    cut.write_text(cut.read_text()[:-30])
    again = Results(tmp_path, SETTINGS)
    assert [r.episode for r in again.results] == [0, 1, 2, 3] and again.kept == again.finished() == 4
    assert again.missing(5) == [range(4, 5)]
    assert [path.suffix for path in tmp_path.iterdir()] == [".jsonl"]
    assert Results(tmp_path, SETTINGS, fresh=True).finished() == 0


def test_the_part_of_a_lost_process_is_gone_on_with(tmp_path, monkeypatch):
    part = Results(tmp_path, SETTINGS).part(range(2, 7))
    lost = PartialResults(part)
    lost.add(good(2))
    lost.add(good(3))
    part.write_text(part.read_text()[:-30])
    played = []
    monkeypatch.setattr(playing, "play", lambda request, numbers, results: played.extend(numbers))
    playing.play_part(None, range(2, 7), part)
    assert played == [3, 4, 5, 6] and [json.loads(line)["episode"] for line in part.read_text().splitlines()] == [2]


@given(st.sets(st.integers(0, 40)), st.integers(1, 7))
def test_every_missing_episode_is_given_to_one_process(there, jobs):
    results = Results.__new__(Results)
    results._by_number = dict.fromkeys(there)
    runs = results.missing(40)
    parts = split_runs(runs, jobs)
    assert sorted(n for part in parts for n in part) == sorted(set(range(40)) - there)
    assert len({n for part in parts for n in part}) == sum(map(len, parts))
    assert all(len(part) <= -(-sum(map(len, runs)) // jobs) for part in parts)


def test_other_settings_have_another_file(tmp_path):
    paths = {
        Results(tmp_path, {**SETTINGS, **change}).path
        for change in ({}, {"seed": 1}, {"keypoints": "camera"}, {"weights_sha256": {"a": "2"}})
    }
    assert len(paths) == 4


def test_the_revision_is_told_and_does_not_part_results(tmp_path):
    first = Results(tmp_path, {**SETTINGS, "revision": "1a2b"})
    first.add(good(0))
    again = Results(tmp_path, {**SETTINGS, "revision": "1a2b-dirty"})
    assert (again.path, again.kept) == (first.path, 1) and again.kept_from.startswith("20")
    assert json.loads(again.path.read_text().splitlines()[0])["settings"]["revision"] == "1a2b"


def test_fresh_results_begin_anew(tmp_path):
    Results(tmp_path, SETTINGS).add(good(0))
    fresh = Results(tmp_path, SETTINGS, fresh=True)
    assert (fresh.results, fresh.kept, fresh.kept_from) == ([], 0, "")
    assert Results(tmp_path, SETTINGS).results == []


def test_edited_code_is_other_code(tmp_path, monkeypatch):
    package = tmp_path / "np_edited"
    package.mkdir()
    (package / "__init__.py").write_text("")
    source = package / "policy.py"
    source.write_text("GAIN = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr("np_evaluation.scoring.CODE", ("np_edited",))
    before = code_sha256()
    assert code_sha256() == before
    (package / "__pycache__").mkdir()
    (package / "__pycache__/policy.pyc").write_bytes(b"1")
    assert code_sha256() == before
    source.write_text("GAIN = 2\n")
    assert code_sha256() != before


def test_the_code_of_an_evaluation_is_all_that_its_nodes_import():
    """Else an edit could be overlooked, and results be kept that it would change."""
    wanted = {"np_evaluation"} | {node.package for node in task_graph({"bag": "x"})}
    while further := {name for p in wanted for path in sources(p) for name in packages_of(path)} - wanted:
        wanted |= further
    assert wanted == set(CODE)


def test_foreign_results_are_named(tmp_path):
    path = Results(tmp_path, SETTINGS).path
    header = path.read_text()
    path.write_text(header + json.dumps({"hello": 1}) + "\n")
    with pytest.raises(ValueError, match="line 2: expected one result, found"):
        Results(tmp_path, SETTINGS)
    path.write_text("something else\n")
    with pytest.raises(ValueError, match="expected results for"):
        Results(tmp_path, SETTINGS)


def test_the_summary_counts_by_the_truth():
    results = [
        good(0),
        good(1),
        result_of(2, Outcome("succeeded", "", 0.02, 0.02, False, 6.0), 3.0),
        result_of(3, Outcome("failed", "post: timeout", 0.004, 0.02, True, 15.0), 3.0),
        result_of(4, Outcome("failed", "post: timeout", 0.1, 0.02, False, 15.0), 3.0),
        result_of(5, Outcome("failed", "approach: no path", 0.1, 0.02, False, 0.1), 3.0),
        result_of(6, Outcome("fault", "hold", 0.1, 0.02, False, 0.1), 3.0),
        breakdown(7, "node died", 3.0),
    ]
    figures = summary(results)
    assert figures["success"] == 3 / 8 and figures["episodes"] == 8
    assert figures["failures"] == {"approach": 1, "fault": 1, "graph": 1, "post": 2}
    assert (figures["declared_wrongly"], figures["missed"]) == (1, 1)
    assert figures["ci95"] == pytest.approx(wilson_interval(3, 8), abs=1e-4)
    assert figures["wall_s"] == 24.0


def test_the_summary_tells_how_sure_the_graph_was():
    bounds = [(0.001, math.radians(1.0)), (0.003, math.radians(2.0)), (0.002, math.radians(3.0))]
    sure = [Outcome("succeeded", "", 0.004, 0.02, True, 6.0, 1, *bound) for bound in bounds]
    figures = summary(
        [result_of(0, Outcome("fault", "hold", 0.1, 0.02, False, 0.1), 3.0), *(result_of(1, s, 3.0) for s in sure)]
    )
    assert figures["uncertainty"] == {"mm_median": 2.0, "deg_median": 2.0, "mm_max": 3.0, "deg_max": 3.0}
    assert "uncertainty" not in summary([good(0)])


def test_no_episode_has_no_rate():
    figures = summary([])
    assert figures["success"] is None and figures["ci95"] == [0.0, 1.0]


def test_the_patch_of_an_evaluation_goes_to_the_simulated_arm_and_its_view_and_nowhere_else(tmp_path):
    patch = tmp_path / "patch.yaml"
    patch.write_text("effects: [{effect: command_delay, component: arm, parameters: {delay: 0.004}}]")
    options = command.parse(["--effects", str(patch)])
    assert options.effects == str(patch.resolve())
    carrying = {
        node.name: dict(node.parameters).get("effects")
        for node in task_graph({"keypoints": "truth", "effects": options.effects})
    }
    simulated = [carrying.pop(name) for name in ("sim_bridge", "keypoint_oracle")]
    assert simulated == [options.effects] * 2 and not any(carrying.values())
    nominal = task_graph({"keypoints": "truth", "effects": ""})
    assert "effects" not in next(node.parameters for node in nominal if node.name == "sim_bridge")


def test_an_engine_that_is_not_installed_is_named_with_what_installs_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "sapien", None)  # as if it were not there
    with pytest.raises(SystemExit) as ended:
        command.parse(["--engine", "physx"])
    assert ended.value.code == 2 and "--engine physx: PhysX needs" in (said := capsys.readouterr().err)
    assert "`make physx` installs" in said
    assert command.parse([]).engine == "mujoco"


def test_results_say_in_which_engine(tmp_path):
    results = Results(tmp_path, {**SETTINGS, "engine": "physx"})
    results.add(replace(good(0), engine="physx"))
    assert json.loads(results.path.read_text().splitlines()[1])["engine"] == "physx"
    assert Results(tmp_path, {**SETTINGS, "engine": "mujoco"}).results == []


@pytest.mark.parametrize(
    "content, text",
    [
        ("effects: [{effect: telepathy, component: arm, parameters: {}}]", "expected an effect of the arm"),
        ("effects: none", "expected a mapping with the list"),
        (None, "expected a patch.yaml"),
    ],
)
def test_an_evaluation_refuses_a_patch_that_is_none(tmp_path, capsys, content, text):
    patch = tmp_path / "patch.yaml"
    if content is not None:
        patch.write_text(content)
    with pytest.raises(SystemExit) as ended:
        command.parse(["--effects", str(patch)])
    assert ended.value.code == 2 and text in capsys.readouterr().err


def test_results_under_another_patch_are_results_of_their_own(tmp_path):
    nominal = Results(tmp_path, {**SETTINGS, "effects": "none"})
    nominal.add(good(0))
    assert Results(tmp_path, {**SETTINGS, "effects": "effects: []"}).results == []


def test_a_file_of_an_object_is_read_once_and_goes_to_every_node_that_knows_sizes_and_into_the_bag(tmp_path):
    path = tmp_path / "tea.yaml"
    path.write_text("{name: tea, domain: card, size: [0.06, 0.07, 0.006], mass: 0.012, surface: paper}")
    options = command.parse(["--object", str(path)])
    assert options.object == demo.parse(["--object", str(path)]).object == embed_object_text("card", str(path))
    path.unlink()
    graph = {node.name: node.parameters for node in task_graph({"object": options.object, "bag": "b", "scenario": "2"})}
    told = {name for name, parameters in graph.items() if parameters.get("object") == options.object}
    assert told == {"sim_bridge", "pre_contact", "approach", "post_contact", "episode"}
    assert graph["sim_bridge"]["scenario"] == 2
    kept = json.loads(graph["recorder"]["run_info"])
    assert read_domain(kept).half_size == (0.03, 0.035, 0.003)


@pytest.mark.parametrize("tool", (command, demo), ids=("evaluate", "demo"))
def test_an_object_that_is_none_ends_the_command_with_one_line(tool, capsys):
    with pytest.raises(SystemExit) as ended:
        tool.parse(["--domain", "wall", "--object", "tissue"])
    assert ended.value.code == 2
    assert "object: expected one of default, wrapped, dense, wood" in capsys.readouterr().err.splitlines()[-1]


def test_an_object_of_another_size_than_the_policy_knows_is_warned_of(tmp_path):
    own = tmp_path / "box.yaml"
    own.write_text("name: box\ndomain: card\nsize: [0.06, 0.07, 0.006]\nmass: 0.05\nsurface: paper\n")
    (line,) = command.size_warnings(domain_with("card", str(own)), "")
    assert line.startswith(
        "object: 60 x 70 x 6 mm, the policy was trained with 50 x 70 x 5 mm (factors 1.20, 1.00, 1.20)"
    )
    assert command.size_warnings(domain_with("card", "wood"), "") == []


def test_a_patch_that_asks_for_less_than_no_friction_is_warned_of(tmp_path):
    patch = tmp_path / "patch.yaml"
    patch.write_text("effects:\n- {effect: coulomb_friction, component: panda_joint4, parameters: {level: -5}}\n")
    before = command.warnings_of(command.parse([]))
    told = command.warnings_of(command.parse(["--effects", str(patch)]))
    (line,) = (line for line in told if line not in before)
    assert line.startswith("coulomb_friction at panda_joint4: asks for a frictionloss of -") and line.endswith("is 0")
