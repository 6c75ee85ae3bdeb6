"""`make driver-report`: what the driver did, measured: tracking, a card approach, the diagnosis suite,
faults; JSON and a page of tables.

The last line is one JSON object. Give the machine to it: robot, driver and controller run at real-time
priority where that is permitted, but the recorder, the policies and the kernel have what is left. Faults
need no quiet machine: for those the robot's clock goes at a third of the speed. What an interrupted run has
measured is kept, and the next run goes on from there."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
from collections.abc import Callable
from datetime import date
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parent / "contract"), str(HERE.parents[1] / "tools")]

import fault_cases  # noqa: E402
import suite  # noqa: E402
from approach import approach  # noqa: E402
from moving_arm import MovingArm  # noqa: E402
from pages import driver  # noqa: E402
from simulated_robot import missing  # noqa: E402
from tracking import track  # noqa: E402

from np_common.cli import INTERRUPTED, Progress, interrupt_on_sigterm  # noqa: E402
from np_description.weights.provenance import origin  # noqa: E402

PARTS = ("tracking", "approach", "suite", "faults")
CONTROLS = ("topic", "onboard")
FAILURES = (RuntimeError, TimeoutError, AssertionError, OSError, KeyError)
Job = tuple[str, str, Callable[[], dict]]  # part, what the progress bar says, what gives a row


def diagnosed(control: str, only: list[str], pace: float) -> dict[str, object]:
    """The excitation suite through the driver, and what `diagnose --quick` says of the recording."""
    with tempfile.TemporaryDirectory() as folder:
        with MovingArm(control, pace=pace, priority=True) as arm:
            load = os.getloadavg()[0]
            arm.deafen()
            recorded = suite.record(arm, Path(folder), only)
        found = suite.diagnose(recorded["bag"], Path(folder))
    return {
        "control": control,
        "load_before": round(load, 2),
        "experiments": len(recorded["segments"]),
        "messages": recorded["messages"],
        "lost": recorded["lost"],
        "verdict": found["verdict"],
        "diagnose_s": found["runtime_s"],
    }


def jobs(parts: list[str], seconds: float, pace: float, only: list[str]) -> list[Job]:
    """Everything to be measured."""
    measured: list[Job] = [
        (part, f"{part} {control}", lambda m=measure, c=control: m(c))
        for part, measure, controls in (
            ("tracking", lambda c: track(c, seconds, pace), CONTROLS),
            ("approach", lambda c: approach(c, pace), CONTROLS),
            ("suite", lambda c: diagnosed(c, only, pace), CONTROLS[:1]),
        )
        for control in controls
    ]
    measured += [
        ("faults", f"{name} {control}", lambda n=name, c=control: fault_cases.measure(n, c))
        for name, control in fault_cases.PAIRS
    ]
    return [job for job in measured if job[0] in parts]


class Journal:
    """The rows of a run by the text of their job, on disk after each, so that an interrupted run goes on; of
    another day, revision or options they are dropped."""

    def __init__(self, path: Path, run: dict):
        self._path, self._run = path, run
        self.rows: dict[str, dict] = {}
        if path.exists():
            kept = json.loads(path.read_text())
            self.rows = kept["rows"] if kept["run"] == run else {}

    def add(self, text: str, row: dict) -> None:
        """Keep a row."""
        self.rows[text] = row
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._path.write_text(json.dumps({"run": self._run, "rows": self.rows}))

    def close(self) -> None:
        """The run is complete: the next begins anew."""
        self._path.unlink(missing_ok=True)


def measure(listed: list[Job], journal: Journal, write: Callable[[str, list[dict]], None]) -> list[str]:
    """Do the jobs that the journal has no row of; `write` is given the rows of a part after each. What went
    wrong, a line each."""
    errors = []
    progress = Progress(len(listed), "driver")
    for number, (part, text, job) in enumerate(listed):
        progress.show(number, text)
        if text not in journal.rows:
            try:
                journal.add(text, job())
            except FAILURES as error:
                errors.append(f"{text}: {type(error).__name__}: {error}")
                print(errors[-1], file=sys.stderr)
        if rows := [journal.rows[t] for p, t, _ in listed if p == part and t in journal.rows]:
            write(part, rows)
    progress.show(len(listed), "done")
    return errors


def machine() -> str:
    """Whose figures these are."""
    is_virtual = "hypervisor" in Path("/proc/cpuinfo").read_text()
    shared = " of a shared virtual machine" if is_virtual else ""
    return f"{os.cpu_count()} cores{shared}, {platform.machine()}"


def parse() -> argparse.Namespace:
    """The options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the tracking in each mode")
    parser.add_argument(
        "--pace",
        type=float,
        default=1.0,
        help="ms that a cycle of the robot takes in tracking, approach and suite: more on a busy machine",
    )
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--only", nargs="+", default=[], metavar="EXPERIMENT", help="of the suite, not all")
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    parser.add_argument("--journal", type=Path, default=Path("runs/driver_report.json"))
    options = parser.parse_args()
    if reason := missing():
        parser.error(reason)
    return options


def main() -> int:
    """Entry point."""
    options = parse()
    interrupt_on_sigterm()
    about = {
        "date": date.today().isoformat(),
        "machine": machine(),
        "pace": options.pace,
    }
    revision = origin()["revision"].removesuffix("-dirty")  # the report itself changes the tree
    run = {**about, "seconds": options.seconds, "only": options.only, "revision": revision}
    journal = Journal(options.journal, run)
    options.out.mkdir(parents=True, exist_ok=True)
    data = options.out / "driver.json"

    def write(part: str, rows: list[dict]) -> None:
        known = json.loads(data.read_text()) if data.exists() else {}
        known[part] = {**about, "rows": rows}
        data.write_text(json.dumps({name: known[name] for name in PARTS if name in known}, indent=1) + "\n")
        data.with_suffix(".md").write_text(driver.page(data))

    try:
        errors = measure(jobs(options.parts, options.seconds, options.pace, options.only), journal, write)
    except KeyboardInterrupt:
        print(f"interrupted; what was measured is kept in {options.journal}", file=sys.stderr)
        return INTERRUPTED
    over = [f"{text}: {limit}" for text, row in journal.rows.items() for limit in row.get("over_limit", ())]
    print(json.dumps({"over_limit": over, "errors": errors, "rows": journal.rows}))
    if not errors:
        journal.close()
    return 1 if errors or over else 0


if __name__ == "__main__":
    raise SystemExit(main())
