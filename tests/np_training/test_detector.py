"""The detector as a library: heatmaps to pixels, scores, determinism, refusals."""

import json

import numpy as np
import pytest
import torch
from detector_weights import TINY, write_detector
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.image import imread

from np_description.camera import CAMERA
from np_description.domains import BUMP, CARD
from np_description.weights.released import WeightsError
from np_perception.detector import IMAGE_SHAPE, KeypointDetector
from np_training.detector.judging import write_figures
from np_training.detector.network import KeypointNetwork, decode, find_peak, heatmap_loss

torch.set_num_threads(1)
SIZE = 64
inside = st.floats(-0.49, SIZE - 0.51)


def gaussian_logits(u: float, v: float, sigma: float = 1.5) -> torch.Tensor:
    row, column = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    return (-((column - u) ** 2 + (row - v) ** 2) / (2 * sigma**2))[None, None]


@given(u=st.floats(6, SIZE - 7), v=st.floats(6, SIZE - 7))
def test_a_gaussian_is_decoded_to_its_centre(u, v):
    logits = gaussian_logits(u, v)
    pixel = decode(logits, find_peak(logits), window=5)[0, 0]
    assert pixel.tolist() == pytest.approx([u, v], abs=0.02)


@given(u=inside, v=inside)
def test_decoding_stays_inside_the_image_and_near_the_peak_at_its_border(u, v):
    logits = gaussian_logits(u, v)
    pixel = decode(logits, find_peak(logits), window=5)[0, 0]
    assert (pixel >= 0).all() and (pixel <= SIZE - 1).all()
    assert np.linalg.norm(pixel.numpy() - [u, v]) < 2.5  # the mean of a cut Gaussian lies inside of its centre


def test_a_second_mode_far_away_does_not_pull():
    logits = torch.logaddexp(gaussian_logits(20.3, 30.7), gaussian_logits(50, 10) - 0.2)
    assert decode(logits, find_peak(logits), 5)[0, 0].tolist() == pytest.approx([20.3, 30.7], abs=0.02)


@settings(max_examples=20)
@given(u=st.floats(8, SIZE - 9), v=st.floats(8, SIZE - 9), shift=st.floats(0.5, 5))
def test_the_loss_is_least_at_the_truth(u, v, shift):
    truth = torch.tensor([[[u, v]]])
    right = heatmap_loss(gaussian_logits(u, v), truth, 1.5)
    entropy = np.log(2 * np.pi * np.e * 1.5**2)  # of the target: the cross-entropy's floor
    assert right.item() == pytest.approx(entropy, abs=0.01)
    assert heatmap_loss(gaussian_logits(u + shift, v), truth, 1.5).item() > right.item()


def test_the_network_keeps_the_camera_resolution_and_one_score_a_corner():
    found = KeypointNetwork(TINY).eval()(torch.rand(2, 3, CAMERA.height, CAMERA.width))
    assert found.logits.shape == (2, 8, CAMERA.height, CAMERA.width)
    assert found.pixels.shape == (2, 8, 2) and found.score_logits.shape == (2, 8)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    folder = tmp_path_factory.mktemp("weights")
    write_detector(folder)
    return folder


@pytest.fixture(scope="module")
def image():
    return np.random.default_rng(1).integers(0, 256, IMAGE_SHAPE, dtype=np.uint8)


def test_detections_are_bounded_and_the_same_bits_every_time(weights, image):
    first = KeypointDetector(CARD, weights).detect(image)
    second = KeypointDetector(CARD, weights).detect(image.copy())
    assert first.keypoints.tobytes() == second.keypoints.tobytes()
    assert first.keypoints.shape == (8, 3)
    assert ((first.scores > 0) & (first.scores < 1)).all()
    assert ((first.pixels >= 0) & (first.pixels <= CAMERA.width - 1)).all()


def test_the_exported_network_answers_as_the_trained_one(weights, image):
    from np_training.detector.exporting import Deployed, load_weights

    network, record = load_weights(weights / "keypoint_detector_card.safetensors")
    with torch.no_grad():
        pixels, scores = Deployed(network).eval()(torch.from_numpy(image)[None])
    found = KeypointDetector(CARD, weights).detect(image)
    np.testing.assert_allclose(found.pixels, pixels[0], atol=0.02)
    np.testing.assert_allclose(found.scores, scores[0], atol=1e-3)
    assert record["domain"] == "card"


@pytest.mark.parametrize(
    "bad", [np.zeros((240, 320, 3), np.uint8), np.zeros(IMAGE_SHAPE, np.float32), np.zeros((224, 224), np.uint8)]
)
def test_other_images_are_refused(weights, bad):
    with pytest.raises(ValueError, match=r"expected \(224, 224, 3\) uint8, got"):
        KeypointDetector(CARD, weights).detect(bad)


def test_missing_foreign_stale_and_broken_networks_are_refused(tmp_path):
    with pytest.raises(WeightsError, match="keypoint_detector_card.onnx, which does not exist"):
        KeypointDetector(CARD, tmp_path)
    path = write_detector(tmp_path)
    path.rename(tmp_path / "keypoint_detector_bump.onnx")
    with pytest.raises(WeightsError, match="domain: expected bump, got card"):
        KeypointDetector(BUMP, tmp_path)
    path = write_detector(tmp_path)
    path.with_suffix(".safetensors").write_bytes(b"other weights")
    with pytest.raises(WeightsError, match="was not exported from keypoint_detector_card.safetensors"):
        KeypointDetector(CARD, tmp_path)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(WeightsError, match="cannot be read"):
        KeypointDetector(CARD, tmp_path)


def test_a_domain_replaces_only_its_own_figures_and_pictures(tmp_path):
    for name, value in (("wall", 1), ("card", 2), ("wall", 3)):
        write_figures({"domain": name, "seed": value}, np.full((4, 5, 4), value, np.uint8), tmp_path)
    assert json.loads((tmp_path / "detector.json").read_text()) == {
        "card": {"domain": "card", "seed": 2},
        "wall": {"domain": "wall", "seed": 3},
    }
    rows = np.round(255 * imread(tmp_path / "detector.png"))[:, 0, 0]
    assert list(rows) == [2] * 4 + [255] * 4 + [3] * 4
