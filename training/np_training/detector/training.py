"""A run of the detector's training, as its command line requests."""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from np_description.domains import find_domain
from np_training.detector.augment import Augmentation
from np_training.detector.contrast import ContrastConfig
from np_training.detector.network import RELIABLE
from np_training.detector.samples import SampleConfig
from np_training.detector.trainer import DetectorConfig, DetectorTrainer
from np_training.detector.visited import load_visited

FLAGS = ("no_contrast", "keep_background", "always_background")  # flags that the record of a training holds
DEFAULTED = ("batch", "rate", "pool", "held_out")  # by TrainConfig, where the command line does not set them
WARM_UP_STREAM = 999_979  # of random numbers


def train(trainer: DetectorTrainer, out: Path, steps: int | None, seconds: float, say: Callable[[str], None]) -> dict:
    """Train until `steps` more are done or `seconds` have passed; the held-out figures at the end."""
    config, began, first = trainer.config, time.monotonic(), trainer.step
    checkpoint, weights = out / "checkpoint.pt", out / f"keypoint_detector_{trainer.domain.name}.safetensors"
    earlier, budget = trainer.seconds, max(1.0, seconds - config.reserve)
    samples = trainer.samples(trainer.step, pairs=trainer.contrast is not None)
    reported = saved = began
    window: list[dict[str, Tensor]] = []
    progress = 0.0
    while progress < 1:
        window.append(trainer.update(samples.draw(), progress))
        now = time.monotonic()
        trainer.seconds = earlier + now - began
        progress = min(1.0, (trainer.step - first) / steps if steps else (now - began) / budget)
        if now - reported >= config.report or progress == 1:
            means = {key: torch.stack([w[key] for w in window]).nanmean().item() for key in window[0]}
            rate = len(window) * config.batch / (time.monotonic() - reported)
            left = (1 - progress) * (now - began) / max(progress, 1e-6)
            say(
                f"{progress:4.0%}  step {trainer.step}  {rate:.0f} images/s  loss {means['heatmap']:.3f} "
                f"{means['score']:.3f}  error {means['visible_px']:.2f} px visible, "
                f"{means['hidden_px']:.2f} px hidden, "
                f"{means['within']:.1%} within {RELIABLE:.0f} px  {left / 60:.1f} min left"
            )
            append_row(
                out / "curves.csv",
                {"step": trainer.step, "seconds": round(trainer.seconds, 1), "images_per_second": round(rate), **means},
            )
            reported, window = time.monotonic(), []
        if now - saved >= config.save:
            trainer.save(checkpoint)
            trainer.write_weights(weights)
            saved = time.monotonic()
    trainer.save(checkpoint)
    trainer.write_weights(weights)
    figures = trainer.evaluate(config.held_out)
    trainer.write_weights(weights, held_out=figures)
    return figures


def append_row(path: Path, row: dict) -> None:
    """Add a row to a CSV file, with a header if it is new."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(row))
        if new:
            writer.writeheader()
        writer.writerow(row)


def augmentation_for(keep: bool, always: bool) -> Augmentation:
    """What is replaced of background and table: nothing (keep), everything, by a colour or a texture with equal odds (always, the
    paper), or, where neither is given, 60 % of the images."""
    if keep:
        return Augmentation(coloured=0.0, textured=0.0)
    return Augmentation(coloured=0.5, textured=0.5) if always else Augmentation()


def run(options: argparse.Namespace, began: float) -> dict:
    """The held-out figures of the requested training; began: s, of time.monotonic, from which its minutes count."""
    options.out.mkdir(parents=True, exist_ok=True)

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    torch.backends.cudnn.benchmark = True
    torch.set_float32_matmul_precision("high")
    domain = find_domain(options.domain)
    augmentation = augmentation_for(options.keep_background, options.always_background)
    given = {name: getattr(options, name) for name in DEFAULTED if getattr(options, name) is not None}
    config = DetectorConfig(
        **given,
        contrast=None if options.no_contrast else ContrastConfig(),
        edges=tuple(options.sizes) if options.sizes else None,
        samples=SampleConfig(augmentation=augmentation, reuse=options.reuse or SampleConfig.reuse),
    )
    visited = load_visited(options.episodes, domain, options.device) if options.episodes else None
    names = (
        "domain",
        "seed",
        "steps" if options.steps else "minutes",
        "batch",
        "rate",
        "pool",
        "reuse",
        "start",
        "episodes",
    )
    used = {
        **vars(options),
        **{name: getattr(config, name) for name in DEFAULTED},
        **{name: file and file.name for name, file in (("episodes", options.episodes), ("start", options.start))},
    }  # the folder means nothing elsewhere
    command = " ".join(
        [
            *([f"--sizes {options.sizes[0]:g} {options.sizes[1]:g}"] if options.sizes else ()),
            *(f"--{name} {used[name]}" for name in names if used[name] is not None),
            *(f"--{name.replace('_', '-')}" for name in FLAGS if getattr(options, name)),
        ]
    )
    trainer = DetectorTrainer(domain, options.device, options.seed, config, command=command, visited=visited)
    if (options.out / "checkpoint.pt").exists():
        trainer.load(options.out / "checkpoint.pt")
        say(f"continues from step {trainer.step}")
    elif options.start:
        trainer.start_from(options.start)
        say(f"begins with {options.start.name}")
    trainer.samples(WARM_UP_STREAM).draw()  # compiles the renderer, before the clock of the training starts
    say(f"set up in {time.monotonic() - began:.0f} s")
    return train(trainer, options.out, options.steps, options.minutes * 60 - (time.monotonic() - began), say)
