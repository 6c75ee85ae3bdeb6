"""Opening a policy's ONNX file with ONNX Runtime on one thread: equal inputs give equal bits."""

from __future__ import annotations

from pathlib import Path

import onnxruntime

from np_description.weights.released import WeightsError


def open_session(path: str | Path) -> onnxruntime.InferenceSession:
    """The file, ready to run. Raises WeightsError if it is missing or no ONNX file."""
    path = Path(path)
    if not path.is_file():
        raise WeightsError(f"policy: expected the file {path}, which does not exist; export_policy writes it")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime raises a class of its own for each kind of broken file
        raise WeightsError(f"policy: {path} cannot be read: {error}") from error
