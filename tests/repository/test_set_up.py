"""Progress of the set-up, with a pip that is told what to do."""

import subprocess
import sys
from pathlib import Path

import pip_progress

SCRIPT = Path(pip_progress.__file__)


def test_found_packages_and_unpacked_ones_are_half_of_the_way_each():
    bar = pip_progress.Bar(8, True, 0.0)
    assert bar.text(0, "0 of 4 found", 1.0) == "    0 %  0 of 4 found"
    assert bar.text(2, "2 of 4 found", 10.0) == "   25 %  2 of 4 found, about 30 s left"
    assert bar.text(8, "4 of 4 installed", 40.0) == "  100 %  4 of 4 installed"


def test_elsewhere_than_on_a_terminal_a_line_comes_every_tenth():
    bar = pip_progress.Bar(100, False, 0.0)
    assert len([text for done in range(101) if (text := bar.text(done, "", 1.0))]) == 11


def test_lines_of_pip():
    assert pip_progress.find_name("Collecting numpy==2.3.5 (from -r requirements.lock (line 3))\n") == "numpy==2.3.5"
    assert pip_progress.find_name("  Downloading numpy.whl (1 kB)\n") == "" == pip_progress.find_name("Collecting\n")


def test_the_exit_status_and_the_errors_are_those_of_pip(tmp_path):
    for status in (0, 3):
        said = "import sys; print('Collecting a'); print('no such thing', file=sys.stderr); sys.exit(int(sys.argv[1]))"
        command = [sys.executable, str(SCRIPT), "1", sys.executable, "-c", said, str(status)]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == status and "no such thing" in done.stderr and not done.stdout


def test_pips_beside_one_another_both_run_and_one_that_fails_is_told(tmp_path):
    def pip(name, status):
        return [sys.executable, "-c", f"open({str(tmp_path / name)!r}, 'w'); import sys; sys.exit({status})"]

    for first, second in ((0, 3), (4, 0), (0, 0)):
        command = [sys.executable, str(SCRIPT), "1", *pip("a", first), "--and", *pip("b", second)]
        assert subprocess.run(command).returncode == first + second
        for name in "ab":
            (tmp_path / name).unlink()


def test_progress_is_told_while_pip_works(tmp_path):
    folder = tmp_path / "site-packages"
    folder.mkdir()
    slow = f"""
import pathlib, time
print("Collecting a", flush=True)
pathlib.Path({str(folder)!r}, "a-1.dist-info").mkdir()
while not pathlib.Path({str(tmp_path)!r}, "told").exists(): time.sleep(0.01)
"""
    code = f"""
import sys, pathlib; sys.path.insert(0, {str(SCRIPT.parent)!r})
import pip_progress
pip_progress.PERIOD = 0.01
write = pip_progress.Bar.text
def text(*args):
    line = write(*args)
    if "1 of 2 installed" in line: pathlib.Path({str(tmp_path)!r}, "told").touch()
    return line
pip_progress.Bar.text = text
sys.exit(pip_progress.run(2, [[sys.executable, "-c", {slow!r}]], pathlib.Path({str(folder)!r})))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and "50 %  1 of 2 installed" in done.stderr
