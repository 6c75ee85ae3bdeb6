"""The table of objects: which cells it has, what they add up to, and what becomes of one that cannot be played."""

import json
import subprocess
from dataclasses import replace

import pytest

from np_description.domains import DOMAINS
from np_description.objects.table import ROWS
from np_evaluation.commands import evaluate
from np_evaluation.commands import table3 as command
from np_evaluation.paper_table import (
    CellResult,
    TableCell,
    TableSettings,
    episodes,
    play_cell,
    table_cells,
    table_rows,
    table_totals,
)
from np_evaluation.results import Results
from np_evaluation.scoring import Result, breakdown, result_of
from np_record.outcome import Outcome


def test_the_whole_table_has_21_objects_in_three_scenarios():
    asked = table_cells(DOMAINS, [])
    assert len({(c.domain, c.object) for c in asked}) == 21 and len(asked) == 63
    assert len({c.folder for c in asked}) == len(asked)


def test_an_object_that_no_row_has_is_refused():
    with pytest.raises(ValueError, match="expected rows of wall, got brick, tissue"):
        table_cells(["wall"], ["sponge", "tissue", "brick"])


def test_the_papers_own_rate_is_what_it_prints():
    """.77 over its 315 tries (Table III, and the text)."""
    assert sum(row.successes for row in ROWS) / (21 * 15) == pytest.approx(0.77, abs=0.01)


def results(successes: int, *failures: Outcome) -> tuple[Result, ...]:
    """Some successes, and then episodes that ended like this."""
    ended = [*[Outcome("succeeded", "", 0.004, 0.02, True, 9.0)] * successes, *failures]
    return tuple(result_of(number, outcome, 9.0) for number, outcome in enumerate(ended))


LATE = Outcome("failed", "post: timeout", 0.1, 0.2, False, 25.0)
DEEP, DEEPER = (
    Outcome("failed", f"approach: unreachable: panda_finger1 is {depth} mm deep in object", 0.1, 0.2, False, 0.0)
    for depth in (17.5, 30)
)
PLAYED = [
    CellResult(TableCell("wall", "default", 1), results(5)),
    CellResult(TableCell("wall", "default", 2), results(3, LATE, LATE)),
    CellResult(TableCell("wall", "default", 3), error="no weights"),
    CellResult(TableCell("wall", "sponge", 1), results(1, LATE, DEEP, DEEPER, LATE)),
]


def test_rows_and_totals_count_what_was_played():
    default, sponge = table_rows(PLAYED)
    assert (default["successes"], default["episodes"], default["success"]) == (8, 10, 0.8)
    assert default["scenarios"] == {"1": [5, 5], "2": [3, 5], "3": [0, 0]}
    assert default["errors"] == ["scenario 3: no weights"] and default["paper_successes"] == 13
    assert default["ci95"][0] < 0.8 < default["ci95"][1]
    total = table_totals(PLAYED)
    assert total["ours"] == total["ours wall"]
    assert (total["ours"]["successes"], total["ours"]["episodes"]) == (9, 15)
    assert total["ours"]["failures"] == {"approach": 2, "post": 4}
    assert sponge["failures"] == {"approach": 2, "post": 2}


def test_what_the_graph_said_of_failures_is_counted_without_its_numbers():
    wrong = Outcome("succeeded", "", 0.03, 0.2, False, 9.0)
    played = CellResult(
        TableCell("wall", "sponge", 1), (*results(1, LATE, DEEP, DEEPER, wrong), breakdown(5, "node died", 2.0))
    )
    assert table_totals([played])["ours"]["reasons"] == {
        "approach: unreachable: panda_finger# is # mm deep in object": 2,
        "post: timeout": 1,
        "declared a success and was none": 1,
        "node died": 1,
    }


def test_every_episode_is_told_with_its_cell():
    told = episodes(PLAYED)
    assert len(told) == 15 and {"domain", "object", "scenario", "episode", "reason", "contacts"} <= told[0].keys()
    assert [one["success"] for one in told if one["object"] == "sponge"] == [True] + [False] * 4
    json.dumps(told)


def test_it_is_printed_and_drawn_row_by_row():
    table = {"rows": table_rows(PLAYED)}
    lines = command.format_table(table).splitlines()
    assert lines[0].split() == "scenario 1 scenario 2 scenario 3 all rate, 95 % paper".split()
    assert lines[1].split() == "wall default 5/5 3/5 0/0 8/10 0.80 (0.49 to 0.94) 13/15".split()
    assert lines[2] == "  scenario 3: no weights"
    assert lines[3].split()[2:6] == ["1/5", "0/0", "0/0", "1/5"]  # two scenarios were not asked for


def test_what_the_first_contact_was_worth_stands_beside_the_rate():
    again = replace(results(1)[0], episode=5, contacts=2)
    played = CellResult(TableCell("wall", "wood", 1), (*results(3, LATE), again))
    (row,) = table_rows([played])
    assert row["success"] == 0.8 and row["first_contact"]["success"] == 0.6
    (head, line) = command.format_table({"rows": [row]}).splitlines()
    assert (
        "first contact" in head and line.split()[2:] == "4/5 4/5 0.80 (0.38 to 0.96) 0.60 (0.23 to 0.88) 9/15".split()
    )
    assert "first contact" not in command.format_table({"rows": table_rows(PLAYED)})


def test_a_cell_is_an_evaluation_with_everything_that_was_asked_for(tmp_path, monkeypatch):
    setting = TableSettings("physx", "truth", 2, 7, tmp_path, "", contacts=3)
    asked = []

    def run(given, **streams):
        asked.append(evaluate.parse(given[3:]))
        file = Results(asked[0].out, {"domain": "bump"})
        for number in (1, 0, 2):  # one more than was asked for, of an earlier run
            file.add(replace(results(1)[0], episode=number))
        return subprocess.CompletedProcess(given, 0, json.dumps({"results": str(file.path)}))

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr("np_evaluation.commands.episode_options.missing", lambda: "")
    played = play_cell(TableCell("bump", "sponge", 2), setting)
    assert [result.episode for result in played.results] == [0, 1] and played.successes == 2
    (options,) = asked
    assert (options.engine, options.keypoints, options.contacts, options.episodes) == ("physx", "truth", 3, 2)
    assert (options.domain, options.object, options.scenario, options.seed) == ("bump", "sponge", 2, 7)


@pytest.mark.parametrize("main", [command.main, evaluate.main], ids=["table3", "evaluate"])
@pytest.mark.parametrize("option", ["contacts", "jobs"])
def test_what_no_run_can_have_is_refused(main, option, capsys):
    with pytest.raises(SystemExit) as ended:
        main([f"--{option}", "0"])
    assert ended.value.code == 2 and f"--{option}: expected at least 1, got 0" in capsys.readouterr().err


def test_scenarios_that_were_not_asked_for_are_not_played():
    assert [cell.scenario for cell in table_cells(["wall"], ["sponge"], [3, 1, 3])] == [1, 3]


def test_a_cell_that_cannot_be_played_says_why_and_the_command_fails(tmp_path, capsys):
    empty = tmp_path / "weights"
    empty.mkdir()
    setting = TableSettings("mujoco", "truth", 1, 0, tmp_path, str(empty))
    played = play_cell(TableCell("wall", "default", 1), setting)
    assert not played.results and "weights" in played.error and played.error.startswith("evaluate: ")
    options = ["--domains", "wall", "--objects", "default", "--weights", str(empty), "--out", str(tmp_path / "table")]
    assert command.main([*options, "--jobs", "1", "--tries", "1", "--scenarios", "1"]) == 1
    said = capsys.readouterr().out.splitlines()
    assert json.loads(said[-1])["totals"]["ours"]["episodes"] == 0
    assert sum("scenario" in line and "weights" in line for line in said) == 1
