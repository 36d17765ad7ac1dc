"""What a learner keeps for each of its networks: arrays and tensors with one row per network.

Everything that belongs to a network leaves with it, is saved with it and comes back with it. A
class says once which of its attributes these are, and gets all three.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Array = TypeVar("Array", NDArray[Any], Tensor)


def kept(store: Array, which: NDArray[np.integer]) -> Array:
    """Some rows of a store (ascending), moved up in place: a second store may not fit in memory."""
    for to, row in enumerate(which.tolist()):
        if to != row:
            store[to] = store[row]
    return store[: len(which)]


class Rows:
    """Something with one row per network in each of the attributes that ``rows`` names."""

    rows: ClassVar[tuple[str, ...]] = ()
    """Attributes: tensors or arrays whose first axis is the network."""

    parts: ClassVar[tuple[str, ...]] = ()
    """Attributes that are themselves :class:`Rows`; one that is None is left out."""

    def _parts(self) -> dict[str, "Rows"]:
        return {name: part for name in self.parts if (part := getattr(self, name)) is not None}

    def bind(self) -> None:
        """Renews what refers to the rows: they are other tensors now."""

    def keep(self, which: NDArray[np.integer]) -> None:
        """Goes on with some of the networks only.

        Args:
            which: (L',) their rows, ascending.
        """
        for part in self._parts().values():
            part.keep(which)
        for name in self.rows:
            setattr(self, name, kept(getattr(self, name), which))
        self.bind()

    def state(self) -> dict[str, Tensor]:
        """All rows by name, for a checkpoint; on the processor the tensors themselves."""
        state = {
            f"{name}.{key}": tensor
            for name, part in self._parts().items()
            for key, tensor in part.state().items()
        }
        return state | {name: torch.as_tensor(getattr(self, name)).cpu() for name in self.rows}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes back to what :meth:`state` gave, of the same shapes."""
        for name, part in self._parts().items():
            start = f"{name}."
            own = {key: tensor for key, tensor in state.items() if key.startswith(start)}
            part.load_state({key.removeprefix(start): tensor for key, tensor in own.items()})
        for name in self.rows:
            row = getattr(self, name)
            if isinstance(row, Tensor):
                row.copy_(state[name])
            else:
                row[...] = state[name].numpy()
        self.bind()
