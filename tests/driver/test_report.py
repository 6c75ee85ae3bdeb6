"""The report keeps what it has measured, and its account of cores is the process's own."""

import json
import os
import time

import pytest
from cpu_shares import CpuShares
from pages.driver import COLUMNS, page
from report import Journal, jobs, measure

RUN = {"date": "2026-01-01", "pace": 1.0}


def listed(done, *, broken=()):
    """Three jobs of one part; `done` collects those that are run."""

    def job(text):
        def run():
            done.append(text)
            if text in broken:
                raise RuntimeError("no arm")
            return {"fault": text}

        return "faults", text, run

    return [job(text) for text in ("first", "second", "third")]


def test_an_interrupted_run_goes_on_where_it_was(tmp_path):
    path, done, written = tmp_path / "runs" / "journal.json", [], []
    errors = measure(listed(done, broken=["second"]), Journal(path, RUN), lambda *rows: written.append(rows))
    assert done == ["first", "second", "third"] and errors == ["second: RuntimeError: no arm"]
    done.clear()
    journal = Journal(path, RUN)
    assert measure(listed(done), journal, lambda *rows: written.append(rows)) == []
    assert done == ["second"]
    assert written[-1] == ("faults", [{"fault": text} for text in ("first", "second", "third")])
    journal.close()
    assert not Journal(path, RUN).rows


def test_the_rows_of_another_run_are_not_taken_over(tmp_path):
    path = tmp_path / "journal.json"
    Journal(path, RUN).add("first", {"fault": "first"})
    assert Journal(path, RUN).rows and not Journal(path, {**RUN, "pace": 3.0}).rows


def test_the_page_is_made_of_what_has_been_measured(tmp_path):
    row = dict.fromkeys(COLUMNS["faults"], "a | b")
    faults = {"date": "2026-01-01", "machine": "2 cores", "pace": 1.0, "rows": [row]}
    data = tmp_path / "driver.json"
    data.write_text(json.dumps({"faults": faults}))
    text = page(data)
    assert text.count("## ") == 1 and "2026-01-01, 2 cores ([data](driver.json))" in text
    assert "| " + " | ".join(["a / b"] * len(row)) + " |" in text


def test_every_part_has_its_jobs():
    names = [text for _, text, _ in jobs(list(COLUMNS), 60.0, 1.0, [])]
    for text in ("tracking topic", "tracking onboard", "approach topic", "approach onboard", "suite topic"):
        assert text in names
    assert len(names) == len(set(names)) > 20


def test_the_share_of_a_process_is_the_time_that_it_took():
    counted, begin, wall = CpuShares({"this": os.getpid()}), time.process_time(), time.monotonic()
    while time.process_time() - begin < 0.5:
        sum(range(1000))
    shares, seconds = counted.shares(), time.monotonic() - wall
    assert 0.0 <= counted.stolen() <= 1.0
    assert shares["this"] * seconds == pytest.approx(0.5, abs=0.05)  # the kernel counts in ticks of 10 ms
    assert shares["this, other threads"] == pytest.approx(0.0, abs=0.05 / seconds)
