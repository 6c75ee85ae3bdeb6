"""`export_lerobot BAG... --out DIR`: recorded episodes as a LeRobot data set, format v3.0."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from np_common.cli import INTERRUPTED, Parser, Progress, interrupt_on_sigterm


def main(arguments: list[str] | None = None) -> int:
    """Write the data set; the last line printed is one JSON object."""
    parser = Parser(prog="export_lerobot", description=__doc__)
    parser.add_argument("bags", nargs="+", type=Path, help="bags; of each its first episode")
    parser.add_argument("--out", type=Path, required=True, help="folder to make")
    options = parser.parse_args(arguments)
    # Slow to import, and not needed by --help.
    from np_record.bag import BagError
    from np_record.lerobot.layout import SUCCESS, DataSetError
    from np_record.lerobot.reading import read_data_set
    from np_record.lerobot.writing import write_data_set

    interrupt_on_sigterm()
    try:
        information = write_data_set(options.out, options.bags, Progress(len(options.bags), "export").show)
        successes = int(read_data_set(options.out).columns[SUCCESS].sum())
    except KeyboardInterrupt:
        return INTERRUPTED
    except (BagError, DataSetError, OSError) as error:
        print(f"export_lerobot: {error}", file=sys.stderr)
        return 1
    print(
        json.dumps(
            {
                "data_set": str(options.out),
                "episodes": information["total_episodes"],
                "frames": information["total_frames"],
                "successes": successes,
            }
        )
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
