"""Train the keypoint detector of a domain on images rendered as it goes.

    python -m np_training.detector.train --domain card --out runs/detector --seed 0 --minutes 6

Continues from OUT/checkpoint.pt if there is one. Writes, about once a minute and at the end, the checkpoint, a line of
OUT/curves.csv and OUT/keypoint_detector_DOMAIN.safetensors (moving average of the weights, training record in its
metadata). --minutes is the wall clock of the call, compilation and evaluation included.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Tensor
from torch.nn import functional

from np_description.camera import CAMERA
from np_description.domains import DOMAINS, Domain, find_domain
from np_training.detector.augment import augment
from np_training.detector.metrics import summarise
from np_training.detector.network import RELIABLE, KeypointNetwork, NetworkConfig, heatmap_loss
from np_training.detector.render import SceneRenderer
from np_training.detector.scenes import sample_states

LEAST_AREA = 12.0  # px of the object: below it, where the corners are cannot be asked
HELD_OUT_STREAM, WARM_UP_STREAM = 999_983, 999_979  # of random numbers; training uses the number of its first step


@dataclass(frozen=True)
class TrainConfig:
    """batch: images a step; rate: peak learning rate; warm_up: steps; sigma px of the target; score_weight of the score's
    loss; average: decay of the weights' moving average a step; pool: states drawn at once; held_out: images of the
    evaluation at the end; report, save: seconds between progress lines and between checkpoints; reserve: seconds kept
    for the evaluation."""

    batch: int = 256
    rate: float = 2e-3
    warm_up: int = 200
    sigma: float = 1.5
    score_weight: float = 0.3
    average: float = 0.999
    pool: int = 32768
    held_out: int = 4096
    report: float = 10.0
    save: float = 60.0
    reserve: float = 15.0


class Samples:
    """Endless labelled images: (images (n, 3, 224, 224), pixels (n, 8, 2), visible (n, 8), present (n, 8)).

    A corner is present if it lies inside an image that shows something of the object: hidden ones are to be inferred.
    """

    def __init__(self, domain: Domain, renderer: SceneRenderer, pool: int, generator: torch.Generator) -> None:
        self.domain, self.renderer, self.generator = domain, renderer, generator
        self.size, self._next = max(pool, renderer.worlds), pool

    def draw(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The next batch, of the renderer's size."""
        count = self.renderer.worlds
        if self._next + count > self.size:
            self._states, self._next = sample_states(self.domain, self.size, self.generator), 0
        states = self._states[self._next:self._next + count]
        self._next += count
        frames = self.renderer.render(states, self.generator)
        images, pixels = augment(frames, self.generator)
        return images, pixels, frames.visible, inside_image(pixels) & (frames.object_area >= LEAST_AREA)[:, None]


def inside_image(pixels: Tensor) -> Tensor:
    """Whether (n, 8) pixels (n, 8, 2) lie inside the image."""
    limit = torch.tensor([CAMERA.width, CAMERA.height], device=pixels.device) - 0.5
    return ((pixels > -0.5) & (pixels < limit)).all(dim=-1)


class Trainer:
    """The network, its optimiser and moving average, and what must survive an interruption."""

    def __init__(self, domain: Domain, device: str, seed: int, config: TrainConfig = TrainConfig(),
                 network: NetworkConfig = NetworkConfig(), command: str = "") -> None:
        torch.manual_seed(seed)
        self.command = command
        self.domain, self.device, self.seed, self.config = domain, torch.device(device), seed, config
        self.renderer = SceneRenderer(domain, config.batch, device)
        self.network = KeypointNetwork(network).to(self.device, memory_format=torch.channels_last)
        self.average = KeypointNetwork(network).to(self.device, memory_format=torch.channels_last).eval()
        self.average.load_state_dict(self.network.state_dict())
        self.optimiser = torch.optim.AdamW(self.network.parameters(), lr=config.rate, weight_decay=1e-4, fused=True)
        self.step, self.seconds = 0, 0.0

    def samples(self, stream: int) -> Samples:
        """Images of a random stream of their own."""
        generator = torch.Generator(device=self.device).manual_seed(self.seed * 1_000_003 + stream)
        return Samples(self.domain, self.renderer, self.config.pool, generator)

    def update(self, batch: tuple[Tensor, Tensor, Tensor, Tensor], progress: float) -> dict[str, Tensor]:
        """One gradient step, `progress` of the way; losses and errors as tensors on the device."""
        images, truth, visible, mask = batch
        warm = min(1.0, (self.step + 1) / self.config.warm_up)
        cosine = 0.5 * (1 + math.cos(math.pi * progress))
        for group in self.optimiser.param_groups:
            group["lr"] = self.config.rate * warm * max(cosine, 0.01)
        self.network.train()
        found = self.forward(self.network, images)
        error = (found.pixels.detach() - truth).norm(dim=-1)
        reliable = (error <= RELIABLE) & mask
        heat = (heatmap_loss(found.logits, truth, self.config.sigma) * mask).sum() / mask.sum().clamp(min=1)
        score = functional.binary_cross_entropy_with_logits(found.score_logits, reliable.float())
        self.optimiser.zero_grad(set_to_none=True)
        (heat + self.config.score_weight * score).backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
        self.optimiser.step()
        self.step += 1
        self._follow()
        seen = visible & mask
        nothing = torch.full_like(error, torch.nan)
        return {"heatmap": heat.detach(), "score": score.detach(),
                "visible_px": torch.where(seen, error, nothing).nanmedian(),
                "hidden_px": torch.where(mask & ~visible, error, nothing).nanmedian(),
                "within": (reliable & seen).sum() / seen.sum().clamp(min=1)}

    def forward(self, network: KeypointNetwork, images: Tensor):
        """The network's answer, in bfloat16 on a GPU."""
        images = images.contiguous(memory_format=torch.channels_last)
        with torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.device.type == "cuda"):
            return network(images)

    @torch.no_grad()
    def _follow(self) -> None:
        decay = min(self.config.average, self.step / (self.step + 10))
        parameters = list(self.average.parameters())
        torch._foreach_lerp_(parameters, list(self.network.parameters()), 1 - decay)
        for mine, theirs in zip(self.average.buffers(), self.network.buffers()):
            if mine.is_floating_point():
                mine.lerp_(theirs, 1 - decay)

    @torch.no_grad()
    def evaluate(self, images: int) -> dict:
        """Figures of the averaged weights on images of another random stream."""
        samples, rows = self.samples(HELD_OUT_STREAM), []
        for _ in range(max(1, images // self.config.batch)):
            batch, truth, visible, mask = samples.draw()
            found = self.forward(self.average, batch)
            rows.append([t.float().cpu() for t in (found.pixels, found.score_logits.sigmoid(), truth, visible, mask)])
        pixels, scores, truth, visible, mask = (torch.cat(column).numpy() for column in zip(*rows))
        return summarise(pixels, scores, truth, visible, mask)

    def save(self, path: Path) -> None:
        """Write a checkpoint; a reader never sees half of one."""
        state = {"network": self.network.state_dict(), "average": self.average.state_dict(), "step": self.step,
                 "optimiser": self.optimiser.state_dict(), "seconds": self.seconds, "domain": self.domain.name,
                 "config": asdict(self.network.config)}
        torch.save(state, path.with_suffix(".part"))
        path.with_suffix(".part").replace(path)

    def load(self, path: Path) -> None:
        """Continue from a checkpoint. Raises ValueError if it is of another domain or network."""
        state = torch.load(path, map_location=self.device, weights_only=True)
        mine = {"domain": self.domain.name, "config": asdict(self.network.config)}
        theirs = {key: state[key] for key in mine}
        if theirs != mine:
            raise ValueError(f"{path}: expected a checkpoint of {mine}, got {theirs}")
        self.network.load_state_dict(state["network"])
        self.average.load_state_dict(state["average"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.step, self.seconds = state["step"], state["seconds"]

    def record(self, **more) -> dict:
        """What a model card says of the training."""
        gpu = torch.cuda.get_device_name(self.device) if self.device.type == "cuda" else "CPU"
        return {"domain": self.domain.name, "seed": self.seed, "steps": self.step, "images": self.step * self.config.batch,
                "minutes": round(self.seconds / 60, 2), "device": gpu, "command": self.command, **more}

    def write_weights(self, path: Path, **more) -> None:
        """The averaged weights as safetensors, with the network's form and the training record in the metadata."""
        tensors = {name: t.contiguous().cpu() for name, t in self.average.state_dict().items()}
        save_file(tensors, path, metadata={"network": json.dumps(asdict(self.network.config)),
                                           "training": json.dumps(self.record(**more))})


def train(trainer: Trainer, out: Path, steps: int | None, seconds: float, say: Callable[[str], None]) -> dict:
    """Train until `steps` more are done or `seconds` have passed; the held-out figures at the end."""
    config, began, first = trainer.config, time.monotonic(), trainer.step
    checkpoint, weights = out / "checkpoint.pt", out / f"keypoint_detector_{trainer.domain.name}.safetensors"
    earlier, budget = trainer.seconds, max(1.0, seconds - config.reserve)
    samples = trainer.samples(trainer.step)
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
            say(f"{progress:4.0%}  step {trainer.step}  {rate:.0f} images/s  loss {means['heatmap']:.3f} "
                f"{means['score']:.3f}  error {means['visible_px']:.2f} px visible, {means['hidden_px']:.2f} px hidden, "
                f"{means['within']:.1%} within {RELIABLE:.0f} px  {left / 60:.1f} min left")
            append_row(out / "curves.csv", {"step": trainer.step, "seconds": round(trainer.seconds, 1),
                                            "images_per_second": round(rate), **means})
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


def main(arguments: list[str] | None = None) -> None:
    """Command line; the last line printed is the held-out figures as JSON."""
    began = time.monotonic()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--domain", choices=list(DOMAINS), default="card")
    parser.add_argument("--out", type=Path, required=True, help="folder of checkpoint, curves and weights")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=6.0, help="wall clock of this call")
    parser.add_argument("--steps", type=int, help="do so many steps instead")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--batch", type=int, default=TrainConfig.batch)
    parser.add_argument("--rate", type=float, default=TrainConfig.rate)
    parser.add_argument("--pool", type=int, default=TrainConfig.pool)
    parser.add_argument("--held-out", type=int, default=TrainConfig.held_out)
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    torch.backends.cudnn.benchmark = True
    torch.set_float32_matmul_precision("high")
    config = TrainConfig(batch=options.batch, rate=options.rate, pool=options.pool, held_out=options.held_out)
    names = ("domain", "seed", "steps" if options.steps else "minutes", "batch", "rate", "pool")
    command = " ".join(f"--{name} {getattr(options, name)}" for name in names)
    trainer = Trainer(find_domain(options.domain), options.device, options.seed, config, command=command)
    if (options.out / "checkpoint.pt").exists():
        trainer.load(options.out / "checkpoint.pt")
        say(f"continues from step {trainer.step}")
    trainer.samples(WARM_UP_STREAM).draw()  # compiles the renderer, before the clock of the training starts
    say(f"set up in {time.monotonic() - began:.0f} s")
    figures = train(trainer, options.out, options.steps, options.minutes * 60 - (time.monotonic() - began), say)
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
