"""Mutation testing of control or of training: small faults are put into copies of the code, and a test has to fail.

A mutant is written into a temporary copy of its package, which goes before the original on the path; the checkout is never changed.
Tests run in a fork of a process that has imported all but the project, up to the first that fails: those that execute the changed
line, then all others that import its module.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib import import_module
from pathlib import Path

import mutant_operators
from mutant_operators import Mutant, mutants, mutated
from mutant_sets import ELSEWHERE, SETS

ROOT = Path(__file__).resolve().parents[1]
PUBLISHED = ROOT / "tools/mutants.json"
LONGEST_TEST, LONGEST_MUTANT, LONGEST_WAIT = 8.0, 25.0, 600.0
"""Processor seconds of a test that is used and of all tests of one mutant, without a mutant; seconds that a mutant may wait for nothing."""
NO_TESTS, UNUSED = 5, 71  # pytest's status; tests that have imported the original
EXAMPLES = 30  # of a property that does not set a number


@dataclass(frozen=True)
class Project:
    """What is mutated, and what has to notice it."""

    root: Path
    """Where pytest runs."""
    modules: tuple[Path, ...]
    """Files of modules, each in a package."""
    tests: tuple[Path, ...]
    """Test files."""

    def key(self, tests: Sequence[Path]) -> str:
        """Hash of the modules and of these test files: results of others are of no use."""
        return sha256(b"".join(sha256(path.read_bytes()).digest() for path in (*self.modules, *tests))).hexdigest()

    def name(self, module: Path) -> str:
        """A module's path within the project."""
        return str(module.relative_to(self.root))


def own_project(name: str) -> Project:
    """This repository, with the modules and tests of a set."""
    modules, tests = SETS[name]
    found = {path for pattern in modules for path in ROOT.glob(pattern) if path.name not in ELSEWHERE}
    return Project(
        ROOT, tuple(sorted(found)), tuple(sorted(path for pattern in tests for path in (ROOT / "tests").glob(pattern)))
    )


class _Plugin:
    """Runs the chosen test functions, all where none are chosen; hypothesis always draws the same few and does not shrink.

    With a coverage object, notes seconds and executed lines of each test that passes.
    """

    def __init__(self, chosen: Sequence[str] = (), coverage=None):
        self._began = 0.0
        self._chosen, self._coverage = chosen, coverage
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()

    def pytest_collection(self, session) -> None:
        from hypothesis import Phase, settings

        phases = (Phase.explicit, Phase.generate)
        settings.register_profile(
            "mutants", deadline=None, database=None, derandomize=True, phases=phases, max_examples=EXAMPLES
        )
        settings.load_profile("mutants")

    def pytest_collection_modifyitems(self, items: list) -> None:
        if self._chosen:
            order = {name: n for n, name in enumerate(self._chosen)}
            items[:] = sorted(
                (item for item in items if _function(item) in order), key=lambda item: order[_function(item)]
            )

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._began = time.process_time()
        if self._coverage:
            self._coverage.switch_context(nodeid.split("[")[0])

    def pytest_runtest_logreport(self, report) -> None:
        if not report.passed:
            self.failed.add(report.nodeid.split("[")[0])

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        name = nodeid.split("[")[0]
        self.seconds[name] = self.seconds.get(name, 0.0) + time.process_time() - self._began


def _function(item) -> str:
    return item.nodeid.split("[")[0]


def _fork(work: Callable[[], int], log: Path) -> int:
    """A child, in a session of its own, that ends with the status that `work` returns; its output goes into `log`."""
    child = os.fork()
    if child:
        return child
    status = 70
    try:
        os.setsid()
        output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1), os.dup2(output, 2)
        status = int(work())
    finally:
        os._exit(status)


def _pytest(project: Project, tests: Sequence[str], plugin: _Plugin, *options: str) -> int:
    import pytest

    os.chdir(project.root)
    select = ("-m", "not slow and not real_time", "-p", "no:cacheprovider", f"--rootdir={project.root}")
    select += ("-o", "pythonpath=")  # which would find the original before the copy; the environment has it too
    return pytest.main(["-q", *select, *options, *tests], plugins=[plugin])


def _measure(project: Project, tests: Sequence[Path], folder: Path) -> list[dict]:
    """Of each test file: seconds of each test function, the lines of modules that it executes, tests that fail; and what was imported that
    is not the project's."""
    result = folder / "baseline.json"

    def work() -> int:
        from coverage import Coverage

        coverage = Coverage(data_file=None, config_file=False, include=[str(path) for path in project.modules])
        coverage.start()
        plugin = _Plugin(coverage=coverage)
        status = _pytest(project, [str(path) for path in tests], plugin)
        coverage.stop()
        data = coverage.get_data()
        lines: dict[str, dict[str, list[int]]] = {}
        for path in data.measured_files():
            for line, names in data.contexts_by_lineno(path).items():
                for name in filter(None, names):
                    lines.setdefault(name, {}).setdefault(project.name(Path(path)), []).append(line)
        files = ((name, getattr(module, "__file__", None) or "") for name, module in list(sys.modules.items()))
        imports = [name for name, file in files if "site-packages" in file and "/install/" not in file]
        rows = []
        for path in tests:
            own = [name for name in plugin.seconds if name.split("::")[0] == project.name(path)]
            good = [name for name in own if name not in plugin.failed and plugin.seconds[name] <= LONGEST_TEST]
            rows.append({
                "tests": project.name(path), "key": project.key([path]), "seconds": {n: round(plugin.seconds[n], 3) for n in good},
                "lines": {n: lines.get(n, {}) for n in good}, "imports": imports, "left_out": sorted(set(own) - set(good)),
            })  # fmt: skip
        result.write_text(json.dumps(rows))
        return status if status != 1 else 0

    child = _fork(work, folder / "baseline.log")
    if os.waitpid(child, 0)[1] or not result.exists():
        raise RuntimeError(
            f"expected tests that run without a mutant:\n{(folder / 'baseline.log').read_text()[-3000:]}"
        )
    return json.loads(result.read_text())


def _tests_of(mutant: Mutant, project: Project, baseline: dict) -> list[str]:
    """Test functions that execute the mutant's lines, then all others that import its module; each time those of short files first."""
    dotted = _dotted(project.root / mutant.module)
    texts = {project.name(path): path.read_text() for path in project.tests}
    lines = range(mutant.line, mutant.last_line + 1)
    chosen: dict[tuple[bool, str], list[str]] = {}
    for name in baseline["seconds"]:
        executed, file = baseline["lines"].get(name, {}).get(mutant.module, []), name.split("::")[0]
        if executed or dotted in texts[file] or f"from {dotted.rpartition('.')[0]} import " in texts[file]:
            chosen.setdefault((set(lines).isdisjoint(executed), file), []).append(name)
    ordered, total = [], 0.0
    for _, names in sorted(chosen.items(), key=lambda item: (item[0][0], sum(map(baseline["seconds"].get, item[1])))):
        for name in names:
            total += baseline["seconds"][name]
            if total <= LONGEST_MUTANT or not ordered:
                ordered.append(name)
    return ordered


def _dotted(module: Path) -> str:
    return ".".join(module.relative_to(_package(module).parent).with_suffix("").parts)


def _package(module: Path) -> Path:
    """The outermost package that holds the module."""
    folder = module.parent
    while (folder.parent / "__init__.py").exists():
        folder = folder.parent
    return folder


def _start(mutant: Mutant, project: Project, tests: list[str], folder: Path, limit: int) -> int:
    """A child that runs the tests with the mutant, for `limit` processor seconds at most."""
    module = project.root / mutant.module
    package = _package(module)
    copy = folder / package.name
    shutil.copytree(package, copy)
    target = copy / module.relative_to(package)
    target.write_text(mutated(module.read_text(), mutant.number))
    for old in (target.parent / "__pycache__").glob(f"{target.stem}.*"):
        old.unlink()

    def work() -> int:
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))
        sys.path.insert(0, str(folder))
        os.environ["PYTHONPATH"] = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
        status = _pytest(project, sorted({name.split("::")[0] for name in tests}), _Plugin(tests), "-x")
        tested = sys.modules.get(_dotted(module))
        return UNUSED if tested and not Path(tested.__file__).is_relative_to(folder) else status

    return _fork(work, folder / "log")


def draw(project: Project, cases: int, seed: int) -> list[Mutant]:
    """`cases` mutants, from each module as many; all where `cases` is 0."""
    rng = random.Random(seed)
    queues = [mutants(project.name(path), path.read_text()) for path in project.modules]
    for queue in queues:
        rng.shuffle(queue)
    drawn = [queue[i] for i in range(max(map(len, queues))) for queue in queues if i < len(queue)]
    return drawn[: cases or None]


def run(
    project: Project, drawn: list[Mutant], file: Path, jobs: int = 1, patience: float = 20.0
) -> tuple[list[tuple[Mutant, str]], dict]:
    """Outcome of each mutant: killed, timeout, survived; and the tests that failed without one.

    What `file` (a JSON object a line) holds of the same code and tests is not run again.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    kept = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    measured = {row["key"]: row for row in kept if "tests" in row}
    key = project.key((*project.tests, Path(mutant_operators.__file__)))
    with tempfile.TemporaryDirectory() as temporary:
        if missing := [path for path in project.tests if project.key([path]) not in measured]:
            print(f"tests of {len(missing)} files without a mutant", file=sys.stderr, flush=True)
            rows = _measure(project, missing, Path(temporary))
            measured.update((row["key"], row) for row in rows)
            with file.open("a") as out:
                out.writelines(json.dumps(row) + "\n" for row in rows)
        rows = [measured[project.key([path])] for path in project.tests]
        baseline = {
            name: {test: value for row in rows for test, value in row[name].items()} for name in ("seconds", "lines")
        }
        baseline["left_out"] = [test for row in rows for test in row["left_out"]]
        done = {(row["module"], row["number"]): row["outcome"] for row in kept if "module" in row and row["key"] == key}
        for name in sorted({name for row in rows for name in row["imports"]}):
            try:
                import_module(name)
            except Exception:  # whatever it needs, the tests that need it import it themselves
                continue
        waiting = [m for m in drawn if (m.module, m.number) not in done]
        running: dict[int, tuple[Mutant, float, Path]] = {}
        with file.open("a") as out:

            def note(mutant: Mutant, outcome: str) -> None:
                done[mutant.module, mutant.number] = outcome
                out.write(
                    json.dumps({"module": mutant.module, "number": mutant.number, "key": key, "outcome": outcome})
                    + "\n"
                )
                out.flush()
                at = f"{mutant.module}:{mutant.line}"
                print(
                    f"{len(done)} {outcome} {at} {mutant.original!r} -> {mutant.mutant!r}", file=sys.stderr, flush=True
                )

            while waiting or running:
                while waiting and len(running) < jobs:
                    mutant = waiting.pop(0)
                    tests = _tests_of(mutant, project, baseline)
                    if not tests:
                        note(mutant, "survived")
                        continue
                    folder = Path(tempfile.mkdtemp(dir=temporary))
                    limit = round(patience + 5 * sum(map(baseline["seconds"].get, tests)))
                    child = _start(mutant, project, tests, folder, limit)
                    running[child] = mutant, time.monotonic() + LONGEST_WAIT, folder
                child, status = os.waitpid(-1, os.WNOHANG) if running else (0, 0)
                late = [pid for pid, (_, deadline, _) in running.items() if time.monotonic() > deadline]
                if not child and late:
                    os.killpg(late[0], signal.SIGKILL)
                    child, status = os.waitpid(late[0], 0)[0], None
                if not child:
                    time.sleep(0.02)
                    continue
                mutant, _, folder = running.pop(child)
                code = None if status is None else os.waitstatus_to_exitcode(status)
                code = None if code == -signal.SIGXCPU else code
                if code in (NO_TESTS, UNUSED):
                    raise RuntimeError(f"expected tests of {mutant}: {(folder / 'log').read_text()[-2000:]}")
                note(mutant, "timeout" if code is None else "killed" if code else "survived")
                shutil.rmtree(folder)
    return [(mutant, done[mutant.module, mutant.number]) for mutant in drawn], baseline


def summary(results: list[tuple[Mutant, str]], reasons: dict[tuple, str]) -> dict:
    """Figures of a run: killed (timeouts too), score, by module, and who survived, each with its reason where there is one."""
    alive = [mutant for mutant, outcome in results if outcome == "survived"]
    modules: dict[str, list[int]] = {}
    for mutant, outcome in results:
        row = modules.setdefault(mutant.module, [0, 0])
        row[0] += outcome in ("killed", "timeout")
        row[1] += 1
    figures = {"mutants": len(results), "killed": len(results) - len(alive)}
    figures["timeouts"] = sum(outcome == "timeout" for _, outcome in results)
    figures["score"] = round(figures["killed"] / max(1, len(results)), 3)
    figures["modules"] = {name: {"mutants": n, "killed": killed} for name, (killed, n) in sorted(modules.items())}
    figures["survivors"] = [
        {
            **{name: getattr(mutant, name) for name in ("module", "line", "text", "original", "mutant")},
            "reason": reasons.get(mutant.key, ""),
        }
        for mutant in alive
    ]
    return figures


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--set", choices=SETS, default="control", help="what is mutated")
    parser.add_argument("--cases", type=int, default=200, help="mutants, as many from each module; 0: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument(
        "--out", type=Path, default=ROOT / "runs/mutants.jsonl", help="where results are kept: killed, it goes on"
    )
    options = parser.parse_args(arguments)
    began, project = time.monotonic(), own_project(options.set)
    reasons = {}
    if PUBLISHED.exists():
        rows = [row for part in json.loads(PUBLISHED.read_text()).values() for row in part["survivors"]]
        reasons = {(row["module"], row["text"], row["original"], row["mutant"]): row["reason"] for row in rows}
    results, baseline = run(project, draw(project, options.cases, options.seed), options.out, options.jobs)
    figures = {
        "set": options.set,
        "seed": options.seed,
        **summary(results, reasons),
        "tests_left_out": baseline["left_out"],
    }
    print(json.dumps({**figures, "wall_s": round(time.monotonic() - began, 1)}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
