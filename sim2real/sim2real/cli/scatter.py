"""`scatter BAG`: how keypoints scatter while the object rests, and which images show the one before again.

Any recording with `keypoints` in which the object rests for 1.5 s in all: an episode's, or a camera's beside a still table. The last line
printed is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from np_common.cli import Parser
from sim2real.cli.answers import refuse


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="scatter", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bag", type=Path)
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Status 2: a recording that breaks its contract."""
    options = parse(arguments)
    # Slow to import, and not wanted by --help.
    from sim2real.recordings.reading import ContractViolation
    from sim2real.task.findings import document, sentences
    from sim2real.task.scatter import scatter
    from sim2real.task.track import read_track

    try:
        found = scatter(read_track(options.bag))
    except ContractViolation as violation:
        return refuse(violation)
    print("\n".join(sentences(found)))
    print(json.dumps(document(found)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
