"""What routers and policies are."""

from typing import Any, Protocol

from marouting import Problem, Solution


class Policy(Protocol):
    """Chooses moves in any face of the environment."""

    def act(self, observation: Any, mask: Any) -> int:
        """A move.

        Args:
            observation: (F,) float32, what the agent sees.
            mask: (6,) int8, the moves that cross an edge.

        Returns:
            One of the six moves.
        """
        ...


class Router(Protocol):
    """Routes whole problems."""

    @property
    def name(self) -> str:
        """What tables call it."""
        ...

    def route(self, problem: Problem) -> Solution:
        """A solution of the problem; nets that could not be joined stay open in it."""
        ...
