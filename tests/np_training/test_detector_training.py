"""Detector training at its smallest: labels against the pictures, and a run that is interrupted and
continued.

All tests draw with one renderer of four worlds, so that its kernels are compiled once (and kept in Warp's
cache).
"""

import csv
import json

import numpy as np
import pytest
import torch

from np_common.rotations import matrix_from_quaternion
from np_description.camera import CAMERA
from np_description.domains import CARD
from np_description.keypoints import box_keypoints
from np_description.panda import NOMINAL
from np_description.scene import load_model
from np_training.detector.augment import Augmentation, augment, reduce
from np_training.detector.contrast import ContrastConfig, MomentumContrast
from np_training.detector.held_out import cast_rays
from np_training.detector.metrics import summarise
from np_training.detector.network import KeypointNetwork, NetworkConfig
from np_training.detector.render import (
    NOMINAL_LOOK,
    OVERSAMPLING,
    Frames,
    Looks,
    SceneRenderer,
    corner_visibility,
)
from np_training.detector.scenes import STATE_SIZE, sample_states, tumble_objects
from np_training.detector.train import main
from np_training.detector.visited import load_visited, mix_visited

torch.set_num_threads(1)
WORLDS = 4


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.fixture(scope="module")
def renderer():
    return SceneRenderer(CARD, WORLDS, "cpu")


def free_states() -> torch.Tensor:
    """The arm out of sight, the card in plain view, tilted, lifted."""
    states = torch.zeros(WORLDS, STATE_SIZE)
    states[:, :7] = torch.tensor(NOMINAL.ready)
    states[:, 0] = 1.5
    states[:, 9:12] = torch.tensor([[0.45, 0.1, 0.06], [0.55, -0.1, 0.08], [0.5, 0.0, 0.1], [0.6, 0.05, 0.07]])
    states[:, 12:] = torch.nn.functional.normalize(torch.randn(WORLDS, 4, generator=generator()), dim=1)
    return states


def test_states_are_finite_within_limits_and_of_many_kinds():
    states = sample_states(CARD, 512, generator())
    assert states.shape == (512, STATE_SIZE) and states.isfinite().all()
    q, quaternion = states[:, :7].numpy(), states[:, 12:]
    touching = q[(q >= NOMINAL.position_lower).all(1) & (q <= NOMINAL.position_upper).all(1)]
    assert len(touching) > 450  # noise may carry waiting arms out of their limits
    torch.testing.assert_close(quaternion.norm(dim=1), torch.ones(512))
    assert (states[:, 11] < 0).any() and (states[:, 11] > CARD.half_size[2] + 1e-3).any()
    assert np.linalg.norm(q - NOMINAL.ready, axis=1).max() > 0.5


def test_an_object_is_laid_on_any_face_as_low_as_it_was():
    states = sample_states(CARD, 256, generator())
    laid = tumble_objects(CARD, states, 0.9, generator(1))
    lowest = [box_keypoints(CARD.half_size, s[:, 9:12], s[:, 12:])[..., 2].min(1).values for s in (states, laid)]
    torch.testing.assert_close(*lowest, atol=1e-4, rtol=0)
    up = matrix_from_quaternion(laid[:, 12:])[:, 2]
    moved = (laid[:, 12:] != states[:, 12:]).any(1)
    assert 0.8 < moved.float().mean() < 1
    faces = {(int(row.abs().argmax()), bool(row.sum() > 0)) for row in up[moved]}
    assert len(faces) == 6 and (up[moved].abs().max(1).values > 0.999).all()


@pytest.mark.parametrize("edges", [None, (0.8, 1.2)])
def test_labels_lie_on_the_corners_of_what_is_drawn_whatever_the_camera_and_the_size(renderer, edges):
    states = free_states()
    renderer = SceneRenderer(CARD, WORLDS, "cpu", edges=edges) if edges else renderer
    frames = renderer.render(states, generator(3))
    moved = renderer.fields["cam_pos"][:, 0] - torch.tensor(CAMERA.position)
    assert moved.abs().max() > 1e-3
    segments = ~frames.surroundings.numpy()
    for mask, pixels in zip(segments, frames.pixels.numpy()):
        mask[: 40 * OVERSAMPLING] = False  # the arm's base
        rows, columns = np.nonzero(mask)
        drawn = np.array([columns.min(), rows.min(), columns.max(), rows.max()])
        drawn = (drawn + [0, 0, 1, 1]) / OVERSAMPLING - 0.5  # outer edges, in pixels of the camera
        labels = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
        np.testing.assert_allclose(drawn, labels, atol=0.75)


def test_the_nominal_camera_projects_as_everywhere_else():
    renderer_look = Looks(load_model(CARD), NOMINAL_LOOK, "cpu").sample(WORLDS, generator())
    from np_training.detector.render import project_corners

    states = free_states()
    pixels = project_corners(CARD.half_size, states, renderer_look["cam_pos"][:, 0], renderer_look["cam_quat"][:, 0])
    expected, _ = CAMERA.project(box_keypoints(CARD.half_size, states[:, 9:12], states[:, 12:]))
    torch.testing.assert_close(pixels, expected, atol=2e-3, rtol=0)


def test_visibility_from_the_rendering_agrees_with_rays_cast_by_mujoco(renderer):
    states = sample_states(CARD, WORLDS, generator(5))
    frames = renderer.render(states, generator(6))
    model = load_model(CARD)
    agree = []
    for i, state in enumerate(states):
        model.cam_pos[:], model.cam_quat[:] = renderer.fields["cam_pos"][i], renderer.fields["cam_quat"][i]
        geoms = cast_rays(model, state.double().numpy(), frames.pixels[i].numpy())
        agree.append(corner_visibility(geoms, frames.pixels[i : i + 1], renderer.blocks)[0] == frames.visible[i])
    # Half-hidden corners may go either way at half the resolution.
    assert torch.stack(agree).float().mean() >= 0.9
    assert frames.visible.any() and not frames.visible.all()


@pytest.mark.parametrize("aliased", [0.0, 1.0])
def test_labels_follow_the_pixels_when_an_image_is_reduced(aliased):
    size = CAMERA.width * OVERSAMPLING
    centre = torch.tensor([[60.3, 101.8], [150.0, 20.25]])
    offset = (torch.arange(size) + 0.5) / OVERSAMPLING - 0.5
    blob = torch.exp(
        -0.5
        * (
            (offset[None, None, :] - centre[:, 0, None, None]) ** 2
            + (offset[None, :, None] - centre[:, 1, None, None]) ** 2
        )
        / 4.0
    )
    frames = Frames(
        blob[..., None].expand(-1, -1, -1, 3).contiguous(),
        torch.zeros(2, size, size, dtype=torch.bool),
        centre[:, None].expand(2, 8, 2),
        torch.ones(2, 8, dtype=torch.bool),
        torch.ones(2),
    )
    images, _, shift = reduce(frames, generator(1), Augmentation(aliased=aliased))
    weights = images[:, 0] / images[:, 0].sum((1, 2), keepdim=True)
    grid = torch.arange(CAMERA.width, dtype=torch.float32)
    found = torch.stack([(weights.sum(1) * grid).sum(1), (weights.sum(2) * grid).sum(1)], dim=-1)
    torch.testing.assert_close(found, centre - shift, atol=0.02, rtol=0)
    assert bool((shift != 0).any()) == (aliased == 1.0)


def test_augmented_images_are_bounded_bytes_that_differ_in_the_background(renderer):
    frames = renderer.render(free_states(), generator(3))
    images, pixels = augment(frames, generator(4), Augmentation(coloured=0.5, textured=0.5))
    assert images.shape == (WORLDS, 3, CAMERA.height, CAMERA.width) and pixels.shape == (WORLDS, 8, 2)
    assert images.min() >= 0 and images.max() <= 1
    torch.testing.assert_close((images * 255).round() / 255, images)
    corners = images[:, :, -1, -1]
    assert torch.pdist(corners).min() > 0.02


def test_figures_of_perfect_and_useless_detections():
    truth = np.random.default_rng(0).uniform(0, 224, (50, 8, 2))
    visible = np.arange(400).reshape(50, 8) % 3 > 0
    present = np.ones((50, 8), bool)
    perfect = summarise(truth, np.ones((50, 8)), truth, visible, present)
    assert perfect["visible"]["median"] == 0 and perfect["hidden"]["within"] == 1 and perfect["calibration_error"] == 0
    wrong = summarise(truth + [3.0, 4.0], np.ones((50, 8)), truth, visible, present)
    assert wrong["visible"]["median"] == 5 and wrong["visible"]["within"] == 0 and wrong["calibration_error"] == 1
    assert perfect["found"] == [1.0, int(visible.sum())] and perfect["doubted"]["not_found"] is None
    assert wrong["doubted"] == {"not_seen": [0.0, int((~visible).sum())], "not_found": [0.0, 400]}
    knowing = summarise(truth + [3.0, 4.0], np.where(visible, 0.9, 0.1), truth, visible, present)
    assert knowing["doubted"]["not_seen"][0] == 1 and knowing["found"][0] == 1
    assert knowing["doubted"]["not_found"][0] == pytest.approx((~visible).mean(), abs=1e-4)


def recorded(path, domain: str = "card"):
    """Two episodes of four states, one of them over after two, and one that was never played."""
    qpos = torch.cat([free_states()[:3, None].expand(3, 4, STATE_SIZE)]).transpose(0, 1).clone().numpy()
    qpos[:, :, 9] += 0.001 * np.arange(4)[:, None]
    np.savez(
        path,
        domain=domain,
        mode=np.array(["success", "timeout", "infeasible"]),
        length=np.array([1, 3, 0]),
        goals=np.zeros((3, 7)),
        qpos=qpos,
        tips=np.zeros(3, int),
    )
    return qpos


def test_visited_states_are_those_of_played_episodes_until_their_end(tmp_path):
    qpos = recorded(tmp_path / "episodes.npz")
    states = load_visited(tmp_path / "episodes.npz", CARD, "cpu")
    expected = np.concatenate([qpos[:2, 0], qpos[:, 1]])
    assert sorted(map(tuple, states.numpy())) == sorted(map(tuple, expected.astype(np.float32)))
    mixed = mix_visited(torch.zeros(4000, STATE_SIZE), states, 0.6, generator())
    taken = mixed[:, 12:].any(1)
    assert taken.float().mean() == pytest.approx(0.6, abs=0.03)
    nearest = torch.cdist(mixed[taken][:, 9:12], states[:, 9:12]).amin(1)
    assert 0 < nearest.median() < 0.004
    with pytest.raises(ValueError, match="expected episodes of card, got wall"):
        recorded(tmp_path / "other.npz", "wall")
        load_visited(tmp_path / "other.npz", CARD, "cpu")


def test_momentum_contrast_learns_to_tell_images_apart_and_its_keys_follow():
    torch.manual_seed(0)
    network = KeypointNetwork(NetworkConfig(widths=(4, 8, 8), blocks=(1, 1)))
    contrast = MomentumContrast(network, ContrastConfig(size=16, queue=64, momentum=0.9))
    optimiser = torch.optim.Adam([*network.parameters(), *contrast.query.head.parameters()], lr=3e-3)
    losses = []
    for _ in range(80):
        colours = torch.rand(16, 3, 1, 1)
        first, second = ((colours + 0.05 * torch.randn(16, 3, 32, 32)).clamp(0, 1) for _ in range(2))
        queued = contrast.queue.clone()
        keys = contrast.keys(second)
        loss = contrast.loss(network.encode(first)[-1], keys)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
        assert (contrast.queue != queued).any(1).sum() == 16 and not keys.requires_grad
    assert np.mean(losses[-10:]) < 0.7 * np.mean(losses[4:14])  # the queue is first of random keys, easily told apart
    theirs = contrast.query.head[0].weight.detach()
    before = (contrast.key.head[0].weight - theirs).norm()
    contrast.keys(second)
    assert (contrast.key.head[0].weight - theirs).norm() == pytest.approx(float(0.9 * before), rel=1e-3)


def test_training_writes_weights_and_continues_where_it_stopped(tmp_path, capsys):
    arguments = [
        "--out",
        str(tmp_path),
        "--device",
        "cpu",
        "--batch",
        str(WORLDS),
        "--pool",
        "16",
        "--held-out",
        "4",
    ]
    recorded(tmp_path / "episodes.npz")
    arguments += ["--episodes", str(tmp_path / "episodes.npz")]
    main([*arguments, "--steps", "2"])
    main([*arguments, "--steps", "1"])
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert figures["images"] == 4
    assert torch.load(tmp_path / "checkpoint.pt", weights_only=True)["step"] == 3
    with (tmp_path / "curves.csv").open() as file:
        rows = list(csv.DictReader(file))
    steps = [int(row["step"]) for row in rows]
    assert steps == sorted(set(steps)) and {2, 3} <= set(steps)  # a slow machine reports in between as well
    assert all(np.isfinite(float(row["heatmap"])) for row in rows)
    from np_training.detector.exporting import load_weights

    _, record = load_weights(tmp_path / "keypoint_detector_card.safetensors")
    assert record["steps"] == 3 and record["images"] == 12 and record["held_out"] == figures
    assert all(np.isfinite(float(row["contrast"])) for row in rows)
    other = tmp_path / "other"
    weights = tmp_path / "keypoint_detector_card.safetensors"
    quiet = ["--no-contrast", "--reuse", "2", "--rate", "0", "--start", str(weights), "--steps", "3"]
    main(["--out", str(other), *arguments[2:], *quiet])
    begun, record = load_weights(other / "keypoint_detector_card.safetensors")
    assert "--reuse 2 --start keypoint_detector_card.safetensors" in record["command"]
    kept = load_weights(weights)[0].state_dict()
    assert all(torch.equal(value, kept[name]) for name, value in begun.named_parameters())  # at a rate of nothing
    with pytest.raises(ValueError, match="expected a checkpoint of .*False.*got .*True"):
        main([*arguments, "--no-contrast", "--steps", "1"])
    with pytest.raises(ValueError, match="expected a checkpoint of .*bump"):
        main([*arguments[:-2], "--domain", "bump", "--steps", "1"])
