"""The table of objects: which cells it has, what they add up to, and what becomes of one that cannot be played."""

import json

import pytest

from np_bringup.commands import table3 as command
from np_bringup.paper_table import FIXED, OSC, OURS, Cell, Played, Setting, cells, papers, play, rows, totals
from np_bringup.paper_table_plot import table_plot
from np_description.domains import DOMAINS


def test_the_whole_table_has_21_objects_in_three_scenarios_and_baselines_have_the_default_one():
    asked = cells(DOMAINS, [], [OURS, OSC])
    assert len({(c.domain, c.object) for c in asked if c.method == OURS}) == 21
    assert len([c for c in asked if c.method == OURS]) == 63
    assert {(c.object, c.scenario) for c in asked if c.method == OSC} == {("default", n) for n in (1, 2, 3)}
    assert len({c.folder for c in asked}) == len(asked)


def test_an_object_that_no_row_has_is_refused():
    with pytest.raises(ValueError, match="expected rows of wall, got brick, tissue"):
        cells(["wall"], ["sponge", "tissue", "brick"], [OURS])


def test_the_papers_own_rate_is_what_it_prints():
    """.77 over its 315 tries (Table III, and the text)."""
    of_row = {(c.domain, c.object): papers(c.domain, c.object, c.method) for c in cells(DOMAINS, [], [OURS])}
    assert sum(of_row.values()) / (21 * 15) == pytest.approx(0.77, abs=0.01)
    assert papers("card", "default", FIXED) == 11 and papers("wall", "default", FIXED) is None


PLAYED = [
    Played(Cell("wall", "default", 1), 5, 5, {}),
    Played(Cell("wall", "default", 2), 3, 5, {"post": 2}),
    Played(Cell("wall", "default", 3), error="no weights"),
    Played(Cell("wall", "sponge", 1), 1, 5, {"post": 3, "approach": 1}),
]


def test_rows_and_totals_count_what_was_played():
    default, sponge = rows(PLAYED)
    assert (default["successes"], default["episodes"], default["success"]) == (8, 10, 0.8)
    assert default["scenarios"] == {"1": [5, 5], "2": [3, 5], "3": [0, 0]}
    assert default["errors"] == ["scenario 3: no weights"] and default["paper_successes"] == 13
    assert default["ci95"][0] < 0.8 < default["ci95"][1]
    total = totals(PLAYED)
    assert total["ours"] == total["ours wall"]
    assert (total["ours"]["successes"], total["ours"]["episodes"]) == (9, 15)
    assert total["ours"]["failures"] == {"approach": 1, "post": 5}
    assert sponge["failures"] == {"approach": 1, "post": 3}


def test_it_is_printed_and_drawn_row_by_row():
    table = {"rows": rows([*PLAYED, *(Played(Cell("wall", "sponge", n), 0, 5) for n in (2, 3))])}
    lines = command.printed(table).splitlines()
    assert lines[1].split() == "wall default 5/5 3/5 0/0 8/10 0.80 (0.49 to 0.94) 13/15".split()
    assert lines[2] == "  scenario 3: no weights"
    assert "wall: sponge" in table_plot(table["rows"])


def test_a_cell_that_cannot_be_played_says_why_and_the_command_fails(tmp_path, capsys):
    empty = tmp_path / "weights"
    empty.mkdir()
    setting = Setting("mujoco", "truth", 1, 0, tmp_path, {OURS: str(empty)})
    played = play(Cell("wall", "default", 1), setting)
    assert played.episodes == 0 and "weights" in played.error and played.error.startswith("evaluate: ")
    options = ["--domains", "wall", "--objects", "default", "--weights", str(empty), "--out", str(tmp_path / "table")]
    assert command.main([*options, "--jobs", "1", "--tries", "1"]) == 1
    said = capsys.readouterr().out.splitlines()
    assert json.loads(said[-1])["totals"]["ours"]["episodes"] == 0
    assert sum("scenario" in line and "weights" in line for line in said) == 3
