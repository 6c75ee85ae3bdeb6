"""The contract of weights: the setting that they were trained for, kept in their file and checked before use.

A contract is a frozen dataclass of plain values that are read off the definitions in code. Its text in a file holds
those definitions as they were when the weights were trained; `check` compares it with what they are now.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

from np_description.camera import CAMERA
from np_description.keypoints import CORNERS
from np_description.weights.header import read_metadata
from np_description.weights.released import WeightsError

KEY = "contract"  # of the metadata
_NOTHING = object()


def warn_on_mismatch(why: str, **options):
    """A field whose mismatch is no refusal, but a warning that begins with `why`."""
    return field(metadata={"warning": why}, **options)


def record_only(**options):
    """A field that is kept for the record and compared with nothing."""
    return field(metadata={"note": True}, **options)


@dataclass(frozen=True)
class Contract:
    """Base of the contracts. A field that differs is a refusal unless it is `warn_on_mismatch` or `record_only`."""

    def text(self) -> str:
        """The contract as JSON, the same for equal contracts."""
        return json.dumps(_plain(asdict(self)), sort_keys=True)

    def check(self, path: str | Path) -> list[str]:
        """Hold the contract in a safetensors file against this one, which has the expected values; warnings, if any.

        Raises WeightsError, naming every field that does not fit, with what was expected and what the file has; or where
        the file is missing or has no contract.
        """
        return self.compare(read_metadata(path).get(KEY), path)

    def compare(self, text: str | None, path: str | Path) -> list[str]:
        """As `check`, for the text of a contract that was found in the file `path`, None where it has none."""
        path = Path(path)
        if text is None:
            raise WeightsError(
                f"weights: {path}: expected a contract in its metadata, got none; if it was trained with what the code "
                f"defines today, `python -m np_training.contracts {path.with_suffix('.safetensors')}` adds one"
            )
        try:
            found = dict(json.loads(text))
        except (TypeError, ValueError) as error:
            raise WeightsError(f"weights: {path}: expected a contract in JSON, got {text!r}") from error
        expected, refusals, warnings = json.loads(self.text()), [], []
        for each in fields(self):
            if "note" in each.metadata:
                continue
            differences = _differences(each.name, expected[each.name], found.get(each.name, _NOTHING))
            if differences and "warning" in each.metadata:
                warnings.append(f"{path.name}: {each.metadata['warning']}: {'; '.join(differences)}")
            else:
                refusals += differences
        if refusals:
            raise WeightsError(f"weights: {path} were trained for something else: {'; '.join(refusals)}")
        return warnings


def keypoint_order() -> tuple[str, ...]:
    """The order of the corners as text: "-x -y -z", "-x -y +z", ..."""
    return tuple(" ".join(f"{'+' if sign > 0 else '-'}{axis}" for sign, axis in zip(row, "xyz")) for row in CORNERS)


def camera_intrinsics() -> dict[str, float]:
    """Size and intrinsics, px, of the camera that the networks see by."""
    return {name: getattr(CAMERA, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}


def _plain(value):
    """Numbers to nine digits, so that another machine's last bit is no other contract; tuples as lists."""
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value


def _differences(name: str, expected, found) -> list[str]:
    """The differences, each as "name: expected ..., got ..."; entries of a table by their own names."""
    if isinstance(expected, dict) and isinstance(found, dict):
        return [
            line
            for key in sorted({*expected, *found})
            for line in _differences(f"{name}.{key}", expected.get(key, _NOTHING), found.get(key, _NOTHING))
        ]
    if expected == found:
        return []
    values = ("nothing" if value is _NOTHING else value for value in (expected, found))
    return [f"{name}: expected {next(values)}, got {next(values)}"]
