"""The numbers of the view as one vector: what is usual of each, what a gap is, and which effect it belongs to."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees

import numpy as np

from sim2real.thresholds import THRESHOLDS

SPREADS = THRESHOLDS.camera_spreads


@dataclass(frozen=True)
class CameraParameter:
    """One number of the camera model."""

    name: str
    """Name in JSON."""
    text: str
    """Name in sentences."""
    unit: str
    """SI, px or 1."""
    usual: float
    """Standard deviation of a set-up without a gap."""
    gap: float
    """Standard deviation of a gap."""
    shown: str
    """Unit in sentences."""
    scale: float
    """Factor from `unit` to `shown`."""
    largest: float
    """Largest gap that is physical."""

    def is_informative(self, low: float, high: float) -> bool:
        """Whether an interval constrains the number: its sign, or that it is much nearer to nothing than a gap may be."""
        return low > 0 or high < 0 or high - low <= 2 * 1.96 * THRESHOLDS.camera_comparison.narrowed * self.gap


def _axes(name: str, text: str, axes: str, unit: str, field: str, shown: str, scale: float, largest: float):
    spread = getattr(SPREADS, field)
    return tuple(CameraParameter(f"{name}_{a}", f"{text} {a}", unit, *spread, shown, scale, largest) for a in axes)


PARAMETERS: tuple[CameraParameter, ...] = (
    *_axes("camera", "camera along", "xyz", "m", "shift", "mm", 1e3, 0.1),
    *_axes("camera_turn", "camera about", "xyz", "rad", "turn", "deg", degrees(1.0), 0.2),
    CameraParameter("focal", "focal length", "1", *SPREADS.focal, "%", 1e2, 0.1),
    *_axes("offset", "picture along", "uv", "px", "offset", "px", 1.0, 20.0),
    CameraParameter("k1", "distortion k1", "1", *SPREADS.k1, "", 1.0, 1.0),
    CameraParameter("table_height", "table", "m", *SPREADS.height, "mm", 1e3, 0.05),
    *_axes("table_tilt", "table about", "xy", "rad", "tilt", "deg", degrees(1.0), 0.1),
    *_axes("size", "object's edge along", "xyz", "m", "size", "mm", 1e3, 0.02),
)
BY_NAME = {p.name: p for p in PARAMETERS}
NAMES = tuple(BY_NAME)
COUNT = len(PARAMETERS)
USUAL = np.array([p.usual for p in PARAMETERS])
GAP = np.array([p.gap for p in PARAMETERS])


def parameter_indices(prefix: str) -> np.ndarray:
    """Places in the vector of the numbers that are called so, or so with an axis behind. Raises KeyError where there is none."""
    found = [n for n, name in enumerate(NAMES) if name == prefix or name[:-2] == prefix]
    if not found:
        raise KeyError(prefix)
    return np.array(found)


@dataclass(frozen=True)
class CameraEffect:
    """One explanation of where corners are seen."""

    ids: tuple[str, ...]
    """Effects of the catalogue; several look alike in every picture and are reported together."""
    fields: tuple[str, ...]
    """Numbers that it changes."""
    called: str
    """What is off, in words."""
    text: str
    """Sentence template with its numbers in braces (`sim2real.effects.sentences`)."""
    quantities: tuple[str, ...] = ()
    """Names of the numbers in `patch.yaml`; empty where a patch cannot carry it."""

    @property
    def numbers(self) -> np.ndarray:
        """Places in the vector."""
        return np.concatenate([parameter_indices(field) for field in self.fields])


EFFECTS: dict[str, CameraEffect] = {
    "camera_place": CameraEffect(
        ("camera_extrinsics",),
        ("camera",),
        "where the camera stands",
        "the camera is {camera_x:mm}, {camera_y:mm}, {camera_z:mm} from its nominal position (x, y, z)",
        ("x", "y", "z"),
    ),
    "camera_turn": CameraEffect(
        ("camera_extrinsics",),
        ("camera_turn",),
        "where the camera looks",
        "the camera is turned by {camera_turn_x:deg}, {camera_turn_y:deg}, {camera_turn_z:deg} (about x, y, z)",
        ("turn_x", "turn_y", "turn_z"),
    ),
    "focal_length": CameraEffect(
        ("camera_intrinsics",),
        ("focal",),
        "the camera's focal length",
        "the camera's focal length is {focal:% more/less}",
        ("focal",),
    ),
    "image_offset": CameraEffect(
        ("camera_intrinsics", "keypoint_bias"),
        ("offset",),
        "the image's centre, or where corners are found",
        "the image's centre, or where corners are found, is off by {offset_u:px right/left} and {offset_v:px down/up}",
    ),
    "distortion": CameraEffect(("lens_distortion",), ("k1",), "the lens", "the lens distorts, k1 {k1}", ("k1",)),
    "table_height": CameraEffect(
        ("table_height",), ("table_height",), "the table's height", "the table is {table_height:mm higher/lower}"
    ),
    "table_tilt": CameraEffect(
        ("table_tilt",),
        ("table_tilt",),
        "the table's tilt",
        "the table is tilted by {table_tilt_x:deg}, {table_tilt_y:deg} (about x, y)",
    ),
    "object_size": CameraEffect(
        ("object_size",),
        ("size",),
        "the object's size",
        "the object's edges are {size_x:mm}, {size_y:mm}, {size_z:mm} longer (x, y, z)",
    ),
}
"""By name. The centre of the image and the bias of a detector are the same two numbers: no recording of corners splits them."""

TOUCH = "touch the table at four points and the top of the object: the hand feels them, the camera does not"
CALIPER = "measure the object with a caliper"
HEIGHTS = "the object at two heights: on the table and on a box"
BORDER = "the object at the border of the picture as well as in the middle"
BOARD = "a calibration with a board: it depends on the camera, and not on what finds corners"
SPLIT_BY: tuple[tuple[frozenset[str], str], ...] = tuple(
    (frozenset({one, other}), text)
    for text, pairs in {
        TOUCH: (
            ("camera_place", "table_height"),
            ("camera_place", "table_tilt"),
            ("camera_turn", "table_height"),
            ("camera_turn", "table_tilt"),
            ("object_size", "table_height"),
        ),
        CALIPER: (
            ("object_size", "table_height"),
            ("object_size", "camera_place"),
            ("object_size", "focal_length"),
            ("object_size", "distortion"),
        ),
        HEIGHTS: (
            ("focal_length", "camera_place"),
            ("focal_length", "table_height"),
            ("camera_place", "camera_turn"),
        ),
        BORDER: (("distortion", name) for name in ("focal_length", "camera_place", "camera_turn", "image_offset")),
        BOARD: (("image_offset", name) for name in ("camera_place", "camera_turn", "table_height", "table_tilt")),
    }.items()
    for one, other in pairs
)
"""What distinguishes two explanations of the same data."""
SHOWN_BY = {
    "camera_place": "poses of the object that something else than the camera has measured, or a calibration with a board",
    "camera_turn": "poses of the object that something else than the camera has measured, or a calibration with a board",
    "focal_length": HEIGHTS,
    "image_offset": BOARD,
    "distortion": BORDER,
    "table_height": TOUCH,
    "table_tilt": TOUCH,
    "object_size": CALIPER,
}
"""What shows an effect that a recording does not."""
OF_ITSELF = {"image_offset": "corners marked by hand in one picture: a detector's bias goes, the image's centre stays"}
"""What distinguishes the ids of one explanation."""


def distinguishing_experiments(names: frozenset[str]) -> tuple[str, ...]:
    """Experiments that distinguish these explanations, each once."""
    experiments = [text for pair, text in SPLIT_BY if pair <= names]
    experiments += [OF_ITSELF[name] for name in sorted(names & OF_ITSELF.keys())]
    return tuple(dict.fromkeys(experiments))
