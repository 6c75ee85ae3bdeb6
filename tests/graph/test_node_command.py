"""The command of a node: help, parameters, arguments, the domain id and interrupts, each error in one line."""

import importlib
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import rclpy
from pages.parameters import executables, node_classes
from rclpy.node import Node

from np_bringup.backends import REAL, SIMULATED
from np_bringup.task_graph import task_graph
from np_diagnosis.commands import excite
from np_record.replay import ReplayScript
from np_ros.node import run
from np_ros.parameters import list_parameters
from np_ros.processes.domain import ros_domain_id

TIMEOUT = 60.0  # s; only how long a broken spinner takes to fail
ROOT = Path(__file__).resolve().parents[2]
EXECUTABLES = [(name, module) for _, name, module in executables(ROOT / "ros2_ws/src") if ".nodes." in module]


@pytest.mark.parametrize("name, module", EXECUTABLES, ids=[name for name, _ in EXECUTABLES])
def test_help_of_a_node_tells_every_parameter_and_starts_nothing(name, module, capsys):
    loaded = importlib.import_module(module)
    assert loaded.main(["--help"]) == 0 and not rclpy.ok()
    said = " ".join(capsys.readouterr().out.split())
    for p in list_parameters(node_classes(loaded)[-1]):
        assert f"{p.name}: {type(p.default).__name__}, default " in said and " ".join(p.meaning.split()) in said
        assert p.allowed in said


@pytest.mark.parametrize("keypoints", ["camera", "truth"])
@pytest.mark.parametrize("backend", [SIMULATED, REAL])
def test_a_graph_gives_its_nodes_only_parameters_that_they_have(keypoints, backend):
    asked = {"keypoints": keypoints, "effects": "x", "bag": "x", "backend": backend}
    if backend == REAL:
        asked |= {"mode": "realtime", "hostname": "x", "calibration": "x", "keypoints": "camera"}
    modules = dict(EXECUTABLES)
    for spec in task_graph(asked):
        known = {p.name for p in list_parameters(node_classes(importlib.import_module(modules[spec.executable]))[-1])}
        assert set(spec.parameters) <= known, spec.name


@pytest.mark.parametrize("keypoints", ["camera", "truth"])
def test_a_replay_starts_the_nodes_that_were_recorded(keypoints):
    asked = {"keypoints": keypoints, "object": "sponge", "weights": "x", "seed": "3"}
    information = {**asked, "domain": "bump", "mode": "lockstep", "calibration": "y"}
    counts = {"camera/image_raw": 9} if keypoints == "camera" else {}
    replayed = ReplayScript(SimpleNamespace(path="bag", information=information, counts=counts)).specs
    answering = ("joint_impedance", "keypoint_detector", "pre_contact", "approach", "post_contact")
    recorded = [spec for spec in task_graph(information) if spec.name in answering]
    assert replayed == recorded and len(recorded) == (5 if keypoints == "camera" else 4)


GIVEN = """
import sys
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from np_ros.node import parameter, run

class Asks(Node):
    def __init__(self):
        super().__init__("asks")
        parameter(self, "mode", "lockstep", "Who waits.")
        self.create_timer(0.001, self.context.shutdown, clock=Clock(clock_type=ClockType.STEADY_TIME))

sys.exit(run(Asks, sys.argv[1:]))
"""


@pytest.mark.parametrize(
    "given, refused",
    [
        (["mode:=realtime", "use_sim_time:=true", "qos_overrides./x.publisher.depth:=3"], ""),
        (["start_type_description_service:=false"], ""),
        (["modus:=realtime"], "cannot start: parameter modus: not one of this node's, which are mode\n"),
    ],
)
def test_a_parameter_that_a_node_does_not_have_is_refused_in_one_line(graph, given, refused):
    arguments = ["--ros-args", *(part for each in given for part in ("-p", each))]
    environment = {**os.environ, **graph.environment, "ROS_DOMAIN_ID": str(graph.domain_id)}
    command = [sys.executable, "-c", GIVEN, *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=TIMEOUT)
    said = done.stdout + done.stderr
    assert done.returncode == bool(refused), said
    assert said.endswith(refused) and said.count("\n") == bool(refused)


@pytest.mark.parametrize(
    "given, got",
    [
        (["mode:=realtime"], "mode:=realtime\n"),
        (["--mode", "realtime", "--ros-args", "-p", "mode:=lockstep"], "--mode realtime\n"),
        (["--ros-args", "-p", "mode=realtime"], "Couldn't parse parameter override rule: '-p mode=realtime'"),
        (["--ros-args", "--once"], "['--once']\n"),
    ],
)
def test_an_argument_that_nobody_reads_is_refused(graph, given, got):
    environment = {**os.environ, **graph.environment, "ROS_DOMAIN_ID": str(graph.domain_id)}
    command = [sys.executable, "-c", GIVEN, *given]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=TIMEOUT)
    said = done.stdout + done.stderr
    assert done.returncode == 1, said
    assert "cannot start: expected --ros-args -p NAME:=VALUE ..., got " in said and got in said


def test_a_node_that_cannot_start_says_so_under_its_own_name(capfd):
    class KeypointNode(Node):
        def __init__(self):
            raise ValueError("no reason")

    for given, name in ((["--ros-args", "-r", "__node:=left"], "left"), ([], "keypoint")):
        assert run(KeypointNode, given) == 1
        assert f"[{name}]: cannot start: no reason" in capfd.readouterr().err


def test_a_domain_id_that_is_none_is_refused_in_one_line(capsys, monkeypatch, tmp_path):
    told = "ROS_DOMAIN_ID: expected a whole number from 0 to 232, got 'abc'"
    environment = {**os.environ, "ROS_DOMAIN_ID": "abc"}
    done = subprocess.run(
        [sys.executable, "-c", GIVEN], env=environment, capture_output=True, text=True, timeout=TIMEOUT
    )
    assert done.returncode == 1 and (done.stdout + done.stderr).endswith(f"cannot start: {told}\n")
    monkeypatch.setenv("ROS_DOMAIN_ID", "abc")
    assert excite.main(["--backend", "running", "--out", str(tmp_path / "x"), "--logs", str(tmp_path / "log")]) == 1
    assert capsys.readouterr().err == f"excite: {told}\n"
    for said, number in (("", 0), ("7", 7), ("232", 232)):
        monkeypatch.setenv("ROS_DOMAIN_ID", said)
        assert ros_domain_id() == number


INTERRUPTED = """
import os, signal, sys
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.utilities import get_default_context
from np_ros.node import Diagnostics, run

class Opens(Node):
    def __init__(self):
        if "soon" in sys.argv:
            os.kill(os.getpid(), signal.SIGINT)
            while get_default_context().ok():
                pass
        super().__init__("opens")
        self.diagnostics = Diagnostics(self)
        os.kill(os.getpid(), signal.SIGINT)
        self.diagnostics.report(DiagnosticStatus.OK, "open")
        print("made")

    def destroy_node(self):
        print("closed")
        super().destroy_node()

sys.exit(run(Opens, []))
"""


@pytest.mark.parametrize("when, said", [("late", "made\nclosed\n"), ("soon", "")])
def test_an_interrupt_while_a_node_is_made_waits_until_it_can_close_what_it_opened(graph, when, said):
    environment = {**os.environ, **graph.environment, "ROS_DOMAIN_ID": str(graph.domain_id)}
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, when], env=environment, capture_output=True, text=True, timeout=TIMEOUT
    )
    assert (done.stdout, done.returncode) == (said, 0), done.stderr
    assert "Traceback" not in done.stderr
