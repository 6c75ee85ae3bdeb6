"""`report BAG... --out report.html`: the report of recorded episodes."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from np_common.cli import Parser


def main(arguments: list[str] | None = None) -> int:
    """Write the report; the last line printed is one JSON object."""
    parser = Parser(prog="report", description="HTML report of recorded episodes.")
    parser.add_argument("bags", nargs="+", type=Path, help="bags, one episode each")
    parser.add_argument("--out", type=Path, default=Path("report.html"), help="file to write (report.html)")
    options = parser.parse_args(arguments)
    # Slow to import, and not needed by --help.
    from np_record.bag import BagError
    from np_record.report.episodes import make_section, write_report

    try:
        sections = [make_section(bag) for bag in options.bags]
    except BagError as error:
        print(error, file=sys.stderr)
        return 1
    try:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        write_report(options.out, sections)
    except OSError as error:
        print(f"report: {options.out}: expected a file that can be written, got: {error.strerror}", file=sys.stderr)
        return 1
    print(
        json.dumps(
            {
                "report": str(options.out),
                "episodes": len(sections),
                "successes": sum(s.episode.outcome.success for s in sections),
            }
        )
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
