"""`clock A.npz:NAME B.npz:NAME [--out DIR]`: do two streams of poses of one body tell the same time?

Two streams of one rigid body, such as a hand by its joints and a camera on it: B's offset and drift against A, frames that
are missing. Each is an array (n, 8): stamp s, position x y z m, quaternion x y z w. Needs no ROS. The last line printed is
one JSON object; DIR gets clock.json and clock.html.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from np_common.cli import Parser
from sim2real.cli.answers import keep, refuse


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="clock", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("a", metavar="A.npz:NAME", help="the stream whose clock counts")
    parser.add_argument("b", metavar="B.npz:NAME", help="the stream that may be late, such as a camera's")
    parser.add_argument("--within", type=float, help="s to either side that an offset is sought in (default 1)")
    parser.add_argument("--out", type=Path, help="folder for clock.json and clock.html")
    options = parser.parse_args(arguments)
    if options.within is not None and not 0 < options.within <= 60:
        parser.error(f"--within: expected more than 0 s and at most 60, got {options.within:g}")
    return options


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Status 2: a stream that is none."""
    options = parse(arguments)
    # Slow to import, and not wanted by --help.
    from sim2real import single_thread  # noqa: F401, I001  before NumPy
    from sim2real.recordings.reading import ContractViolation
    from sim2real.report.clock_words import document, sentence
    from sim2real.task.clock import CLOCK, compare
    from sim2real.task.streams import read

    try:
        a, b = read(options.a), read(options.b)
        print(f"comparing {b.duration:.0f} s of {b.name} with {a.duration:.0f} s of {a.name}", file=sys.stderr)
        clock = compare(a, b, options.within or CLOCK.within)
    except ContractViolation as violation:
        return refuse(violation)
    found = document(clock)
    if options.out:
        from sim2real.report.clock_page import render  # drawing is slow to import

        keep(options.out, "clock", found, lambda: render(clock, found))
    print(sentence(clock))
    print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
