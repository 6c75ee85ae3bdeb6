"""The task suite over real topics: the table is touched where the simulator has it, and `diagnose_task` says so of the recording."""

import json

import pytest
from graph_tools import Graph
from sim2real.cli import diagnose_task
from sim2real.effects.patch import Patch, PatchEffect, dump_patch, load_patch

from np_description.domains import BUMP
from np_diagnosis.commands.excite import make_graph
from np_diagnosis.nodes.excite_node import Exciter

HIGHER = Patch((PatchEffect("table_height", "environment", {"height": 0.006}),))
SCENE = {"domain": "bump", "object": "default", "seed": 1, "calibration": ""}
SHORT = ["view", "touch_table"]
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A bag in lockstep, over a table that is 6 mm higher, and the segments that were sent."""
    folder = tmp_path_factory.mktemp("task")
    effects = folder / "higher.yaml"
    effects.write_text(dump_patch(HIGHER))
    with Graph(folder / "log") as graph:
        nodes = make_graph(folder / "bag", "lockstep", effects=str(effects), information=SCENE, scene=SCENE)
        graph.start(nodes)
        with Exciter(graph, lockstep=True) as exciter:
            exciter.wait_until_ready({node.name for node in nodes})
            segments = exciter.run_task(BUMP, SHORT)
            return exciter.stop_recording()["bag"], segments


def test_experiments_are_planned_and_sent(recorded):
    _, segments = recorded
    assert segments[0] == "view"
    assert [name for name in segments if name.startswith("touch")] == [f"touch_table_{n}" for n in (1, 2, 3, 4)]


def test_the_report_has_a_row_for_what_was_touched_and_says_what_was_not(recorded, tmp_path, capsys):
    bag, _ = recorded
    assert diagnose_task.main([str(bag), "--out", str(tmp_path)]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    rows = {row["module"]: row for row in told["rows"]}
    assert rows["table"]["verdict"] == "identified" and rows["table"]["share"] == pytest.approx(1.0)
    assert rows["contact"]["verdict"] == rows["timing"]["verdict"] == "not seen in this recording"
    assert told["motion"] is None  # nothing was pushed
    assert told == json.loads((tmp_path / "task.json").read_text())
    assert "at the table: the table is 6.0 mm" in (tmp_path / "task.html").read_text()
    assert [e.effect for e in load_patch(tmp_path / "patch.yaml").effects] == ["table_height"]
