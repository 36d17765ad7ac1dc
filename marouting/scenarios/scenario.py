"""A scenario: an endless stream of training problems, and fixed ones to validate and test on.

Every problem is drawn from a seed of its own: the SHA-256 of a text such as
``two-pin-8x8-v0/test/7/0``, with the scenario, the split, the problem's place and the attempt.
Attempts are thrown away until a problem keeps two promises:

* It is not among the problems held out. No training problem is, under any seed, one of the
  validation and test problems (:func:`marouting.scenarios.digests.digest`), and these all differ.
* It is feasible if the scenario promises so: sequential A* has routed it without overflow, in one
  of :data:`ORDERS` net orders. So a few feasible problems are thrown away as well.
"""

import functools
import hashlib
import itertools
from collections.abc import Collection, Iterator
from typing import Any, Literal, get_args

import numpy as np

from marouting.errors import InputError
from marouting.problem.net import is_whole
from marouting.problem.problem import Problem, check_choice
from marouting.scenarios.digests import digest
from marouting.scenarios.levels import Level
from marouting.scenarios.references import Best, Reference, references_of
from marouting.search.astar import sequential_astar

Split = Literal["train", "validation", "test"]  # the parts of a scenario
SPLITS: tuple[Split, ...] = get_args(Split)

ORDERS = 8  # the most net orders in which A* tries to route a problem without overflow
ATTEMPTS = 1000  # the most attempts for one problem. None of the scenarios comes near it.


class Scenario:
    """The problems of a level.

    Args:
        level: the parameters.

    Attributes:
        level: the parameters.
        name: its name.
        description: one sentence.
        grid: columns, rows and layers of Gcells, the same in all problems.
        feasible: whether every problem has a solution without overflow.
    """

    def __init__(self, level: Level) -> None:
        self.level = level
        self.name, self.description = level.name, level.description
        self.grid, self.feasible = level.grid, level.feasible

    def __repr__(self) -> str:
        return f"Scenario({self.name})"

    def train(self, seed: int) -> Iterator[Problem]:
        """Training problems without end, the same for the same seed.

        Args:
            seed: a whole number from 0.

        Raises:
            InputError: the seed is not one.
        """
        if not (is_whole(seed) and seed >= 0):
            raise InputError(f"seed: expected a whole number from 0, found {seed!r}")
        return (
            self._draw(f"train/{int(seed)}/{number}", self._held_out)
            for number in itertools.count()
        )

    @property
    def validation(self) -> list[Problem]:
        """The validation problems, the same objects every time."""
        return list(self._fixed["validation"].values())

    @property
    def test(self) -> list[Problem]:
        """The test problems, the same objects every time."""
        return list(self._fixed["test"].values())

    def names(self, split: Split) -> list[str]:
        """The names of the problems of a split, such as ``test_000``.

        Raises:
            InputError: it is neither ``validation`` nor ``test``.
        """
        return list(self.problems(split))

    def problems(self, split: Split) -> dict[str, Problem]:
        """The problems of a split by their names.

        Raises:
            InputError: it is neither ``validation`` nor ``test``.
        """
        if split == "train":
            raise InputError(
                "split: expected validation or test, found train: its problems are endless"
            )
        check_choice("split", split, Split)
        return dict(self._fixed[split])

    def reference(self, problem: Problem) -> Reference:
        """The best known overflow and wirelength of a problem, and whether they are optimal.

        Raises:
            InputError: it is no validation or test problem of this scenario.
        """
        best = self.best(problem)
        return Reference(best.overflow, best.wirelength, best.proven)

    def best(self, problem: Problem) -> Best:
        """All that is known about the best solution of a problem.

        Raises:
            InputError: it is no validation or test problem of this scenario.
        """
        found = references_of(self.name).get(digest(problem))
        if found is None:
            raise InputError(
                f"problem: expected a validation or test problem of {self.name}, found another"
            )
        return found

    @functools.cached_property
    def largest(self) -> Problem:
        """A problem with at least as many nets and as much capacity as any of the scenario."""
        return self.level.largest()

    @functools.cached_property
    def _fixed(self) -> dict[Split, dict[str, Problem]]:
        """The validation and test problems by their names."""
        known: set[str] = set()
        fixed: dict[Split, dict[str, Problem]] = {}
        counts: dict[Split, int] = {"validation": self.level.validation, "test": self.level.test}
        for split, count in counts.items():
            fixed[split] = {}
            for number in range(count):
                problem = self._draw(f"{split}/{number}", known)
                known.add(digest(problem))
                fixed[split][f"{split}_{number:03d}"] = problem
        return fixed

    @functools.cached_property
    def _held_out(self) -> frozenset[str]:
        """The digests of the validation and test problems."""
        return frozenset(map(digest, (*self.validation, *self.test)))

    def _draw(self, key: str, excluded: Collection[str]) -> Problem:
        """Draws a problem that is not excluded; raises InputError after many attempts."""
        for attempt in range(ATTEMPTS):
            text = f"{self.name}/{key}/{attempt}"
            seed = int.from_bytes(hashlib.sha256(text.encode()).digest())
            problem = self.level.problem(np.random.default_rng(seed))
            if digest(problem) not in excluded and (not self.feasible or routable(problem)):
                return problem
        raise InputError(f"{self.name}: expected a problem that fits within {ATTEMPTS} attempts")


def routable(problem: Problem) -> bool:
    """Whether sequential A* finds a solution without overflow: then there certainly is one.

    Nets are routed as Steiner trees, to their own tree: short nets first, long nets first, then in
    orders drawn at random, up to :data:`ORDERS` in all.
    """
    rng = np.random.default_rng(0)
    orders: Iterator[Any] = itertools.chain(
        ("half_perimeter_up", "half_perimeter"),
        (rng.permutation(len(problem.nets)) for _ in range(ORDERS - 2)),
    )
    for order in orders:
        routed = sequential_astar(problem, order, target="tree", decomposition="steiner")
        if (routed.edge_demand <= problem.capacity).all():
            return True
    return False
