"""States that episodes of the trained policies pass through: what the deployed camera shows most of the time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from np_description.domains import Task
from np_training.detector.scenes import STATE_SIZE
from np_training.episodes.recording import load_recording

JOINT_SPREAD = 0.01  # rad: a real arm follows a little differently
OBJECT_SPREAD = 0.002  # m: so that the same few episodes do not give the same images twice


def load_visited(path: Path, domain: Task, device: str | torch.device) -> torch.Tensor:
    """States (n, 16) of recorded episodes (`np_training.evaluate --record`), each up to its end.

    Raises ValueError where the recording is of another domain or holds no episode that was played.
    """
    recording = load_recording(path)
    if recording.domain != domain.name:
        raise ValueError(f"{path}: expected episodes of {domain.name}, got {recording.domain}")
    steps = np.arange(len(recording.qpos))[:, None]
    states = recording.qpos[(steps <= recording.length) & (recording.mode != "infeasible")]
    states = states[np.isfinite(states).all(1)]
    if not len(states):
        raise ValueError(f"{path}: expected at least one episode that was played, got none")
    return torch.as_tensor(states, dtype=torch.float32, device=device).view(-1, STATE_SIZE)


def mix_visited(states: torch.Tensor, visited: torch.Tensor, share: float, generator: torch.Generator) -> torch.Tensor:
    """`states` (n, 16), a share of which are replaced by visited ones (m, 16), each moved a little."""
    count, device = len(states), states.device
    rows = torch.randint(0, len(visited), (count,), generator=generator, device=device)
    spread = torch.zeros(STATE_SIZE, device=device)
    spread[:7], spread[9:12] = JOINT_SPREAD, OBJECT_SPREAD
    moved = visited[rows] + spread * torch.randn(count, STATE_SIZE, generator=generator, device=device)
    taken = torch.rand(count, 1, generator=generator, device=device) < share
    return torch.where(taken, moved, states)
