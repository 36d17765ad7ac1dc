"""What a learner keeps for each of its networks: arrays and tensors with one row per network.

Everything that belongs to a network is saved with it and comes back with it. A class says once
which of its attributes these are, and gets both.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor

from policies.learned.checkpoint import FINITE, checked

COUNT = (0.0, 2.0**53)
"""The limits of what is counted."""


class PerNetworkState:
    """Something with one row per network in each of the attributes that ``rows`` names."""

    rows: ClassVar[tuple[str, ...]] = ()
    """Attributes: tensors or arrays whose first axis is the network."""

    parts: ClassVar[tuple[str, ...]] = ()
    """Attributes that are themselves :class:`PerNetworkState`; one that is None is left out."""

    def limits(self) -> dict[str, tuple[float, float]]:
        """The least and the largest number of rows, for what a checkpoint says.

        Of rows that are not among them any finite number is right.
        """
        return {}

    def check(self, state: Mapping[str, Tensor]) -> None:
        """Raises InputError for rows of a checkpoint that are wrong in other ways."""

    def _parts(self) -> dict[str, "PerNetworkState"]:
        return {name: part for name in self.parts if (part := getattr(self, name)) is not None}

    def bind(self) -> None:
        """Renews what refers to the rows: they are other tensors now."""

    def state(self) -> dict[str, Tensor]:
        """All rows by name, for a checkpoint; on the processor the tensors themselves."""
        state = {
            f"{name}.{key}": tensor
            for name, part in self._parts().items()
            for key, tensor in part.state().items()
        }
        return state | {name: torch.as_tensor(getattr(self, name)).cpu() for name in self.rows}

    def load_state(self, state: Mapping[str, Any], where: str = "") -> None:
        """Goes back to what :meth:`state` gave.

        Args:
            state: the saved state.
            where: what the names of rows are preceded by in messages.

        Raises:
            InputError: a row is of another type or shape, or its numbers are out of range.
        """
        for name, part in self._parts().items():
            start = f"{name}."
            own = {key: tensor for key, tensor in state.items() if key.startswith(start)}
            own = {key.removeprefix(start): tensor for key, tensor in own.items()}
            part.load_state(own, where + start)
        limits = self.limits()
        for name in self.rows:
            now = torch.as_tensor(getattr(self, name))
            _ = checked(state.get(name), now, where + name, limits.get(name, FINITE))
        self.check(state)
        for name in self.rows:
            row = getattr(self, name)
            if isinstance(row, Tensor):
                row.copy_(state[name])
            else:
                row[...] = state[name].numpy()
        self.bind()
