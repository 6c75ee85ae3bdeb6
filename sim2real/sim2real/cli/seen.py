"""Options of commands that read where an object is seen."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_seen(parser: argparse.ArgumentParser) -> None:
    """The recordings, the camera that is believed in, and whether the true pose is looked at."""
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="in the order in which they were recorded")
    parser.add_argument(
        "--calibration", default="", help="file of the camera that is believed in; else it is as trained"
    )
    parser.add_argument("--without-pose", action="store_true", help="leave `object_pose` aside")
