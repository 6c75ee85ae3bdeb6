"""The file in which an evaluation's results stand, one line of JSON for each episode, and survive whatever ends it."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path

from np_common.files import write_atomically
from np_evaluation.scoring import Result


class Results:
    """Results so far, in a file that a killed run leaves complete up to its last finished episode.

    The file is <folder>/<hash of settings>.jsonl; its first line holds the settings. Episodes found in it, or in the parts
    (`PartialResults`) that a killed run has left beside it, are not run again, unless `fresh`. `results` has them in order, `kept` how many
    they are, `kept_from` when the last of them was run. The setting `revision` is only recorded, not compared: its files may be edited, and
    another commit may hold the same code. Raises ValueError for a file that holds something else.
    """

    def __init__(self, folder: Path, settings: Mapping[str, object], fresh: bool = False):
        text = json.dumps({"settings": dict(settings)}, sort_keys=True)
        key = _key(text)
        name = "_".join(str(settings[key]) for key in ("domain", "keypoints", "controller", "seed") if key in settings)
        self.path = folder / f"{name}_{hashlib.sha256(key.encode()).hexdigest()[:8]}.jsonl"
        self.kept_from = ""
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OSError(f"{folder}: expected a folder that can be written, got: {error.strerror}") from error
        if fresh:
            for path in (self.path, *self._parts()):
                path.unlink(missing_ok=True)
        lines = _lines(self.path)
        if lines and _key(lines[0]) != key:
            raise ValueError(f"{self.path}: expected results for {text}, found {lines[0].strip()}")
        if lines:
            self.kept_from = time.strftime("%Y-%m-%d %H:%M", time.localtime(self.path.stat().st_mtime))
        self._header = lines[0].rstrip("\n") if lines else text
        self._by_number = dict(_read(self.path, lines[1:], 2))
        self.collect()
        self.kept = len(self._by_number)

    @property
    def results(self) -> list[Result]:
        """Results in the order of their numbers."""
        return [self._by_number[number] for number in sorted(self._by_number)]

    def add(self, result: Result) -> None:
        """Append one result, written out at once."""
        self._by_number[result.episode] = result
        with self.path.open("a") as file:
            file.write(_line(result))

    def missing(self, episodes: int) -> list[range]:
        """The episodes below a number that have no result, in runs without a gap."""
        runs: list[range] = []
        for number in (n for n in range(episodes) if n not in self._by_number):
            if runs and runs[-1].stop == number:
                runs[-1] = range(runs[-1].start, number + 1)
            else:
                runs.append(range(number, number + 1))
        return runs

    def part(self, numbers: range) -> Path:
        """File for the results of some episodes that another process runs."""
        return self.path.with_suffix(f".{numbers.start}_{numbers.stop}.part")

    def finished(self) -> int:
        """Number of episodes with a result, those in parts included."""
        return len(self._by_number) + sum(max(0, path.read_text().count("\n")) for path in self._parts())

    def collect(self) -> None:
        """Take what stands in the parts into the file, and remove them."""
        parts = self._parts()
        for path in parts:
            for number, result in _read(path, _lines(path), 1):
                self._by_number[number] = result
        complete = "".join([self._header + "\n", *map(_line, self.results)])
        if not self.path.exists() or self.path.read_text() != complete:
            write_atomically(self.path, complete)
        for path in parts:
            path.unlink()

    def _parts(self) -> list[Path]:
        return sorted(self.path.parent.glob(f"{self.path.stem}.*.part"))


class PartialResults:
    """The file in which one worker process writes its results in order; `Results` collects them.

    `done`: how many are there already, of one that was lost with the process before.
    """

    def __init__(self, path: Path):
        self._path = path
        complete = [line for line in _lines(path) if line.endswith("\n")]
        path.write_text("".join(complete))
        self.done = len(complete)

    def add(self, result: Result) -> None:
        """As `Results.add`."""
        with self._path.open("a") as file:
            file.write(_line(result))


def read_results(path: Path) -> list[Result]:
    """The results in a file of `Results`, in the order of their numbers. Raises ValueError for a line that is none."""
    return sorted((result for _, result in _read(path, _lines(path)[1:], 2)), key=lambda result: result.episode)


def split_runs(runs: list[range], jobs: int) -> list[range]:
    """Runs of episodes for so many processes, none much longer than another."""
    if not runs:
        return []
    longest = -(-sum(map(len, runs)) // jobs)
    return [
        range(start, min(start + longest, run.stop)) for run in runs for start in range(run.start, run.stop, longest)
    ]


def _lines(path: Path) -> list[str]:
    return path.read_text().splitlines(keepends=True) if path.exists() else []


def _read(path: Path, lines: list[str], first: int) -> Iterator[tuple[int, Result]]:
    for number, line in enumerate(lines):
        if not line.endswith("\n"):
            return  # cut off while it was written: that episode is run again
        try:
            result = Result(**json.loads(line))
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path}, line {number + first}: expected one result, found {line.strip()}") from error
        yield result.episode, result


def _key(header: str) -> str:
    """The settings in a first line, without the revision; the line itself where it has none."""
    try:
        settings = json.loads(header)["settings"]
        return json.dumps({name: value for name, value in settings.items() if name != "revision"}, sort_keys=True)
    except (TypeError, ValueError, KeyError, AttributeError):
        return header


def _line(result: Result) -> str:
    return json.dumps(asdict(result)) + "\n"
