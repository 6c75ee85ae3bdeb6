"""`make driver-report`: what the driver did, measured: faults, tracking, a card approach; JSON and a page of
tables.

The last line is one JSON object. Give the machine to it: for tracking and approach robot, driver and
controller run at real-time priority where that is permitted, and what else runs shows in the figures. Faults
need no quiet machine: for those the robot's clock goes at a third of the speed."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from datetime import date
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parent / "contract")]

import fault_cases  # noqa: E402
import motion_report  # noqa: E402
import tables  # noqa: E402
from np_bringup.commands.common import Progress, interrupt_on_sigterm  # noqa: E402
from simulated_robot import missing  # noqa: E402

PARTS = ("faults", "tracking", "approach")
CONTROLS = ("topic", "onboard")


def jobs(parts: list[str], seconds: float, pace: float) -> list[tuple[str, str, object]]:
    """(part, text, what gives a row) of everything to be measured."""
    listed = []
    if "faults" in parts:
        listed += [
            ("faults", f"{name} {control}", lambda n=name, c=control: fault_cases.measure(n, c))
            for name, control in fault_cases.PAIRS
        ]
    for part, measure in (
        ("tracking", lambda c: motion_report.track(c, seconds, pace)),
        ("approach", lambda c: motion_report.approach(c, pace)),
    ):
        if part in parts:
            listed += [(part, f"{part} {control}", lambda m=measure, c=control: m(c)) for control in CONTROLS]
    return listed


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the tracking in each mode")
    parser.add_argument(
        "--pace",
        type=float,
        default=1.0,
        help="ms of a cycle of the robot in tracking and approach: more on a busy machine",
    )
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    parser.add_argument("--page", type=Path, default=Path("docs/driver_results.md"))
    options = parser.parse_args()
    interrupt_on_sigterm()
    if reason := missing():
        parser.error(reason)
    origin = {
        "date": date.today().isoformat(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "pace": options.pace,
    }
    rows: dict[str, list[dict]] = {part: [] for part in options.parts}
    errors = []
    listed = jobs(options.parts, options.seconds, options.pace)
    progress = Progress(len(listed), "driver")
    options.out.mkdir(parents=True, exist_ok=True)
    for number, (part, text, measure) in enumerate(listed):
        progress.show(number, text)
        try:
            rows[part].append(measure())
        except (RuntimeError, TimeoutError, AssertionError, OSError, KeyError) as error:
            errors.append(f"{text}: {type(error).__name__}: {error}")
            print(errors[-1], file=sys.stderr)
            continue
        # After every row: what has been measured is not lost with what is still to come.
        content = json.dumps({**origin, "rows": rows[part]}, indent=1)
        (options.out / f"driver_{part}.json").write_text(content + "\n")
        options.page.write_text(tables.page(options.out, PARTS))
    progress.show(len(listed))
    over = [
        f"{row['fault']} ({row['control']}): {text}"
        for row in rows.get("faults", [])
        for text in row["over_limit"]
    ]
    print(
        json.dumps(
            {
                "faults": len(rows.get("faults", [])),
                "over_limit": over,
                "errors": errors,
                **{part: rows[part] for part in ("tracking", "approach") if part in rows},
            }
        )
    )
    return 1 if errors or over else 0


if __name__ == "__main__":
    raise SystemExit(main())
