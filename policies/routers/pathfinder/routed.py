"""What the router returns: a solution, and how it was found."""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from marouting import Solution
from policies.routers.pathfinder.state import Kind

Stop = Literal["optimal", "settled", "gain", "passes", "seconds", "asked"]
"""Why a search ended: no solution can be better; it finds nothing better any more; or too little
for the time; it had all the passes, or all the time, that it may take; or somebody asked it to
stop."""


class Pass(NamedTuple):
    """The state after a pass over the nets."""

    kind: Kind
    overflow: int  # in tracks
    wirelength: float  # in edges, with what the options charge for vias, crowded edges and layers
    routed: int  # nets rerouted in this pass


@dataclass(frozen=True)
class Routed:
    """A solution and how it was found.

    Attributes:
        solution: the solution with the least overflow after any pass, and among those the least
            wirelength, vias weighted by ``via_weight``, and what crowded edges and layers that long
            nets do not prefer cost (with ``cost: ispd2024`` the least cost). More time gives no
            worse one with the same seed, unless ``least_gain`` ends the search.
        seconds: time taken.
        history: every pass, in order; the first is that of patterns.
        stop: why the search ended.
    """

    solution: Solution
    seconds: float
    history: tuple[Pass, ...]
    stop: Stop

    @property
    def iterations(self) -> int:
        """Number of passes over the nets."""
        return len(self.history)

    @property
    def report(self) -> dict[str, Any]:
        """Figures for tables beyond those of the evaluator: ``iterations`` and ``stop``."""
        return {"iterations": self.iterations, "stop": self.stop}
