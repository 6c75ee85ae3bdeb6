"""The `ros2` command on a live graph: run, topic, service, node, param and launch, on nodes in processes of their own."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from types import MappingProxyType

import pytest
import yaml
from graph_tools import TIMEOUT
from std_msgs.msg import Float64

ROOT = Path(__file__).resolve().parents[2]
CODE = "import sys; from ros2_lite.main import main; sys.exit(main())"

TALKER = f"""#!{sys.executable}
import os, sys
from np_ros.node import parameter, run
from np_ros.qos import LATCHED, LOCKSTEP
from rclpy.node import Node
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool

class Talker(Node):
    def __init__(self):
        super().__init__("talker")
        self.opening = parameter(self, "opening", 0.02, "Opening of one finger, m.", 0.0, 0.04)
        self.command = self.create_publisher(Float64, "gripper_command", LOCKSTEP)
        self.phase = self.create_publisher(String, "phase", LATCHED)
        self.phase.publish(String(data="idle"))
        self.create_service(SetBool, "~/open", self.open)
        self.create_timer(0.02, self.say)
    def open(self, request, response):
        response.success, response.message = True, "opened" if request.data else "closed"
        return response
    def say(self):
        self.command.publish(Float64(data=self.opening))
        print("pid", os.getpid(), flush=True)
    def destroy_node(self):
        print("at rest", flush=True)
        super().destroy_node()

sys.exit(run(Talker))
"""

LAUNCH_FILE = """
from np_ros.processes.graph import LaunchArgument, NodeSpec
ARGUMENTS = [LaunchArgument("opening", "0.03", "Opening of one finger, m.")]
def graph(arguments):
    return [NodeSpec("pushers", "talker", "left", {"opening": float(arguments["opening"])},
                     [("gripper_command", "left/gripper_command")])]
"""

NEEDED_LAUNCH_FILE = """
from np_ros.processes.graph import NodeSpec
ARGUMENTS = []
def graph(arguments):
    return [NodeSpec("pushers", "talker", "left"), NodeSpec("pushers", "talker", "right", {"nothing": 1}, is_required=True)]
"""


class Ros2:
    """Starts `ros2 ...` in the domain of a graph, with the package `pushers` installed, and ends what it started."""

    def __init__(self, graph, prefix: Path):
        marker = prefix / "share/ament_index/resource_index/packages/pushers"
        marker.parent.mkdir(parents=True)
        marker.touch()
        talker = prefix / "lib/pushers/talker"
        talker.parent.mkdir(parents=True)
        talker.write_text(TALKER)
        talker.chmod(0o755)
        launch_file = prefix / "share/pushers/launch/talk.launch.py"
        launch_file.parent.mkdir(parents=True)
        launch_file.write_text(LAUNCH_FILE)
        launch_file.with_name("needed.launch.py").write_text(NEEDED_LAUNCH_FILE)
        real = shutil.which("ros2")
        self._command = [real] if real else [sys.executable, "-c", CODE]
        paths = [str(ROOT / "tools" / "ros2_lite"), *filter(None, sys.path)]
        ament = [str(prefix), *filter(None, [os.environ.get("AMENT_PREFIX_PATH")])]
        self._environment = {
            **os.environ,
            **graph.environment,
            "PYTHONPATH": os.pathsep.join(paths),
            "AMENT_PREFIX_PATH": os.pathsep.join(ament),
        }
        self._processes = []

    def start(self, *arguments: str, command=(), environment=MappingProxyType({})) -> subprocess.Popen:
        process = subprocess.Popen(
            [*(command or self._command), *arguments],
            env={**self._environment, **environment},
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self._processes.append(process)
        return process

    def close(self):
        for process in self._processes:
            if process.poll() is None:
                process.kill()
            process.communicate()


@pytest.fixture
def ros2(graph, tmp_path):
    command = Ros2(graph, tmp_path / "prefix")
    yield command
    command.close()


def line(process: subprocess.Popen, start: str) -> str:
    """The next line of output that starts so; fails with what the process said if it ends before."""
    for text in process.stdout:
        if text.startswith(start):
            return text
    raise AssertionError(f"no line '{start}...'; the process ended with {process.wait()}: {process.stderr.read()}")


def is_listed(ros2, kind: str, name: str) -> bool:
    """Whether `ros2 topic|service list -t` has the line; a busy machine may say nothing for the second that ends a list."""
    return any(name in ros2.start(kind, "list", "-t").stdout.read().splitlines() for _ in range(5))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_run_becomes_the_node_and_signals_reach_it(ros2, number):
    process = ros2.start("run", "pushers", "talker")
    assert line(process, "pid").split()[1] == str(process.pid)
    process.send_signal(number)
    assert process.wait() == 0
    assert line(process, "at rest")


def test_run_passes_parameters_and_refuses_those_out_of_range(ros2, probe):
    received = probe.collect("gripper_command", Float64)
    ros2.start("run", "pushers", "talker", "--ros-args", "-p", "opening:=0.01")
    probe.wait_until(lambda: received)
    assert received[0].data == 0.01
    refused = ros2.start("run", "pushers", "talker", "--ros-args", "-p", "opening:=0.5")
    assert refused.wait() == 1
    assert "cannot start" in refused.stderr.read()


@pytest.mark.slow
def test_topic_list_echo_and_hz(ros2):
    line(ros2.start("run", "pushers", "talker"), "pid")
    echo = ros2.start("topic", "echo", "--once", "/phase")
    assert yaml.safe_load(line(echo, "data:")) == {"data": "idle"}
    assert echo.wait() == 0
    assert is_listed(ros2, "topic", "/gripper_command [std_msgs/msg/Float64]")
    hz = ros2.start("topic", "hz", "/gripper_command")
    assert float(line(hz, "average rate").split()[-1]) > 0
    hz.send_signal(signal.SIGINT)
    assert hz.wait() in (0, -signal.SIGINT)


@pytest.mark.parametrize("moment", [" yaml\n", "waiting for a publisher of /nobody"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_command_quietly_also_while_it_imports(ros2, moment, number):
    """yaml is imported before rclpy."""
    environment = {"PYTHONPROFILEIMPORTTIME": "1"}  # a line on stderr for every import
    hz = ros2.start("topic", "hz", "/nobody", command=[sys.executable, "-c", CODE], environment=environment)
    assert any(moment in line for line in hz.stderr)
    hz.send_signal(number)
    assert "Traceback" not in hz.communicate()[1]
    assert hz.returncode == 0


def test_service_list_and_call(ros2):
    call = ros2.start("service", "call", "/talker/open", "std_srvs/srv/SetBool", "{data: true}")
    line(ros2.start("run", "pushers", "talker"), "pid")
    assert "success=True, message='opened'" in call.communicate()[0]
    assert call.returncode == 0
    assert is_listed(ros2, "service", "/talker/open [std_srvs/srv/SetBool]")


@pytest.mark.slow
def test_nodes_parameters_and_topics_are_looked_at_and_a_message_is_published(ros2, probe):
    received = probe.collect("chatter", Float64)
    line(ros2.start("run", "pushers", "talker"), "pid")
    told = ros2.start("param", "get", "/talker", "opening").communicate()
    assert told[0] == "0.02\n", told
    assert "/talker" in ros2.start("node", "list").stdout.read().splitlines()
    assert "opening" in ros2.start("param", "list", "/talker").stdout.read().splitlines()
    refused = ros2.start("param", "set", "/talker", "opening", "0.03")
    assert "read-only" in refused.communicate()[1] and refused.returncode == 1
    unknown = ros2.start("param", "get", "/nobody", "opening")
    assert "node /nobody: expected one of" in unknown.communicate()[1] and unknown.returncode == 1
    details = ros2.start("topic", "info", "-v", "/gripper_command").stdout.read()
    assert "Type: std_msgs/msg/Float64\nPublisher count: 1\n  /talker reliable volatile\n" in details
    assert ros2.start("topic", "pub", "--once", "/chatter", "std_msgs/msg/Float64", "{data: 0.5}").wait() == 0
    probe.wait_until(lambda: received)
    assert received[0].data == 0.5


def test_launch_runs_the_table_and_stops_it(ros2, probe):
    received = probe.collect("left/gripper_command", Float64)
    process = ros2.start("launch", "pushers", "talk.launch.py", "opening:=0.04")
    node = int(line(process, "[left] pid").split()[-1])
    probe.wait_until(lambda: received)
    assert received[0].data == 0.04
    process.send_signal(signal.SIGINT)
    assert process.wait() == 0
    with pytest.raises(ProcessLookupError):
        os.kill(node, 0)


def test_a_launch_ends_with_the_node_that_it_needs(ros2):
    """The rest of it would disturb the graph of which it is the second, or wait for ever."""
    process = ros2.start("launch", "pushers", "needed.launch.py")
    out, err = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 1 and "parameter nothing: not one of this node's" in out
    assert err.splitlines()[-1] == "nothing goes on without right: the launch ends"


def test_launch_names_an_unknown_argument(ros2):
    process = ros2.start("launch", "pushers", "talk.launch.py", "width:=1")
    assert process.wait() == 1
    assert "width: expected one of opening" in process.stderr.read()
