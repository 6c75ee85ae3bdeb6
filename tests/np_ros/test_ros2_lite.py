"""tools/ros2_lite: the parts of the `ros2` command that need no graph."""

import os
import re
import subprocess
import sys
from collections import deque
from pathlib import Path

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PoseStamped
from hypothesis import given
from hypothesis import strategies as st
from rcl_interfaces.srv import SetParameters
from std_srvs.srv import SetBool

from np_description.panda import JOINT_NAMES
from np_ros import messages as ours

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools" / "ros2_lite"))
from ros2_lite import completion, launch, main, messages, packages, topic  # noqa: E402


def executable(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("#!/bin/sh\n")
    path.chmod(0o755)
    return path


@pytest.fixture
def prefix(tmp_path, monkeypatch):
    """An install prefix with the package `pushers`: two executables and a data file."""
    marker = tmp_path / "share/ament_index/resource_index/packages/pushers"
    marker.parent.mkdir(parents=True)
    marker.touch()
    executable(tmp_path / "lib/pushers/pull")
    executable(tmp_path / "lib/pushers/push")
    (tmp_path / "lib/pushers/notes.txt").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    return tmp_path


def test_steps_aside_for_a_real_ros2(tmp_path):
    ours = executable(tmp_path / "venv" / "ros2").parent
    assert main.real_ros2(f"{ours}:{tmp_path}/empty", ours) is None
    real = executable(tmp_path / "opt" / "ros2")
    assert main.real_ros2(f"{ours}:{real.parent}", ours) == str(real)
    assert main.real_ros2(f"{real.parent}:{ours}", ours) == str(real)
    other = executable(
        tmp_path / "other" / "ros2"
    )  # of another checkout: the two would hand over to each other for ever
    other.write_text("#!/usr/bin/python\nfrom ros2_lite.main import main\n")
    assert main.real_ros2(f"{other.parent}:{ours}", ours) is None
    assert main.real_ros2(f"{other.parent}:{real.parent}:{ours}", ours) == str(real)


def test_hands_its_arguments_over_to_the_real_ros2(tmp_path):
    executable(tmp_path / "ros2").write_text('#!/bin/sh\necho real "$@"\n')
    code = "import sys; from ros2_lite.main import main; sys.exit(main())"
    environment = {
        **os.environ,
        "PATH": f"{tmp_path}:{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join([str(Path(main.__file__).parents[1]), *sys.path]),
    }
    done = subprocess.run(
        [sys.executable, "-c", code, "bag", "play", "-s", "mcap", "x"],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "real bag play -s mcap x\n"


def test_executables_are_those_of_the_ament_index(prefix, capsys):
    assert [p.name for p in packages.executables("pushers")] == ["pull", "push"]
    assert packages.list_executables(None) == 0
    assert capsys.readouterr().out == "pushers pull\npushers push\n"


def test_what_is_not_there_is_named(prefix):
    with pytest.raises(LookupError, match="'shovers' not found; 1 folders of AMENT_PREFIX_PATH searched"):
        packages.run("shovers", "push", [])
    with pytest.raises(LookupError, match="No executable 'lift' in package 'pushers'; it has: pull, push"):
        packages.run("pushers", "lift", [])
    with pytest.raises(LookupError, match="No launch file 'a.launch.py' in package 'pushers'; it has: none"):
        launch.load("pushers", "a.launch.py")


def test_launch_arguments():
    assert launch.parse(["domain:=card", "goal:=a:=b", "empty:="]) == {"domain": "card", "goal": "a:=b", "empty": ""}
    with pytest.raises(ValueError, match="expected name:=value, got 'domain=card'"):
        launch.parse(["domain=card"])


def test_ros_arguments_are_passed_on_untouched():
    line = ["run", "np_policy", "episode", "--ros-args", "-p", "rate:=10.0", "--once"]
    arguments = main.parser().parse_args(line)
    assert arguments.arguments == line[3:]


@pytest.mark.parametrize(
    "line, said",
    [
        ("run", "ros2 run: the following arguments are required: package, executable; see --help"),
        ("bag play x", "ros2: .*'bag' .*launch.*; a whole ROS 2 has more; see --help"),
        ("topic bw /x", "ros2 topic: .*'bw' .*hz.*; a whole ROS 2 has more; see --help"),
    ],
)
def test_what_cannot_be_is_said_in_a_line_and_what_is_not_here_to_be_elsewhere(line, said, capsys):
    with pytest.raises(SystemExit, match="2"):
        main.parser().parse_args(line.split())
    assert re.fullmatch(said + "\n", capsys.readouterr().err)


def test_messages_print_as_yaml_that_reads_back():
    message = ours.joint_state_message(1_500_000_000, JOINT_NAMES, *np.arange(21.0).reshape(3, 7))
    got = yaml.safe_load(yaml.safe_dump(messages.plain(message, None)))
    assert got["header"]["stamp"] == {"sec": 1, "nanosec": 500_000_000}
    assert got["name"] == list(JOINT_NAMES)
    assert got["effort"] == [14.0, 15.0, 16.0, 17.0, 18.0, 19.0, 20.0]


def test_long_arrays_are_cut_unless_asked_for():
    message = ours.image_message(0, "camera_optical", np.full((20, 20, 3), 7, np.uint8))
    assert messages.plain(message, 5)["data"] == [7] * 5 + ["..."]
    assert messages.plain(message, None)["data"] == [7] * 1200


@given(st.floats(1e-3, 10.0), st.integers(2, 50))
def test_rate_of_an_even_stream(gap, count):
    line = topic.rate_line(deque(gap * i for i in range(count)))
    rate = float(line.split("average rate: ")[1].split()[0])
    assert rate == pytest.approx(1 / gap, rel=1e-3, abs=1e-3)
    assert line.endswith(f"window: {count}")


def test_a_request_is_filled_from_yaml():
    request = SetBool.Request()
    messages.fill(request, {"data": True})
    assert request.data
    pose = PoseStamped()
    messages.fill(pose, {"header": {"frame_id": "panda_link0"}, "pose": {"position": {"x": 0.5}}})
    assert pose.header.frame_id == "panda_link0" and pose.pose.position.x == 0.5
    asked = SetParameters.Request()
    messages.fill(asked, {"parameters": [{"name": "a", "value": {"type": 3, "double_value": 0.5}}, {"name": "b"}]})
    assert [(p.name, p.value.double_value) for p in asked.parameters] == [("a", 0.5), ("b", 0.0)]


@pytest.mark.parametrize("values", [{"date": True}, {"data": 3}, [True], {"data": {"a": 1}}])
def test_what_no_field_takes_is_refused(values):
    with pytest.raises(ValueError, match="values: .*expected"):
        messages.fill(SetBool.Request(), values)


@pytest.mark.parametrize("name", ["std_srvs/Trigger", "std_srvs/srv/Push", "shovers/srv/Push", "", "/srv/"])
def test_an_unknown_service_type_is_refused(name):
    with pytest.raises(ValueError, match="expected one as std_srvs/srv/Trigger"):
        messages.interface("srv", name)


@pytest.mark.parametrize(
    "line, expected",
    [
        ("ros2 ", ["launch", "node", "param", "pkg", "run", "service", "topic"]),
        ("ros2 to", ["topic"]),
        ("ros2 topic e", ["echo"]),
        ("ros2 topic echo --f", ["--full-length"]),
        ("ros2 run pus", ["pushers"]),
        ("ros2 run pushers pu", ["pull", "push"]),
        ("ros2 pkg executables p", ["pushers"]),
        ("ros2 launch pushers ", ["push.launch.py"]),
        ("ros2 launch pushers push.launch.py o", ["opening:="]),
        ("ros2 run nobody ", []),
        ("ros2 dance ", []),
    ],
)
def test_tab_offers_what_may_come_next(prefix, line, expected):
    file = executable(prefix / "share/pushers/launch/push.launch.py")
    file.write_text(
        "from np_ros.processes.graph import LaunchArgument\n"
        "ARGUMENTS = [LaunchArgument('opening', '0.03', 'm'), LaunchArgument('mode', 'lockstep', '')]\n"
    )
    before, typed = completion.words({"COMP_LINE": line + "rest", "COMP_POINT": str(len(line))})
    assert completion.candidates(main.parser(), before, typed) == expected


def test_a_shell_that_somebody_types_in_asks_for_candidates(prefix):
    """As bash does at Tab, with our `ros2` on the path."""
    ours = executable(prefix / "bin/ros2")
    code = (
        f"import sys; sys.path[:0] = {[p for p in sys.path if p]!r}; from ros2_lite.main import main; sys.exit(main())"
    )
    ours.write_text(f"#!{sys.executable}\n{code}\n")
    tab = "COMP_LINE='ros2 run pushers pul'; COMP_POINT=20; _np_complete_ros2; printf '%s\\n' \"${COMPREPLY[@]}\""
    wanted = (ROOT / "env.sh").read_text()
    function = wanted[wanted.index("_np_complete_ros2() {") : wanted.index("\n}\n") + 3]
    said = subprocess.run(
        ["bash", "-c", function + tab],
        env={**os.environ, "PATH": f"{ours.parent}:/usr/bin:/bin"},
        capture_output=True,
        text=True,
    )
    assert said.stdout.split() == ["pull"], said.stderr
