"""A training run: its tolerance, its log, and how it goes on after a kill."""

import io
import subprocess
import sys
from collections import defaultdict

import pytest
import torch

from np_description.domains import CARD, DOMAINS
from np_training import train
from np_training.ppo.curriculum import STAGES
from np_training.ppo.log import TrainingLog, read_log
from np_training.ppo.progress import TrainingProgress, describe


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=DOMAINS)
def test_training_is_for_the_share_of_the_tolerance_that_the_domain_aims_at(domain, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["train", "--domain", domain.name])
    assert 0 < train.parse().stages[0].tolerance == domain.tolerance_fraction <= 1
    monkeypatch.setattr(sys, "argv", [*sys.argv, "--set", "tolerance=1"])
    assert train.parse().stages[0].tolerance == 1


def test_a_log_survives_a_kill_and_new_columns(tmp_path):
    path = tmp_path / "log.csv"
    log = TrainingLog(path)
    for iteration in (1, 2, 3):
        log.write({"iteration": iteration, "success": 0.1 * iteration})
    with path.open("a") as file:
        file.write("4,0.")  # killed in the middle of a row: no line end; looks like a whole row
    log = TrainingLog(path)  # resumed from a checkpoint after iteration 2
    log.write({"iteration": 3, "lost": 0.5, "success": 0.9})
    log.write({"iteration": 4, "success": 0.95})
    rows = read_log(path)
    assert [row["iteration"] for row in rows] == [1, 2, 3, 4]
    assert [row["success"] for row in rows] == pytest.approx([0.1, 0.2, 0.9, 0.95])
    assert rows[2]["lost"] == 0.5 and rows[0]["lost"] != rows[0]["lost"]
    assert len(path.read_text().splitlines()) == 1 + 3 + 2  # what the killed run logged is still there


def test_a_row_that_a_kill_cut_short_does_not_spoil_the_next_one(tmp_path):
    path = tmp_path / "log.csv"
    TrainingLog(path).write({"iteration": 1, "success": 0.5})
    with path.open("a") as file:
        file.write("2,0.")
    TrainingLog(path).write({"iteration": 2, "success": 0.75})
    assert read_log(path) == [{"iteration": 1, "success": 0.5}, {"iteration": 2, "success": 0.75}]


def test_a_log_has_whole_numbers_in_full_and_others_to_six_digits(tmp_path):
    TrainingLog(tmp_path / "log.csv").write({"iteration": 1, "steps": 1_234_567_890, "success": 2 / 3, "kl": 1e-7 / 3})
    assert (tmp_path / "log.csv").read_text().split() == [
        "iteration,steps,success,kl",
        "1,1234567890,0.666667,3.33333e-08",
    ]


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_from_its_checkpoint(tmp_path, monkeypatch):
    options = [
        "--worlds",
        "4",
        "--set",
        "rollout=2",
        "--device",
        "cpu",
        "--out",
        str(tmp_path),
        "--save-every",
        "0",
        "--show-every",
        "0",
        "--iterations",
    ]
    with subprocess.Popen(
        [sys.executable, "-m", "np_training.train", *options, "1000"],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    ) as process:
        shown = (line for line in process.stderr if "M steps" in line)
        first, second = (
            next(shown, ""),
            next(shown, ""),
        )  # a row is logged, shown, then saved: the first was saved
        process.kill()
        process.stderr.read()
    assert "success" in first and "min left" in second
    saved = torch.load(tmp_path / "checkpoint.pt", weights_only=True)["iteration"]
    monkeypatch.setattr("sys.argv", ["train", *options, "1"])
    train.main()
    rows = read_log(tmp_path / "log.csv")
    last = torch.load(tmp_path / "checkpoint.pt", weights_only=True)["iteration"]
    assert last == saved + 1 and [row["iteration"] for row in rows][:last] == list(range(1, last + 1))


@pytest.mark.parametrize("live", [True, False])
def test_a_terminal_shows_every_row_at_once_on_one_line_that_is_left_at_the_end(live):
    class Terminal(io.StringIO):
        shown = ""

        def isatty(self):
            return live

        def flush(self):
            self.shown = self.getvalue()

    stream = Terminal()
    progress, row = TrainingProgress(stream), defaultdict(float, stage=3)
    for _ in range(2):
        progress.show(row, 60)
    line = describe(row, 60)
    assert stream.shown == (2 * f"\r\x1b[K{line}" if live else f"{line}\n")
    progress.end()
    assert stream.shown == (2 * f"\r\x1b[K{line}" + "\n" if live else f"{line}\n")


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=lambda d: d.name)
def test_progress_names_what_is_going_on(domain, capsys, monkeypatch):
    row = {
        "steps": 2_000_000,
        "steps_per_second": 250_000.0,
        "stage": STAGES + 1,
        "randomisation": 0.1,
        "success": 0.5,
        "practice": 0.2,
        "success_roll": 0.9,
        "lost": 0.1,
        "length": 30.0,
        "end_distance": 0.012,
        "end_angle": 0.2,
        "pre_feasible": 1.0,
        "std": 0.3,
        "kl": 0.01,
    }
    if domain is not CARD:
        row["success_tips1"] = 0.25
    text = describe(row, 90)
    for part in (
        "2.0 M steps",
        "250.0 k/s",
        "randomised 10%",
        "success 0.500",
        "practice 0.20: roll 0.90",
        "1.5 min left",
    ):
        assert part in text
    assert ("tips1 0.25" in text) == (domain is not CARD)
    pressed = {"force_median": 12.4, "force_q99": 31.0, "pressed": 0.02, "overflowed": 3.0}
    assert "force 12 N, 99 % 31, stopped 0.020" in describe(row | pressed, 90)
    assert describe(row | pressed, 90).endswith("3 worlds over capacity  1.5 min left")
    assert "force" not in text and "capacity" not in text
    del row["randomisation"]
    assert f"stage {STAGES + 1}/{STAGES}" in describe(row, 90)
    progress = TrainingProgress()
    for now, lines in ((1000.0, 1), (1059.0, 0), (1060.0, 1)):
        monkeypatch.setattr("np_training.ppo.progress.time.monotonic", lambda now=now: now)
        progress.show(row, 90)
        assert capsys.readouterr().err.count("\n") == lines  # no terminal: a line a minute
