"""The chain's blind set on many processes: what is there is kept, a case that loses its worker costs nobody else's, results do not depend on it."""

import json
import os
import re
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from np_blind.task import set as task_set
from np_blind.task.cases import draw
from np_blind.task.jobs import evaluate_cases
from np_common.parallel import LOCAL, workers
from np_common.parallel import missing as missing_cluster
from np_description.domains import BUMP
from np_physx_bridge.library import missing

ROOT = Path(__file__).resolve().parents[2]
CASES = draw(4, 1)
needs_dask = pytest.mark.skipif(bool(missing_cluster(LOCAL)), reason="Dask is an extra: make cluster")


def named(case, seed):
    if case.number == 3:
        raise ValueError("nothing was seen")
    return {"case": case.number, "seed": seed}


def lost_always(case, seed):
    if case.number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return named(case, seed)


def never(case, seed):
    raise AssertionError("it has been answered")


def test_what_goes_wrong_is_an_answer_and_what_is_answered_is_not_asked_again(tmp_path):
    with ThreadPoolExecutor(2) as pool:
        rows = evaluate_cases(CASES, 7, tmp_path, pool, named)
        assert rows[:3] == [{"case": number, "seed": 7} for number in range(3)]
        assert rows[3]["case"] == 3 and "ValueError: nothing was seen" in rows[3]["error"]
        assert 'File "benchmark/tests/test_task_set.py"' in rows[3]["error"] and str(ROOT) not in rows[3]["error"]
        assert evaluate_cases(CASES, 7, tmp_path, pool, never) == rows


@pytest.mark.parametrize("cluster", ["", pytest.param(LOCAL, marks=needs_dask)])
def test_a_case_that_loses_its_workers_is_an_error_until_the_next_call(cluster, tmp_path):
    with workers(2, cluster) as pool:
        rows = evaluate_cases(CASES, 7, tmp_path, pool, lost_always)
        assert re.search("BrokenProcessPool|KilledWorker", rows[1]["error"]) and rows[1]["kind"] == CASES[1].kind
        assert [rows[n] for n in (0, 2)] == [{"case": n, "seed": 7} for n in (0, 2)] and not list(tmp_path.glob("*1/*"))
        again = evaluate_cases(CASES, 7, tmp_path, pool, named)
    assert again == [rows[0], {"case": 1, "seed": 7}, *rows[2:]]


def test_the_command_is_made_with_what_make_was_told():
    def made(*arguments):
        command = ["make", "-n", "-o", "physx", "blind-task", *arguments]
        own = {
            name: value for name, value in os.environ.items() if not name.startswith("MAKE")
        }  # not those of `make test`
        done = subprocess.run(command, cwd=ROOT, env=own, capture_output=True, text=True, check=True)
        return done.stdout.split("-m ")[-1]

    assert re.fullmatch(r"np_blind\.task\.set[\\\s]+--jobs \d+\s*", made())
    said = made("CASES=3", "SEED=5", "JOBS=2", "CLUSTER=local").split()
    assert " ".join(said).replace("\\ ", "") == "np_blind.task.set --cases 3 --seed 5 --jobs 2 --cluster local"


def test_a_sealed_set_is_not_spent_where_physx_is_missing_nor_begun_without_its_seal(tmp_path, monkeypatch, capsys):
    out = tmp_path / "run"
    monkeypatch.setattr(task_set, "missing", lambda: "PhysX is not here")
    assert task_set.main(["--seed", "900", "--out", str(out)]) == 1 and "PhysX is not here" in capsys.readouterr().err
    monkeypatch.setattr(task_set, "missing", str)
    assert task_set.main(["--seed", "987", "--out", str(out)]) == 2
    assert "put down (--seal) and committed before" in capsys.readouterr().err and not out.exists()


@pytest.mark.slow
@pytest.mark.skipif(bool(missing()), reason="SAPIEN is an extra: make physx")
@pytest.mark.timeout(1200)
def test_a_case_is_made_and_answered_in_a_process_of_its_own(tmp_path):
    command = [sys.executable, "-m", "np_blind.task.set", "--cases", "1", "--jobs", "1", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["cases"] == 1 and found["errors"]["value"] == 0 and found["95 % intervals that hold"]["of"] >= 3
    assert (tmp_path / "case_000/answer.json").exists()


def test_a_case_has_what_intervals_are_made_for_and_weighs_what_it_weighs():
    case = CASES[0]
    usual = {effect for effect, _, _ in case.usual}
    assert {"encoder_bias", "coulomb_friction", "camera_extrinsics", "table_height"} <= usual
    assert case.domain.mass == pytest.approx(BUMP.mass) and case.domain.half_size != BUMP.half_size
    assert all(abs(edge) < 0.002 for edge in case.longer)
