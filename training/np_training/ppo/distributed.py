"""Training on several devices, one process each, started by `torchrun`.

Every process simulates worlds of its own; gradients, statistics and decisions are sums over all of them. A
process alone gets the same results without a message: every function here is then the identity.
"""

from __future__ import annotations

import os

import torch
import torch.distributed as dist
import warp as wp


def join(device: str) -> str:
    """Join the processes that torchrun started and return this one's device, `cuda:LOCAL_RANK` or `cpu`.

    Raises ValueError where a process has no GPU of its own.
    """
    if int(os.environ.get("WORLD_SIZE", 1)) == 1:
        return device
    if not device.startswith("cuda"):
        dist.init_process_group("gloo")
        return device
    local = int(os.environ["LOCAL_RANK"])
    if local >= torch.cuda.device_count():
        raise ValueError(
            f"--nproc-per-node: expected at most {torch.cuda.device_count()}, the GPUs of this machine, "
            f"got a process {local}"
        )
    device = f"cuda:{local}"
    torch.cuda.set_device(local)
    wp.set_device(device)
    dist.init_process_group("nccl", device_id=torch.device(device))
    return device


def leave() -> None:
    """End what `join` began."""
    if dist.is_initialized():
        dist.destroy_process_group()


def rank() -> int:
    """Number of this process; 0 writes the files."""
    return dist.get_rank() if dist.is_initialized() else 0


def size() -> int:
    """Number of processes."""
    return dist.get_world_size() if dist.is_initialized() else 1


def add(*tensors: torch.Tensor) -> None:
    """Replace each tensor by its sum over all processes, in one message. All of one device and type."""
    if size() == 1:
        return
    flat = torch.cat([tensor.reshape(-1) for tensor in tensors])
    dist.all_reduce(flat)
    for tensor, part in zip(tensors, flat.split([tensor.numel() for tensor in tensors])):
        tensor.copy_(part.view_as(tensor))


def furthest(state: dict | None, device: torch.device) -> dict | None:
    """Of the checkpoints that processes have found, None for none, the one of the most steps, for all of them; its tensors are on the
    CPU. Hosts may have no disk in common, and whichever of them is the first may be another one the next time."""
    if size() == 1:
        return state
    steps = torch.zeros(size(), dtype=torch.float64, device=device)
    steps[rank()] = 0.0 if state is None else 1.0 + state["steps"]
    dist.all_reduce(steps)
    held = [state]
    dist.broadcast_object_list(held, src=int(steps.argmax()))
    return held[0]


def share(module: torch.nn.Module) -> None:
    """Give every process the first one's weights and buffers."""
    if size() > 1:
        for tensor in module.state_dict().values():
            dist.broadcast(tensor, src=0)


def check_same(module: torch.nn.Module) -> None:
    """Raises RuntimeError on every process where weights are not the same numbers on all of them."""
    if size() == 1:
        return
    numbers = torch.cat([tensor.double().reshape(-1) for tensor in module.state_dict().values()])
    low, high = numbers.clone(), numbers
    dist.all_reduce(low, dist.ReduceOp.MIN)
    dist.all_reduce(high, dist.ReduceOp.MAX)
    if not torch.equal(low, high):
        raise RuntimeError(
            f"expected the same weights on all {size()} processes, found differences up to {float((high - low).max()):.3g}: "
            "go on from the last checkpoint"
        )


def total(values: dict[str, torch.Tensor | float], device: torch.device) -> dict[str, float]:
    """Sums over all processes of named numbers, in one message; the names have to be the same everywhere."""
    numbers = torch.stack([torch.as_tensor(value, dtype=torch.float64, device=device) for value in values.values()])
    add(numbers)
    return dict(zip(values, numbers.tolist()))


def any_of(condition: bool, device: torch.device) -> bool:
    """Whether the condition holds on any process: clocks differ, and all have to stop after the same
    iteration."""
    return total({"condition": float(condition)}, device)["condition"] > 0
