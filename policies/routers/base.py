"""What routers and policies are."""

from typing import Any, Protocol, runtime_checkable

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


class Routed(Protocol):
    """A solution, and what its router has to say of it."""

    @property
    def solution(self) -> Solution:
        """The solution."""
        ...

    @property
    def report(self) -> dict[str, Any]:
        """Figures by name that no evaluator could tell, fit for JSON.

        ``status`` is among them where something is proven: ``optimal`` if the solution is.
        """
        ...


@runtime_checkable
class Reporter(Router, Protocol):
    """A router that has more to give than a solution."""

    def solve(self, problem: Problem) -> Routed:
        """The solution of :meth:`route`, and more."""
        ...


def solve(router: Router, problem: Problem) -> tuple[Solution, dict[str, Any]]:
    """A router's solution, and its report: empty from one that makes none."""
    if not isinstance(router, Reporter):
        return router.route(problem), {}
    routed = router.solve(problem)
    return routed.solution, routed.report
