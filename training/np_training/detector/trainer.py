"""The detector's optimisation: losses, weights' moving average, checkpoints."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from safetensors.torch import save as serialise
from torch import Tensor
from torch.nn import functional

from np_description.domains import Task
from np_description.weights.contract import KEY
from np_description.weights.header import with_metadata
from np_perception.contract import DetectorContract
from np_training.detector.contrast import ContrastConfig, MomentumContrast
from np_training.detector.metrics import summarise
from np_training.detector.network import RELIABLE, KeypointNetwork, NetworkConfig, heatmap_loss
from np_training.detector.render import SceneRenderer
from np_training.detector.samples import ImageGenerator, LabelledImages, SampleConfig

HELD_OUT_STREAM = 999_983  # of random numbers; training uses the number of its first step


@dataclass(frozen=True)
class DetectorConfig:
    """batch: images a step; rate: peak learning rate; warm_up: steps; sigma px of the target; score_weight of
    the score's loss; average: decay of the weights' moving average a step; pool: states drawn at once;
    held_out: images of the evaluation at the end; report, save: seconds between progress lines and between
    checkpoints; reserve: seconds kept for the evaluation; contrast: momentum contrast beside the heatmaps, or
    None; samples: the images; edges: range of the factors on the object's edges, None: its own size."""

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
    contrast: ContrastConfig | None = ContrastConfig()
    samples: SampleConfig = SampleConfig()
    edges: tuple[float, float] | None = None


class DetectorTrainer:
    """The network, its optimiser and moving average, and what must survive an interruption."""

    def __init__(
        self,
        domain: Task,
        device: str,
        seed: int,
        config: DetectorConfig = DetectorConfig(),
        network: NetworkConfig = NetworkConfig(),
        command: str = "",
        visited: Tensor | None = None,
    ) -> None:
        torch.manual_seed(seed)
        self.command, self.visited = command, visited
        self.domain, self.device, self.seed, self.config = domain, torch.device(device), seed, config
        self.renderer = SceneRenderer(domain, config.batch, device, edges=config.edges)
        self.network = KeypointNetwork(network).to(self.device, memory_format=torch.channels_last)
        self.average = KeypointNetwork(network).to(self.device, memory_format=torch.channels_last).eval()
        self.average.load_state_dict(self.network.state_dict())
        self.contrast = MomentumContrast(self.network, config.contrast).to(self.device) if config.contrast else None
        learning = [*self.network.parameters(), *(self.contrast.query.head.parameters() if self.contrast else ())]
        self.optimiser = torch.optim.AdamW(learning, lr=config.rate, weight_decay=1e-4, fused=True)
        self.step, self.seconds = 0, 0.0

    def samples(self, stream: int, pairs: bool = False) -> ImageGenerator:
        """Images of a random stream of their own; pairs: see `ImageGenerator`."""
        generator = torch.Generator(device=self.device).manual_seed(self.seed * 1_000_003 + stream)
        return ImageGenerator(
            self.domain, self.renderer, self.config.pool, generator, self.config.samples, self.visited, pairs
        )

    def update(self, batch: LabelledImages, progress: float) -> dict[str, Tensor]:
        """One gradient step, `progress` of the way; losses and errors as tensors on the device."""
        images, truth, visible, mask, second = batch
        warm = min(1.0, (self.step + 1) / self.config.warm_up)
        cosine = 0.5 * (1 + math.cos(math.pi * progress))
        for group in self.optimiser.param_groups:
            group["lr"] = self.config.rate * warm * max(cosine, 0.01)
        self.network.train()
        with self._precision():
            levels = self.network.encode(images.contiguous(memory_format=torch.channels_last))
            found = self.network.read(levels)
        error = (found.pixels.detach() - truth).norm(dim=-1)
        reliable = (error <= RELIABLE) & mask
        heat = (heatmap_loss(found.logits, truth, self.config.sigma) * mask).sum() / mask.sum().clamp(min=1)
        score = functional.binary_cross_entropy_with_logits(found.score_logits, reliable.float())
        loss = heat + self.config.score_weight * score
        told_apart = {}
        if self.contrast:
            with self._precision():
                keys = self.contrast.keys(second.contiguous(memory_format=torch.channels_last))
                contrast = self.contrast.loss(levels[-1], keys)
            loss = loss + self.config.contrast.weight * contrast
            told_apart = {"contrast": contrast.detach()}
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
        self.optimiser.step()
        self.step += 1
        self._follow()
        seen = visible & mask
        nothing = torch.full_like(error, torch.nan)
        return {
            "heatmap": heat.detach(),
            "score": score.detach(),
            **told_apart,
            "visible_px": torch.where(seen, error, nothing).nanmedian(),
            "hidden_px": torch.where(mask & ~visible, error, nothing).nanmedian(),
            "within": (reliable & seen).sum() / seen.sum().clamp(min=1),
        }

    def forward(self, network: KeypointNetwork, images: Tensor):
        """The network's output, in bfloat16 on a GPU."""
        with self._precision():
            return network(images.contiguous(memory_format=torch.channels_last))

    def _precision(self) -> torch.autocast:
        return torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.device.type == "cuda")

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
            batch, truth, visible, mask, _ = samples.draw()
            found = self.forward(self.average, batch)
            rows.append([t.float().cpu() for t in (found.pixels, found.score_logits.sigmoid(), truth, visible, mask)])
        pixels, scores, truth, visible, mask = (torch.cat(column).numpy() for column in zip(*rows))
        return summarise(pixels, scores, truth, visible, mask)

    def save(self, path: Path) -> None:
        """Write a checkpoint; a reader never sees half of one."""
        state = {
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "step": self.step,
            "optimiser": self.optimiser.state_dict(),
            "seconds": self.seconds,
            "domain": self.domain.name,
            "config": asdict(self.network.config),
            "contrast": self.contrast.state_dict() if self.contrast else None,
        }
        torch.save(state, path.with_suffix(".part"))
        path.with_suffix(".part").replace(path)

    def load(self, path: Path) -> None:
        """Continue from a checkpoint. Raises ValueError if it is of another domain or network."""
        state = torch.load(path, map_location=self.device, weights_only=True)
        mine = {"domain": self.domain.name, "config": asdict(self.network.config), "contrast": bool(self.contrast)}
        theirs = {key: state.get(key) for key in mine} | {"contrast": bool(state.get("contrast"))}
        if theirs != mine:
            raise ValueError(f"{path}: expected a checkpoint of {mine}, got {theirs}")
        self.network.load_state_dict(state["network"])
        self.average.load_state_dict(state["average"])
        self.optimiser.load_state_dict(state["optimiser"])
        if self.contrast:
            self.contrast.load_state_dict(state["contrast"])
        self.step, self.seconds = state["step"], state["seconds"]

    def start_from(self, path: Path) -> None:
        """Begin with released weights. Raises WeightsError where they are none of this domain, ValueError where of another network."""
        from np_training.detector.exporting import load_weights  # imports the exporter, which training does not need

        network, record = load_weights(path)
        mine = {"domain": self.domain.name, "network": self.network.config}
        theirs = {"domain": record["domain"], "network": network.config}
        if theirs != mine:
            raise ValueError(f"{path}: expected weights of {mine}, got {theirs}")
        self.network.load_state_dict(network.state_dict())
        self.average.load_state_dict(network.state_dict())

    def record(self, **more) -> dict:
        """What a model card states of the training."""
        gpu = torch.cuda.get_device_name(self.device) if self.device.type == "cuda" else "CPU"
        return {
            "domain": self.domain.name,
            "seed": self.seed,
            "steps": self.step,
            "images": self.step * self.config.batch,
            "minutes": round(self.seconds / 60, 2),
            "device": gpu,
            "command": self.command,
            **more,
        }

    def write_weights(self, path: Path, **more) -> None:
        """The averaged weights as safetensors, with the network's form, the contract and the training record in
        the metadata."""
        tensors = {name: t.contiguous().cpu() for name, t in self.average.state_dict().items()}
        metadata = {
            KEY: DetectorContract.of(self.domain).text(),
            "network": json.dumps(asdict(self.network.config)),
            "training": json.dumps(self.record(**more)),
        }
        path.write_bytes(with_metadata(serialise(tensors), metadata))
