"""The real camera's pose: one file, written by the command `calibrate`, read by all that project or
rectifies.

The file is YAML. It has the pose of the camera's own optical frame in the robot's base frame with its covariance,
the lens it was measured with, where the table was seen, and the date. Units m, rad, px; quaternions
wxyz.

A camera never stands exactly where `np_description.camera.CAMERA` does. The camera node turns its images,
which for a pinhole is exact, so that they look in the direction of CAMERA with its focal length; what remains
is the position. `Calibration.camera` is the camera whose images those are: the one to project with.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import yaml

from np_common.rotations import matrix_from_quaternion, vector_from_matrix
from np_description.camera import CAMERA, Camera, Pinhole
from np_description.panda import BASE_FRAME

FORMAT = 1
MAX_AGE = timedelta(days=30)
"""Older than this a calibration should be made again before the arm moves: mounts creep."""
_CLOCK_TOLERANCE = timedelta(minutes=5)  # between the computer that calibrated and the one that reads


class CalibrationError(ValueError):
    """A calibration that cannot be used; the message names the file, what was expected and what was found."""


@dataclass(frozen=True)
class Lens(Pinhole):
    """Intrinsics of a camera's images before rectification."""

    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1 k2 p1 p2 k3 (Brown-Conrady, ROS's plumb_bob)."""

    def __post_init__(self) -> None:
        numbers = np.array([self.fx, self.fy, self.cx, self.cy, *self.distortion], float)
        if (
            len(self.distortion) != 5
            or not np.isfinite(numbers).all()
            or min(self.width, self.height, self.fx, self.fy) <= 0
        ):
            raise CalibrationError(
                "lens: expected a positive size and focal length and 5 coefficients of distortion, "
                f"all finite, got {self}"
            )


@dataclass(frozen=True)
class CalibrationErrors:
    """Accuracy of a calibration; the 95 % bounds are of the length of the error."""

    position_95: float
    """Bound of the camera's position, m."""
    rotation_95: float
    """Bound of the camera's rotation, rad."""
    keypoint_95: float
    """Bound of a point on the table in the policy's image, px."""
    reprojection_rms: float
    """In the images of the calibration, px."""
    views: int
    """Number of images used."""
    corners: int
    """Number of board corners used."""


@dataclass(frozen=True)
class TablePlane:
    """The table, measured by a board lying on it."""

    height: float
    """Height of the plane at `at`, m."""
    tilt: tuple[float, float]
    """Tilt about x and y (2,) rad."""
    at: tuple[float, float]
    """Place x, y of the board, m."""
    height_95: float
    """95 % bound of the height, m."""
    tilt_95: float
    """95 % bound of the tilt, rad."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera in the base frame."""

    made: datetime
    """Time of the calibration, with time zone."""
    lens: Lens
    """Intrinsics of the images measured."""
    position: np.ndarray
    """Optical frame in the base frame (3,) m."""
    quaternion: np.ndarray
    """Optical frame in the base frame, wxyz (4,)."""
    covariance: np.ndarray
    """Of position m and rotation vector rad in base axes (6, 6); the true rotation is exp(error) times this one."""
    errors: CalibrationErrors
    """How well it was measured."""
    table: TablePlane | None = None
    """The table's plane, where it was measured."""
    source: str = ""
    """The recordings it was made from."""

    def __post_init__(self) -> None:
        for name, shape in (("position", (3,)), ("quaternion", (4,)), ("covariance", (6, 6))):
            array = np.asarray(getattr(self, name), float)
            if array.shape != shape or not np.isfinite(array).all():
                raise CalibrationError(f"{name}: expected finite numbers of shape {shape}, got {array.tolist()}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if abs(np.linalg.norm(self.quaternion) - 1) > 1e-6:
            raise CalibrationError(f"quaternion: expected norm 1, got {self.quaternion.tolist()}")
        scale = np.sqrt(np.abs(np.diag(self.covariance))).max() ** 2
        if (
            not np.allclose(self.covariance, self.covariance.T, rtol=0, atol=1e-9 * scale)
            or np.linalg.eigvalsh(self.covariance)[0] < -1e-9 * scale
        ):
            raise CalibrationError(f"covariance: expected symmetric, not negative, got {self.covariance.tolist()}")
        numbers = [*asdict(self.errors).values(), *(_flat(asdict(self.table)) if self.table else [])]
        if not np.isfinite(numbers).all():
            raise CalibrationError(f"errors, table: expected finite numbers, got {self.errors}, {self.table}")
        if self.made.tzinfo is None:
            raise CalibrationError(f"made: expected a date with its time zone, got {self.made}")

    @property
    def rotation(self) -> np.ndarray:
        """Rotation (3, 3), the camera's own optical frame to the base frame."""
        return matrix_from_quaternion(self.quaternion)

    @property
    def camera(self) -> Camera:
        """The camera to project with: CAMERA, at the place where the real one is."""
        return replace(CAMERA, position=tuple(self.position.tolist()))

    @property
    def turn(self) -> np.ndarray:
        """Rotation (3, 3), the camera's own optical frame to that of the images it is rectified to."""
        return np.asarray(CAMERA.rotation).T @ self.rotation

    @property
    def displacement(self) -> tuple[float, float]:
        """Distance m and angle rad to CAMERA, with which the policies were trained."""
        return (
            float(np.linalg.norm(self.position - CAMERA.position)),
            float(np.linalg.norm(vector_from_matrix(self.turn))),
        )

    def age(self, now: datetime | None = None) -> timedelta:
        """Age of the calibration. Raises CalibrationError for one from the future: a clock is wrong then."""
        age = (now or datetime.now(UTC)) - self.made
        if age < -_CLOCK_TOLERANCE:
            raise CalibrationError(
                f"calibration: expected a date that has been, got {self.made.isoformat()}: "
                "is the computer's clock right?"
            )
        return max(age, timedelta(0))

    def require_fresh(self, max_age: timedelta = MAX_AGE, now: datetime | None = None) -> None:
        """Raises CalibrationError if it is older than `max_age`."""
        if (age := self.age(now)) > max_age:
            raise CalibrationError(
                f"calibration: expected one of the last {_days(max_age)} days, it is "
                f"{_days(age)} days old ({self.made.date()}); make it again: docs/guide/hardware.md"
            )

    def save(self, path: str | Path) -> None:
        """Write the file, whole or not at all."""
        content = {
            "format": FORMAT,
            "made": self.made.astimezone(UTC).isoformat(timespec="seconds"),
            "frame": BASE_FRAME,
            "source": self.source,
            "position": self.position.tolist(),
            "quaternion": self.quaternion.tolist(),
            "lens": _plain(asdict(self.lens)),
            "errors": _plain(asdict(self.errors)),
            "table": _plain(asdict(self.table)) if self.table else None,
            "covariance": self.covariance.tolist(),
        }
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(path.name + ".part")
        partial.write_text(
            "# Camera calibration, written by `calibrate` (docs/guide/hardware.md).\n"
            + yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
        )
        partial.replace(path)


def load(path: str | Path) -> Calibration:
    """The calibration in a file. Raises CalibrationError if it is missing, cut off, of another format, or not
    finite."""
    try:
        content = yaml.safe_load(Path(path).read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        problem = " ".join(str(error).split())  # YAML's errors are of several lines
        raise CalibrationError(f"calibration {path}: expected a file written by `calibrate`: {problem}") from error
    keys = {
        "format",
        "made",
        "frame",
        "source",
        "position",
        "quaternion",
        "lens",
        "errors",
        "table",
        "covariance",
    }
    if not isinstance(content, dict) or set(content) != keys:
        found = sorted(map(str, content)) if isinstance(content, dict) else type(content).__name__
        raise CalibrationError(f"calibration {path}: expected the keys {sorted(keys)}, got {found}")
    if content["format"] != FORMAT or content["frame"] != BASE_FRAME:
        raise CalibrationError(
            f"calibration {path}: expected format {FORMAT} in frame {BASE_FRAME}, "
            f"got format {content['format']} in frame {content['frame']}"
        )
    try:
        lens, table = dict(content["lens"]), content["table"]
        lens["distortion"] = tuple(lens["distortion"])
        return Calibration(
            made=_date(content["made"]),
            lens=Lens(**lens),
            position=content["position"],
            quaternion=content["quaternion"],
            covariance=content["covariance"],
            errors=CalibrationErrors(**content["errors"]),
            table=(TablePlane(**{**table, "tilt": tuple(table["tilt"]), "at": tuple(table["at"])}) if table else None),
            source=str(content["source"]),
        )
    except (TypeError, KeyError, ValueError) as error:  # a CalibrationError is one
        raise CalibrationError(f"calibration {path}: {error}") from error


def load_calibrated_camera(path: str) -> Camera:
    """The camera to project with, for a parameter `calibration`: that of the file, or CAMERA for "".

    Raises CalibrationError.
    """
    return load_calibrated_view(path)[0]


def load_calibrated_view(path: str) -> tuple[Camera, np.ndarray | None]:
    """`load_calibrated_camera`, and the covariance (6, 6) of its pose, m and rad in base axes; None for "".

    Raises CalibrationError.
    """
    if not path:
        return CAMERA, None
    found = load(path)
    return found.camera, found.covariance


def norm_bound(covariance: np.ndarray, dof: float = np.inf) -> float:
    """Bound on the length of an error (n,) with covariance (n, n), at probability 0.95.

    Student's t with `dof` degrees of freedom, normal where infinite; by 40,000 draws that are always the
    same.
    """
    covariance = np.atleast_2d(np.asarray(covariance, float))
    values = np.linalg.eigvalsh(covariance)  # the length does not change with the axes
    rng = np.random.default_rng(0)
    draws = rng.standard_normal((40_000, len(covariance))) * np.sqrt(np.maximum(values, 0))
    if np.isfinite(dof):
        draws = draws / np.sqrt(rng.chisquare(dof, len(draws)) / dof)[:, None]
    return float(np.quantile(np.linalg.norm(draws, axis=1), 0.95))


def _date(value) -> datetime:
    return value if isinstance(value, datetime) else datetime.fromisoformat(str(value))


def _days(span: timedelta) -> str:
    return f"{span.total_seconds() / 86400:.0f}"


def _flat(content: dict) -> list[float]:
    return [number for value in content.values() for number in np.ravel(value)]


def _plain(content: dict) -> dict:
    """Numbers and lists of YAML's own types."""
    return {key: list(value) if isinstance(value, tuple) else value for key, value in content.items()}
