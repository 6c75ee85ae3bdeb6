"""`make mutants`: a mutant that a test notices is killed, one that none notices survives and is named."""

import json
import subprocess
import sys

import pytest
from mutant_operators import mutants, mutated

CODE = '''"""A bound."""

MOST = 10


def bounded(x, least=-3):
    if x < least and x is not None:
        return least
    return min(x, MOST)


def halvings(x):
    n = 0
    while x > 1:
        x //= 2
        n += 1
    return n
'''
EXACT = """
from toy.bound import bounded, halvings

def test_bounds():
    assert [bounded(x) for x in (-4, -3, 3, 11)] == [-3, -3, 3, 10]

def test_halvings():
    assert halvings(8) == 3
"""
WEAK = """
from toy.bound import bounded

def test_a_bound_stays():
    assert bounded(10) == 10
"""
RUN = """
import json, sys
from dataclasses import asdict
from pathlib import Path
import mutants

root, wanted, patience = Path(sys.argv[1]), sys.argv[2], float(sys.argv[3])
project = mutants.Project(root, (root / "toy/bound.py",), (root / "test_toy.py",))
drawn = [m for m in mutants.draw(project, 0, 0) if wanted in m.mutant]
results, baseline = mutants.run(project, drawn, root / "runs/results.jsonl", patience=patience)
print(json.dumps(mutants.summary(results, {("toy/bound.py", "MOST = 10", "10", "20"): "a reason"})))
"""


@pytest.fixture
def play(tmp_path):
    """Runs the toy's mutants whose new text holds `wanted`; figures, and how many were run."""
    (tmp_path / "toy").mkdir()
    (tmp_path / "toy/__init__.py").touch()
    (tmp_path / "toy/bound.py").write_text(CODE)
    (tmp_path / "pytest.ini").write_text("[pytest]\naddopts = --import-mode=importlib\n")

    def run(tests, wanted="", patience=60.0):
        (tmp_path / "test_toy.py").write_text(tests)
        paths = [path for path in sys.path if path.endswith("tools")]
        ended = subprocess.run(
            [sys.executable, "-c", RUN, str(tmp_path), wanted, str(patience)],
            env={"PYTHONPATH": ":".join([str(tmp_path), *paths]), "PATH": ""},
            capture_output=True,
            text=True,
            cwd=tmp_path,
        )
        assert ended.returncode == 0, ended.stderr
        assert (tmp_path / "toy/bound.py").read_text() == CODE
        return json.loads(ended.stdout.splitlines()[-1]), sum("->" in line for line in ended.stderr.splitlines())

    return run


def test_what_a_test_notices_is_killed_and_what_none_notices_survives_with_its_reason(play):
    exact, run = play(EXACT, "20")
    assert (exact["mutants"], exact["killed"], exact["score"], exact["survivors"], run) == (1, 1, 1.0, [], 1)
    assert play(EXACT, "20") == (exact, 0)  # kept, and not run again
    weak, run = play(WEAK, "20")
    assert (weak["killed"], weak["modules"], run) == (0, {"toy/bound.py": {"mutants": 1, "killed": 0}}, 1)
    survivor = {"module": "toy/bound.py", "line": 3, "text": "MOST = 10", "original": "10", "mutant": "20"}
    assert weak["survivors"] == [survivor | {"reason": "a reason"}]


def test_code_that_no_test_reaches_survives(play):
    figures, _ = play(WEAK, "x >= 1")
    assert [(row["original"], row["reason"]) for row in figures["survivors"]] == [("x > 1", "")]


def test_a_mutant_that_hangs_is_killed(play):
    code = "pass"  # without its division the loop has no end
    figures, _ = play(EXACT, code, patience=2.0)
    assert figures["mutants"] == figures["killed"] == 2 and figures["timeouts"] >= 1


@pytest.mark.parametrize(
    "code, changes",
    [
        ("x = a < b", {"a <= b", "a > b"}),
        ("x = a + b", {"a - b"}),
        ("x = 0", {"1", "-1"}),
        ("x = -3", {"3", "6"}),
        ("x = True", {"False"}),
        ("x = a and not b", {"a or not b", "b"}),
        ("x = max(a, b)", {"min"}),
        ("x = xp.clip(a, b, c)", {"a"}),
        ("x = a[0]", {"a[1]"}),
        ("a.x = b", {"pass"}),
        ("raise E", {"pass"}),
        ("def f(x: 3 = b) -> 4:\n    '''5'''\n    return x", {"return None"}),
        ("if a:\n    x = b", {"not a"}),
        ("def f():\n    if a:\n        return None", {"not a"}),
    ],
)
def test_each_operator_changes_what_it_says_and_nothing_else(code, changes):
    found = mutants("module.py", code)
    assert {mutant.mutant for mutant in found} == changes
    sources = {mutated(code, mutant.number) for mutant in found}
    assert len(sources) == len(found) and code not in sources
