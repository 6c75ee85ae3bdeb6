"""What commands show of their progress: a bar on a terminal, lines elsewhere."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from np_common.cli import Progress
from np_description.domains import DOMAINS
from np_diagnosis.commands import excite
from np_evaluation.commands import demo, evaluate

ROOT = Path(__file__).resolve().parents[2]
SHOWN = "from np_common.cli import Progress; p = Progress(4, 'part'); [p.show(n, f'at {n}') for n in range(5)]"


ALONE = {name: value for name, value in os.environ.items() if not name.startswith("M")}
"""An environment whose make is none of another make's."""


def made(*arguments):
    """What `make` would run, of an environment that is there."""
    command = ["make", "-n", "-o", "setup", "-o", "physx", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, env=ALONE).stdout


def test_the_demo_takes_every_domain():
    assert "demo --domain wall" in made("demo", "DOMAIN=wall")
    assert "demo --domain card --seed 3 --keypoints truth" in made("demo", "SEED=3", "KEYPOINTS=truth")
    assert "--episodes" not in made("demo") and "--episodes 1" in made("demo", "EPISODES=1")
    assert [demo.parse(["--domain", name]).domain for name in DOMAINS] == list(DOMAINS)


@pytest.mark.parametrize(
    "asked, said",
    [
        ("demo EPISODS=1", "EPISODS: expected options among DOMAIN EPISODES "),
        ("table3 SEED=1 DOMAIN=wall", "DOMAIN: `make table3` has no use for it"),
        ("test ARGS=-x", "ARGS: `make test` has no use for it"),  # of PYTEST_ARGS
    ],
)
def test_an_option_that_would_be_passed_over_is_refused_by_name(asked, said):
    with pytest.raises(subprocess.CalledProcessError) as refused:
        made(*asked.split())
    assert said in refused.value.stderr


def test_every_command_has_the_options_with_which_it_is_written_down():
    pages = [ROOT / "Makefile", ROOT / "README.md", ROOT / "benchmark/README.md"]
    pages += [page for folder in ("guide", "reference") for page in (ROOT / "docs" / folder).glob("*.md")]
    told = "".join(page.read_text() for page in pages)
    commands: dict[str, set[str]] = {}
    for name, given in re.findall(r"make ([a-z0-9-]+)((?: [A-Z_]+=(?:\"[^\"]*\"|\S+))+)", told):
        commands.setdefault(name, set()).update(re.findall(r"([A-Z_]+)=", given))
    assert len(commands) > 5 and "TORCH_INDEX" in commands["setup"]
    for name, given in commands.items():
        made(name, *(f"{option}=1" for option in given))


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not there")
def test_set_up_refuses_a_path_with_a_space_before_it_installs_anything(tmp_path):
    clone = tmp_path / "my clones" / "here"
    clone.mkdir(parents=True)
    for name in ("Makefile", "requirements.lock", "env.sh"):
        shutil.copy(ROOT / name, clone / name)
    shutil.copytree(ROOT / "tools", clone / "tools")
    done = subprocess.run(["make", "setup"], cwd=clone, capture_output=True, text=True, env=ALONE)
    said = [line for line in done.stderr.splitlines() if not line.startswith("make: ")]
    assert done.returncode and len(said) == 1 and not (clone / ".venv").exists()
    assert "expected a path without spaces" in said[0] and "move the clone" in said[0]


def test_set_up_asks_colcon_for_no_setup_of_a_virtual_environment_which_has_none(tmp_path):
    for name in ("Makefile", "env.sh"):
        shutil.copy(ROOT / name, tmp_path)
    shutil.copytree(ROOT / "tools", tmp_path / "tools")
    for folder in (".venv/bin", "ros2_ws/install"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / ".venv/bin/activate").write_text(f"VIRTUAL_ENV={tmp_path}/.venv\n")
    (tmp_path / ".venv/.ros2").touch()
    told = {"AMENT_PREFIX_PATH": "/opt/ros/jazzy", "BASH_FUNC_colcon%%": '() { echo "$1 $AMENT_PREFIX_PATH"; }'}
    command = ["make", "-o", ".venv/.ros2", "ros2_ws/install/.built"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True, env={**ALONE, **told})
    assert done.stdout.replace(":", "") == "build /opt/ros/jazzy\n"


def test_set_up_refuses_a_checkout_that_cannot_be_written(tmp_path):
    check = ROOT / "tools/check.sh"
    done = subprocess.run([check, "/proc"], capture_output=True, text=True)  # where not even root makes a file
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert "expected a checkout that can be written, cannot make a file in /proc" in done.stderr
    assert subprocess.run([check, tmp_path], capture_output=True).returncode == 0 and not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [".venv", ".venv-franka-sim"])
def test_set_up_refuses_an_environment_that_is_a_link_for_it_would_empty_another_one(tmp_path, name):
    shared, clone = tmp_path / "shared", tmp_path / "clone"
    (shared / "bin").mkdir(parents=True)
    clone.mkdir()
    check = [ROOT / "tools/check.sh", clone]
    assert subprocess.run(check, capture_output=True).returncode == 0
    (clone / name).symlink_to(shared)
    done = subprocess.run(check, capture_output=True, text=True)
    assert done.returncode == 1 and done.stderr.count("\n") == 1 and (shared / "bin").is_dir()
    assert f"expected {name} to be a folder of this checkout" in done.stderr
    assert f"it is a link to {shared}," in done.stderr and done.stderr.endswith("remove the link\n")


@pytest.mark.parametrize("name, source", [(".venv", "tools/install.sh"), (".venv-franka-sim", "tools/python.sh")])
def test_an_environment_is_emptied_only_after_the_check(name, source):
    assert made("-W", source, f"{name}/.installed").startswith("tools/check.sh && ")


def test_the_environment_before_set_up_says_what_to_do(tmp_path):
    shutil.copy(ROOT / "env.sh", tmp_path)
    done = subprocess.run(["bash", "-c", ". ./env.sh; echo $?"], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout == "1\n" and done.stderr.count("\n") == 1 and "run `make setup` there first" in done.stderr


@pytest.mark.parametrize("asked, kept", [("1", "byte_code"), ("", "")])
def test_byte_code_that_shall_not_lie_beside_the_sources_lies_in_the_environment(tmp_path, asked, kept):
    shutil.copy(ROOT / "env.sh", tmp_path)
    (tmp_path / ".venv/bin").mkdir(parents=True)
    (tmp_path / ".venv/bin/activate").write_text(f"VIRTUAL_ENV={tmp_path}/.venv\n")
    (tmp_path / "imported.py").write_text("")
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPYCACHEPREFIX"}
    command = f". ./env.sh; {sys.executable} -c 'import imported'"
    subprocess.run(["bash", "-c", command], cwd=tmp_path, check=True, env={**alone, "PYTHONDONTWRITEBYTECODE": asked})
    (written,) = tmp_path.rglob("imported.*.pyc")
    assert written.is_relative_to(tmp_path / ".venv" / kept if kept else tmp_path / "__pycache__")


def test_a_folder_that_cannot_be_made_is_named(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    out = tmp_path / "file" / "demo"
    assert demo.main(["--out", str(out)]) == 1
    assert f"demo: {out}_000: expected a folder that can be made, got: Not a directory" in capsys.readouterr().err
    assert evaluate.main(["--keypoints", "truth", "--out", str(out)]) == 1
    assert f"evaluate: {out}: expected a folder that can be written" in capsys.readouterr().err
    assert excite.main(["--out", str(tmp_path / "bag"), "--logs", str(out)]) == 1
    assert f"excite: {out}_000: expected a folder that can be made" in capsys.readouterr().err


SLOW = ("rclpy", "rosbags", "matplotlib", "mujoco", "onnxruntime", "torch", "cv2")


QUICK = (
    "np_blind.arm.set",
    "np_blind.task.set",
    "np_evaluation.commands.bench",
    "np_evaluation.commands.calibration_trial",
    "np_evaluation.commands.check_backend",
    "np_evaluation.commands.demo",
    "np_evaluation.commands.evaluate",
    "np_blind.baselines.compare",
    "sim2real.cli.diagnose_task",
    "sim2real.cli.diagnose",
    "np_bringup.commands.status",
    "np_diagnosis.commands.excite",
    "np_perception.commands.calibrate",
    "np_perception.commands.calibration_board",
    "np_perception.commands.object_sheet",
    "np_record.commands.export_lerobot",
    "np_record.commands.replay",
    "np_record.commands.report",
)


def test_help_of_a_command_imports_nothing_that_is_slow():
    """All in one process: the first command that does is named."""
    code = (
        f"import sys; from importlib import import_module\nfor name in {QUICK}:\n"
        "    try:\n        import_module(name).main(['--help'])\n"
        "    except SystemExit as ended:\n        assert not ended.code\n"
        f"    assert not set({SLOW}) & set(sys.modules), name"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.count("usage: ") == len(QUICK) and done.stderr == ""


ALL = """
import importlib, io, sys
from contextlib import redirect_stderr, redirect_stdout

for name in {names}:
    sys.argv, said = [name, "--help"], io.StringIO()
    try:
        with redirect_stdout(said):
            importlib.import_module(name).main()
    except SystemExit as ended:
        assert not ended.code, name
    assert said.getvalue().startswith("usage: "), (name, said.getvalue())
    assert not {{"torch", "warp", "onnx"}} & sys.modules.keys(), name
    if ".nodes." in name:  # by rclpy
        continue
    sys.argv, said = [name, "--no-such-option"], io.StringIO()
    try:
        with redirect_stderr(said):
            importlib.import_module(name).main()
    except SystemExit as ended:
        assert ended.code == 2, name
    (reason,) = said.getvalue().splitlines()
    assert (": unrecognized" in reason or " required" in reason) and reason.endswith("; see --help"), (name, reason)
"""


def commands() -> list[str]:
    """The module of every command and node: entry points of the workspace, what of training and benchmark runs by itself."""
    told = "".join(path.read_text() for path in sorted((ROOT / "ros2_ws/src").glob("*/setup.py")))
    alone = [
        ".".join(path.relative_to(folder).with_suffix("").parts)
        for folder in (ROOT / "training", ROOT / "benchmark")
        for path in sorted(folder.glob("np_*/**/*.py"))
        if "__main__" in path.read_text() and "tests" not in path.relative_to(folder).parts
    ]
    return [*re.findall(r"= ((?:np_|sim2real)[\w.]+):main", told), *alone]


def test_no_help_imports_torch_and_what_is_wrong_with_options_is_said_alone():
    """The first takes seconds. All in one process: the first that does is named."""

    names = commands()
    assert {"np_training.train", "np_training.detector.release", "np_blind.task.set"} < set(names) and len(names) > 40
    done = subprocess.run([sys.executable, "-c", ALL.format(names=names)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_elsewhere_than_on_a_terminal_there_are_few_lines(capsys):
    progress = Progress(1000, "episodes")
    for number in range(1000):
        progress.show(number + 0.5, f"{number} good")
    progress.show(1000, "done")
    lines = capsys.readouterr().err.splitlines()
    assert 10 < len(lines) <= 22 and not any("\r" in line for line in lines)
    assert "episodes" in lines[0] and " 0/1000 " in lines[0] and "0 good" in lines[0]
    assert " 1000/1000 " in lines[-1] and lines[-1].endswith("done")
    assert re.search(r"\d\d:\d\d<\d\d:\d\d", lines[len(lines) // 2])  # time so far and left


def test_what_was_done_before_says_nothing_of_the_time_left(capsys):
    progress = Progress(10, "resumed")
    progress.show(9)
    assert "<?" in capsys.readouterr().err
    progress.show(10)
    assert " 10/10 " in capsys.readouterr().err


def test_on_a_terminal_one_line_is_drawn_over():
    terminal, side = os.openpty()
    try:
        subprocess.run([sys.executable, "-c", SHOWN], stderr=side, check=True, env={**os.environ, "COLUMNS": "100"})
    finally:
        os.close(side)
    seen = b""
    while True:
        try:
            part = os.read(terminal, 4096)
        except OSError:  # the other side is closed
            break
        if not part:
            break
        seen += part
    os.close(terminal)
    text = seen.decode()
    assert text.count("\n") == 1 and text.endswith("\r\n")
    assert text.startswith("\rpart") and "at 4" in text.split("\r")[-2]
