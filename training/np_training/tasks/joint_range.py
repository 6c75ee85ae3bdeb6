"""The adaptive joint range: keep the arm away from its joint limits, as far as the task allows.

The paper names an adaptive joint range among its randomisation and does not define it. Our reading: once
domain randomisation is on, joints are penalised for the angle by which they leave a range that is a share of
the one between their limits. The range tightens while success is high and widens again when it suffers, so
that its final width is found, not set. Off by default; the figures of runs with it say so.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from np_description.panda import NOMINAL


@dataclass(frozen=True)
class JointRangeConfig:
    """penalty: a rad outside and step, before the reward's scale; least: narrowest share; factor: of one
    adaptation; tighten_at, widen_below: success that decides."""

    penalty: float = 100.0
    least: float = 0.6
    factor: float = 0.99
    tighten_at: float = 0.95
    widen_below: float = 0.9


class JointRange:
    """share: width of the range over that between the joint limits, around the same middle."""

    def __init__(self, device: torch.device, config: JointRangeConfig = JointRangeConfig()) -> None:
        self.config, self.share = config, 1.0
        lower, upper = (
            torch.tensor(a, dtype=torch.float32, device=device)
            for a in (NOMINAL.position_lower, NOMINAL.position_upper)
        )
        self._middle, self._half = (lower + upper) / 2, (upper - lower) / 2

    def adapt(self, success: float) -> None:
        """Tighten or widen by one step, given the success of late."""
        if success >= self.config.tighten_at:
            self.share = max(self.share * self.config.factor, self.config.least)
        elif success < self.config.widen_below:
            self.share = min(self.share / self.config.factor, 1.0)

    def term(self, q: torch.Tensor) -> torch.Tensor:
        """Reward term (n,), not scaled, of joints q (n, 7) rad."""
        outside = ((q - self._middle).abs() - self.share * self._half).clamp(min=0).nan_to_num()
        return -self.config.penalty * outside.sum(-1)
