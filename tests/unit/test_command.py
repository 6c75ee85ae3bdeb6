"""What commands show of their progress: a bar on a terminal, lines elsewhere."""

import os
import re
import subprocess
import sys
from pathlib import Path

from np_bringup.commands import demo
from np_description.domains import DOMAINS
from np_record.command import Progress

ROOT = Path(__file__).resolve().parents[2]
SHOWN = "from np_record.command import Progress; p = Progress(4, 'part'); [p.show(n, f'at {n}') for n in range(5)]"


def made(*arguments):
    """What `make` would run, of an environment that is there."""
    command = ["make", "-n", "-o", "setup", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


def test_the_demo_takes_every_domain():
    assert "demo --domain wall" in made("demo", "DOMAIN=wall")
    assert "demo --domain card --seed 3 --keypoints truth" in made("demo", "SEED=3", "KEYPOINTS=truth")
    assert "--episodes" not in made("demo") and "--episodes 1" in made("demo", "EPISODES=1")
    assert [demo.parse(["--domain", name]).domain for name in DOMAINS] == list(DOMAINS)


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
