"""Processes of this machine or of a Dask cluster: what a lost one costs."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from np_common.parallel import LOCAL, missing, workers

needs_dask = pytest.mark.skipif(bool(missing(LOCAL)), reason="Dask is an extra: make cluster")


def square(number):
    return number * number


def killed_once(number, folder):
    """The process that does the second case dies the first time it is tried."""
    mark = folder / f"tried_{number}"
    if number == 1 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    with (folder / "done").open("a") as file:
        file.write(f"{number}\n")
    return number


def killed_always(number):
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


everywhere = pytest.mark.parametrize("cluster", ["", pytest.param(LOCAL, marks=needs_dask)])


@everywhere
def test_every_case_is_done_by_another_process(cluster):
    with workers(2, cluster) as pool:
        assert [f.result() for f in [pool.submit(square, n) for n in range(5)]] == [0, 1, 4, 9, 16]
        assert pool.submit(os.getpid).result() != os.getpid()


def lasting(folder, number):
    try:
        (folder / f"begun_{number}").touch()
        time.sleep(100)
    except KeyboardInterrupt:
        (folder / f"ended_{number}").touch()
        raise


def test_an_interruption_ends_what_is_under_way_and_begins_nothing_more(tmp_path):
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt), workers(1) as pool:
        for number in range(5):
            pool.submit(lasting, tmp_path, number)
        while not (tmp_path / "begun_0").exists():
            assert time.monotonic() < began + 60
        raise KeyboardInterrupt
    assert sorted(path.name for path in tmp_path.iterdir()) == ["begun_0", "ended_0"]


KILLED = """
import os, signal, sys, time
from pathlib import Path
from test_workers import lasting
from np_common.parallel import workers

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    with workers(2) as pool:
        for number in range(3):
            pool.submit(lasting, folder, number)
        while len(list(folder.glob("begun_*"))) < 2:
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGKILL)
"""


def test_processes_end_with_a_command_that_is_killed(tmp_path):
    (tmp_path / "killed.py").write_text(KILLED)
    (tmp_path / "marks").mkdir()
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    command = [sys.executable, str(tmp_path / "killed.py"), str(tmp_path / "marks")]
    # The processes inherit this pipe: it comes to its end when the last of them has gone.
    done = subprocess.run(command, env={**os.environ, "PYTHONPATH": path}, stdout=subprocess.PIPE, timeout=60)
    assert done.returncode == -signal.SIGKILL
    marks = {mark.name for mark in (tmp_path / "marks").iterdir()}
    assert marks == {"begun_0", "begun_1", "ended_0", "ended_1"}


def twice_told(folder):
    try:
        os.kill(os.getpid(), signal.SIGTERM)
    finally:
        os.kill(os.getpid(), signal.SIGTERM)
        (folder / "ended").touch()


def test_who_is_told_to_end_a_second_time_still_ends_what_it_has_begun(tmp_path):
    with pytest.raises(BrokenProcessPool), workers(1) as pool:
        pool.submit(twice_told, tmp_path).result()
    assert (tmp_path / "ended").exists()


@everywhere
def test_a_worker_that_is_lost_costs_its_case_one_more_try_and_nothing_else(cluster, tmp_path):
    with workers(2, cluster) as pool:
        futures = [pool.submit(killed_once, n, tmp_path) for n in range(6)]
        assert sorted(f.result() for f in as_completed(futures)) == list(range(6))
    assert sorted((tmp_path / "done").read_text().split()) == list("012345")


@everywhere
def test_a_case_that_loses_its_worker_twice_fails_alone(cluster):
    with workers(2, cluster) as pool:
        futures = {pool.submit(killed_always, n): n for n in range(6)}
        errors = {futures[f]: f.exception() for f in as_completed(futures)}
    assert type(errors.pop(1)).__name__ == ("KilledWorker" if cluster else "BrokenProcessPool")
    assert set(errors.values()) == {None}


@needs_dask
def test_a_cluster_that_does_not_answer_is_refused(monkeypatch):
    monkeypatch.setattr("np_common.parallel._CONNECT", 0.5)
    with pytest.raises(OSError, match="127.0.0.1:1"), workers(1, "tcp://127.0.0.1:1"):
        pass


def test_without_dask_the_error_names_the_command(monkeypatch):
    monkeypatch.setattr("np_common.parallel.find_spec", lambda name: None)
    assert "`make cluster`" in missing(LOCAL) and not missing("")
    with pytest.raises(OSError, match="expected the package distributed, which `make cluster` installs"):
        workers(1, LOCAL)
