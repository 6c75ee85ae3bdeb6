"""The keypoint detector: one camera image to the eight corners of the object's box, with scores.

Runs the exported network (ONNX, written by np_training.detector.export) with ONNX Runtime on one thread: the
same image gives the same bits. The network is defined and trained in np_training.detector.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime

from np_description.camera import CAMERA
from np_description.domains import Task
from np_description.keypoints import COUNT
from np_description.weights.contract import KEY
from np_description.weights.released import WeightsError, sha256, weights_folder
from np_perception.contract import DetectorContract

IMAGE_SHAPE = (CAMERA.height, CAMERA.width, 3)


@dataclass(frozen=True)
class KeypointDetection:
    """Keypoints found in one image, hidden ones included."""

    pixels: np.ndarray
    """u, v px of the corners in keypoint order (8, 2) float32."""
    scores: np.ndarray
    """Probability that a pixel is within 3 px of the true corner (8,) float32."""

    @property
    def keypoints(self) -> np.ndarray:
        """(8, 3): u px, v px, score, as np_ros.messages sends them."""
        return np.concatenate([self.pixels, self.scores[:, None]], axis=1)


def network_name(domain: Task) -> str:
    """File name, without ending, of a domain's detector in the weights folder."""
    return f"keypoint_detector_{domain.name}"


class KeypointDetector:
    """The detector of one domain, loaded from a folder of released weights.

    Raises WeightsError if the network is missing, cannot be read, was trained for something else (DetectorContract), or was
    exported from other weights than those beside it.
    """

    def __init__(self, domain: Task, folder: str | Path = "", threads: int = 1) -> None:
        path = weights_folder(folder) / f"{network_name(domain)}.onnx"
        if not path.is_file():
            raise WeightsError(
                f"keypoint detector: expected the network {path}, which does not exist; "
                "np_training.detector.export writes it"
            )
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.use_deterministic_compute = True
        try:
            self._session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # ONNX Runtime raises a class of its own for each kind of broken file
            raise WeightsError(f"keypoint detector: {path} cannot be read: {error}") from error
        self.information = dict(self._session.get_modelmeta().custom_metadata_map)
        _check(path, self.information, domain)
        self.detect(np.zeros(IMAGE_SHAPE, np.uint8))  # the first run allocates; a node's first image should not wait

    def detect(self, image: np.ndarray) -> KeypointDetection:
        """Corners in an RGB image (224, 224, 3) uint8. Raises ValueError for any other shape or type."""
        if image.shape != IMAGE_SHAPE or image.dtype != np.uint8:
            raise ValueError(f"image: expected {IMAGE_SHAPE} uint8, got {image.shape} {image.dtype}")
        pixels, scores = self._session.run(("pixels", "scores"), {"image": image[None]})
        return KeypointDetection(pixels[0].reshape(COUNT, 2), scores[0].reshape(COUNT))


def _check(path: Path, information: dict[str, str], domain: Task) -> None:
    DetectorContract.of(domain).compare(information.get(KEY), path)
    source = path.with_suffix(".safetensors")
    if source.is_file() and sha256(source) != information.get("weights_sha256"):
        raise WeightsError(
            f"keypoint detector: {path} was not exported from {source.name} beside it "
            "(other sha256); np_training.detector.export writes it anew"
        )
