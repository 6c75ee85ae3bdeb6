"""How deep things are in each other in every world: np_description.contact.penetration, for many worlds at once."""

from __future__ import annotations

import torch
import warp as wp

from np_description.contact.depths import PAIRS
from np_description.contact.penetration import kind_of, pair_of


class BatchedContacts:
    """Reads the simulator's contacts of the last physics step. names: of the model's geoms."""

    def __init__(self, names: list[str], data, worlds: int) -> None:
        self._worlds, self._count = worlds, wp.to_torch(data.nacon)
        self._dist, self._geom, self._world = (
            wp.to_torch(array) for array in (data.contact.dist, data.contact.geom, data.contact.worldid)
        )
        kinds = [kind_of(name) for name in names]
        table = [[pair_of(one, other) for other in kinds] for one in kinds]
        numbers = [[PAIRS.index(pair) if pair else len(PAIRS) for pair in row] for row in table]
        self._pair = torch.tensor(numbers, device=self._dist.device)

    def depths(self) -> torch.Tensor:
        """The deepest depth m (worlds, pairs) of each of `np_description.contact.depths.PAIRS`; 0 where a pair does not touch."""
        # The simulator's arrays are longer than what is in use; all of them is one operation, without waiting for a count.
        rows = torch.arange(len(self._dist), device=self._dist.device)
        used = (rows < self._count[0]) & (self._dist < 0)
        pair = self._pair[self._geom[:, 0].clamp(min=0).long(), self._geom[:, 1].clamp(min=0).long()]
        cell = self._world.clamp(0, self._worlds - 1).long() * (len(PAIRS) + 1) + pair
        out = torch.zeros(self._worlds * (len(PAIRS) + 1), device=self._dist.device)
        out.scatter_reduce_(0, cell, torch.where(used, -self._dist, 0.0), "amax")
        return out.reshape(self._worlds, -1)[:, :-1]

    def touching(self, *pairs: str) -> torch.Tensor:
        """Worlds (n,) in which one of these pairs touches."""
        return (self.depths()[:, [PAIRS.index(pair) for pair in pairs]] > 0).any(-1)
