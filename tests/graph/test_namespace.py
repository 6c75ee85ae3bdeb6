"""A graph under a namespace: an episode to its end, and the table of all nodes' states."""

import json

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from graph_tools import card_specs
from rcl_interfaces.srv import GetParameters

from np_bringup.commands import status
from np_description.phases import SUCCEEDED, first_end
from np_ros import qos
from np_ros.goals import episode_goal
from np_ros.phases import phase_state


@pytest.mark.slow
def test_an_episode_under_a_namespace_with_the_users_parameters(graph, probe, tmp_path, capsys):
    own = tmp_path / "own.yaml"
    own.write_text(yaml.safe_dump({"/lab/episode": {"ros__parameters": {"post_timeout": 31.0}}}))
    specs = card_specs(keypoints="truth", namespace="/lab", params_file=str(own))
    names, heard, phases = {spec.name for spec in specs}, {}, []
    probe.collect("lab/episode/phase", DiagnosticArray, qos.RECORDER_LATCHED, lambda m: phases.append(phase_state(m)))
    probe.collect(
        "lab/diagnostics", DiagnosticArray, qos.RECORDER, lambda m: heard.update({s.name: m for s in m.status})
    )
    graph.start(specs)
    probe.wait_until(lambda: {f"/lab/{name}" for name in names} <= set(heard), what=f"diagnostics of {names}")
    probe.be_found(*(f"lab/{name}" for name in names))
    probe.wait_until(lambda: episode_goal(heard["/lab/episode"]), what="a goal in force")
    assert probe.call("lab/episode/start").success
    probe.wait_until(lambda: first_end(phases) is not None, what="the end of the episode")
    assert phases[-1].phase == SUCCEEDED, phases
    request = GetParameters.Request(names=["post_timeout"])
    answer = probe._services.call(GetParameters, "lab/episode/get_parameters", request, 60.0)
    assert answer.values[0].double_value == 31.0

    def tabled():
        assert status.main(["--namespace", "/lab", "--seconds", "3", "--json"]) == 0
        return {f"/lab/{name}" for name in names} <= set(json.loads(capsys.readouterr().out))

    probe.wait_until(tabled, what=f"a table of {names}")


def test_a_table_of_states_has_errors_first_and_counts_that_are_not_0():
    found = {
        "/approach": {"level": 0, "message": "running", "values": {"refused_late": "0", "plans": "3"}},
        "/sim_bridge": {
            "level": 2,
            "message": "stopped: silence",
            "values": {"refused_state": "7", "refused_late": "0"},
        },
    }
    head, first, second = status.format_status(found).splitlines()
    assert head.split() == ["node", "level", "message;", "counts"]
    assert first == "/sim_bridge  ERROR  stopped: silence; refused_state 7" and second == "/approach    OK     running"


def test_where_nobody_reports_a_line_says_so(graph, probe, capsys):
    assert status.main(["--seconds", "0.1"]) == 1
    assert f"no diagnostics in ROS_DOMAIN_ID {graph.domain_id} within 0.1 s" in capsys.readouterr().err
