"""A trained detector made ready for others: weights, exported network, figures and model card."""

from __future__ import annotations

import shutil
from pathlib import Path

from np_description.domains import find_domain
from np_description.weights.header import tensors_sha256
from np_perception.detector import network_name
from np_training.detector.exporting import export, load_weights
from np_training.detector.judging import evaluate, write_figures
from np_training.detector.network import RELIABLE
from np_training.detector.visited import load_visited

CARD = """# Keypoint detector, {domain}

Image (224 x 224 RGB) to the eight corners of the {domain}'s box, in the order of `np_description.keypoints`, with
scores: the probability that a corner is within {reliable:.0f} px of the truth. Hidden corners are inferred.

| | |
|---|---|
| network | {parameters:,} parameters; half-resolution U-Net, full-resolution heatmaps, soft-argmax of {window} px around the peak (`np_training.detector.network`) |
| data | {images:,} images of this project's scene, rendered during training by MuJoCo Warp; no real images |
| randomised | camera within 1 cm and 1 degree, lights, colours, background colour and texture, edges, contrast, gamma, blur, noise (`np_training.detector.render`, `augment`) |
| training | seed {seed}, {steps:,} steps in {minutes} min on {device}: `python -m np_training.detector.train {command}` |
| sha256 | `{name}.safetensors` {sha256}, of its tensors alone `{tensors}` |

Errors in px on {count} held-out images a set
(`python -m np_training.detector.evaluate --domain {domain} --images {count} --seed {evaluation_seed}{episodes}`):

| set | visible: median | 95 % | within {reliable:.0f} px | hidden: median | 95 % | within {reliable:.0f} px | calibration error |
|---|---|---|---|---|---|---|---|
{rows}

`nominal` is the scene as the sim bridge draws it with OpenGL, `ray_caster` the same by MuJoCo Warp on the CPU,
`shifted` has table patterns never used in training, other lights and colours, and the camera within 2 cm and 2 degrees
of its place.
"""


def release(
    run: Path, domain_name: str, weights: Path, results: Path, images: int, seed: int, episodes: Path | None = None
) -> Path:
    """Release the detector of a training run; the path of its model card. episodes: see `evaluate`."""
    domain = find_domain(domain_name)
    name = network_name(domain)
    visited = load_visited(episodes, domain, "cpu") if episodes else None
    weights.mkdir(parents=True, exist_ok=True)
    results.mkdir(parents=True, exist_ok=True)
    target = weights / f"{name}.safetensors"
    shutil.copyfile(run / target.name, target)
    export(target)
    figures, sheet = evaluate(domain, weights, images, seed, visited)
    write_figures(figures, sheet, results)
    card = target.with_suffix(".md")
    card.write_text(model_card(target, figures, episodes))
    return card


def model_card(weights: Path, figures: dict, episodes: Path | None = None) -> str:
    """Markdown of the training record in `weights` and the figures of `np_training.detector.evaluate`, with the
    recording that most of its states came from."""
    network, record = load_weights(weights)
    rows = []
    for name, result in figures["sets"].items():
        cells = [result[part][key] for part in ("visible", "hidden") for key in ("median", "p95", "within")]
        rows.append(f"| {name} | {' | '.join(map(str, cells))} | {result['calibration_error']} |")
    return CARD.format(
        name=weights.stem,
        reliable=RELIABLE,
        parameters=sum(p.numel() for p in network.parameters()),
        window=2 * network.config.window + 1,
        rows="\n".join(rows),
        sha256=figures["weights_sha256"],
        tensors=tensors_sha256(weights),
        count=max(result["images"] for result in figures["sets"].values()),
        evaluation_seed=figures["seed"],
        episodes=f" --episodes {episodes.name}" if episodes else "",
        **{key: record[key] for key in ("domain", "images", "seed", "steps", "minutes", "device", "command")},
    )
