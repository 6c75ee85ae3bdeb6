"""`view BAG... [--out DIR]`: is the camera, the table or the object not what it is believed to be?

Recordings with `keypoints` in which the object rests at three places or more, all together: episodes have one or two each. Where they
have `object_pose` it counts as measured without the camera; else all that is known is that the object lies flat on the table. The last
line printed is one JSON object; DIR gets view.json and view.html.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from np_common.cli import Parser
from sim2real.cli.answers import keep, refuse
from sim2real.cli.seen import add_seen


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="view", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_seen(parser)
    parser.add_argument("--out", type=Path, help="folder for view.json and view.html")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Status 2: a recording or a calibration that breaks its contract."""
    options = parse(arguments)
    # Slow to import, and not wanted by --help.
    from sim2real import single_thread  # noqa: F401, I001  before NumPy
    from np_description.calibration import CalibrationError, calibrated_camera
    from sim2real.recordings.reading import ContractViolation
    from sim2real.report.view_words import document
    from sim2real.task.camera.places import read_places
    from sim2real.task.camera.view import view

    try:
        camera = calibrated_camera(options.calibration)
        places = []
        for bag in options.bags:
            places += read_places(bag, options.calibration, not options.without_pose)
            print(f"{bag}: {len(places)} places so far", file=sys.stderr)
        found = view(places, camera)
    except (CalibrationError, ContractViolation) as violation:
        return refuse(violation)
    told = document(found)
    if options.out:
        from sim2real.report.view_page import render  # drawing is slow to import

        keep(options.out, "view", told, lambda: render(found, told))
    print("\n".join(told["sentences"]))
    print(json.dumps(told))
    return 0


if __name__ == "__main__":
    sys.exit(main())
