"""A scenario: an endless stream of training problems, and fixed ones to validate and test on.

Every problem is drawn from a seed of its own: the SHA-256 of a text such as
``two-pin-8x8-v0/test/7/0``, with the scenario, the split, the problem's place and the attempt.
Attempts are thrown away until a problem keeps three promises:

* It is not among the problems held out. No training problem is, under any seed, one of the
  validation and test problems (:func:`marouting.scenarios.digests.digest`), and these all differ;
  unless the scenario says otherwise, mirror images count as the same problem.
* The scenario accepts it. Most accept what is feasible, as far as :func:`routable` can tell:
  sequential A* has routed it without overflow, in one of :data:`ORDERS` net orders. So a few
  feasible problems are thrown away as well.
* It is no larger than the scenario's :attr:`Scenario.bounds`.
"""

import functools
import hashlib
import itertools
import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from marouting.config import between, check, of_key
from marouting.errors import InputError
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.problem.net import is_whole
from marouting.problem.problem import Problem
from marouting.rules import Agents
from marouting.scenarios.digests import digest, mirror_digest
from marouting.scenarios.references import Best, Reference, path_of, references_in
from marouting.search.astar import sequential_astar

Generator = Callable[[np.random.Generator], Problem]
"""Draws a problem with random numbers; all its problems have one grid shape."""

Split = Literal["train", "validation", "test"]  # the parts of a scenario
SPLITS: tuple[Split, ...] = get_args(Split)

_ARGUMENTS: dict[str, Any] = {
    "validation": Annotated[int, between(1, 100_000)],
    "test": Annotated[int, between(1, 100_000)],
    "open_cost": Annotated[float, between(0, 1e9)],
    "mirrors": bool,
    "env": dict[str, Any],
    "training": dict[str, Any],
}
"""What arguments of a scenario must be."""

PLAYED = ("problem", "scenario", "split")
"""The options that say which problems are played, not how; a scenario cannot suggest them."""

ORDERS = 8  # the most net orders in which A* tries to route a problem without overflow
ATTEMPTS = 1000  # the most attempts for one problem. None of the scenarios comes near it.


class Scenario:
    """Problems drawn by a generator.

    Args:
        name: its name, of letters, digits, _, . and -, with the version at the end.
        generator: what draws problems. They may differ in all but the shape of the grid.
        description: one sentence.
        validation: number of validation problems.
        test: number of test problems.
        accept: draws that it refuses are thrown away; None: it takes all.
        env: options of the environment (:class:`marouting.options.EnvOptions`) that are the
            defaults where the scenario is played.
        training: how a training on the scenario's problems runs
            (:class:`policies.learned.config.TrainOptions`), unless it is told otherwise.
        open_cost: what an open task costs, and a track of overflow, in edges of wire; see
            :meth:`cost`.
        mirrors: whether mirror images of a held-out problem are held out as well.
        largest: makes a problem with at least as many nets and pins and as much capacity as any
            that is drawn. None: draws with more of them than all validation and test problems are
            thrown away.
        references: the file with the references, which
            :func:`policies.experiment.references.solve_scenario` writes; None: that of the package.

    Attributes:
        name, generator, description, env, training, open_cost: as given.
        references: the file with the references, which need not be there.

    Raises:
        InputError: an argument cannot be used.
    """

    def __init__(
        self,
        name: str,
        generator: Generator,
        *,
        description: str = "",
        validation: int = 20,
        test: int = 40,
        accept: Callable[[Problem], bool] | None = None,
        env: Mapping[str, Any] | None = None,
        training: Mapping[str, Any] | None = None,
        open_cost: float = 20,
        mirrors: bool = True,
        largest: Callable[[], Problem] | None = None,
        references: str | os.PathLike[str] | None = None,
    ) -> None:
        given = {
            "validation": validation, "test": test, "open_cost": open_cost, "mirrors": mirrors,
            "env": env or {}, "training": training or {},
        }  # fmt: skip
        named = isinstance(name, str) and re.fullmatch(r"\w[\w.-]*", name)
        check("name", named, f"letters, digits, _, . and -, found {name!r}")
        for key, value in given.items():
            of_key(key, value, _ARGUMENTS[key])
        for key in PLAYED:
            check("env", key not in (env or {}), f"no key {key}: the scenario is what is played")
        if "agents" in (env or {}):
            of_key("env.agents", (env or {})["agents"], Agents)
        text = isinstance(description, str)
        check("description", text, f"a text, found {description!r}")
        functions = {"generator": generator, "accept": accept, "largest": largest}
        for key, function in functions.items():
            fits = callable(function) or (function is None and key != "generator")
            check(key, fits, f"a function, found {function!r}")
        path = references is None or isinstance(references, str | os.PathLike)
        check("references", path, f"a path, found {references!r}")
        self.name, self.generator, self.description = name, generator, description
        self.env, self.training = dict(env or {}), dict(training or {})
        self.open_cost = open_cost
        self._counts: dict[Split, int] = {"validation": validation, "test": test}
        self._accept, self._largest = accept, largest
        self._digest = mirror_digest if mirrors else digest
        self.references = path_of(name) if references is None else Path(references)

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
            self._draw(f"train/{int(seed)}/{number}", self._held_out, self._fits)
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

    def problems(self, split: Split) -> dict[str, Problem]:
        """The problems of a split by their names, such as ``test_000``.

        Raises:
            InputError: it is neither ``validation`` nor ``test``.
        """
        if split not in SPLITS[1:]:
            found = "train: its problems are endless" if split == "train" else repr(split)
            raise InputError(f"split: expected validation or test, found {found}")
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
            InputError: it is no validation or test problem of this scenario, or the scenario has no
                references.
        """
        known = references_in(self.references).references
        found = known.get(digest(problem))
        if found is None:
            check(f"{self.name}: references", known, "a file with them, see docs/scenarios.md")
            raise InputError(
                f"problem: expected a validation or test problem of {self.name}, found another"
            )
        return found

    def has_references(self, split: Split) -> bool:
        """Whether the problems of ``validation`` or ``test`` have references.

        Raises:
            InputError: some have one, but not all.
        """
        known = references_in(self.references).references
        lacks = [
            name for name, problem in self.problems(split).items() if digest(problem) not in known
        ]
        what = f"those of all problems, or none, found none of {len(lacks)} of {split}"
        check(f"{self.name}: references", not known or not lacks, what)
        return bool(known)

    def cost(self, wirelength: float, open_tasks: float, overflow: float = 0) -> float:
        """What routes cost: their wirelength, and :attr:`open_cost` for every open task.

        A track of overflow costs as much as an open task. The scenarios of policies have none.
        The cost of a policy is the sum over the problems, divided by :meth:`reference_cost`.
        """
        return wirelength + self.open_cost * (open_tasks + overflow)

    def reference_cost(self, split: Split = "test") -> float:
        """What the references of all problems of a split cost together.

        Raises:
            InputError: the scenario has no references.
        """
        found = map(self.reference, self.problems(split).values())
        return sum(self.cost(best.wirelength, 0, best.overflow) for best in found)

    def score(self, cost: float, split: Split = "test") -> float:
        """The score of a policy: 0 for the best local rule, 1 for the optimum, the more the better.

        Args:
            cost: the policy's :meth:`cost` on all problems of the split, divided by that of the
                references.
            split: ``validation`` or ``test``.

        Raises:
            InputError: the best local rule is not known for this scenario and split.
        """
        rule = self.local_rule(split)
        return (rule - cost) / (rule - 1)

    def local_rule(self, split: Split = "test") -> float:
        """The cost of the best local rule, which has the score 0; raises InputError if unknown."""
        rule = references_in(self.references).heuristic.get(split)
        if rule is None:  # see has_local_rule
            raise InputError(f"{self.name}: expected a scenario with a known best local rule")
        return rule

    def has_local_rule(self, split: Split) -> bool:
        """Whether the cost of the best local rule is known, from which :meth:`score` counts."""
        return split in references_in(self.references).heuristic

    @property
    def grid(self) -> tuple[int, int, int]:
        """Columns, rows and layers of Gcells, the same in all problems."""
        return self.bounds[0].grid

    @functools.cached_property
    def bounds(self) -> list[Problem]:
        """Problems that, together, have as many nets and pins and as much capacity as any drawn."""
        if self._largest is not None:
            largest = self._of_user("largest", self._largest)
            what = f"a Problem, found {largest!r}"
            check(f"{self.name}: largest", isinstance(largest, Problem), what)
            return [largest]
        return [*self.validation, *self.test]

    @functools.cached_property
    def _most(self) -> NDArray[np.integer]:
        """What no training problem has more of; see :func:`_size`."""
        return np.max([_size(problem) for problem in self.bounds], axis=0)

    @functools.cached_property
    def _fixed(self) -> dict[Split, dict[str, Problem]]:
        """The validation and test problems by their names."""
        twice = [digest(self._generated("test/0", 0)) for _ in range(2)]
        what = "the same problem for the same random numbers, found two"
        check(f"{self.name}: generator", twice[0] == twice[1], what)
        known: set[str] = set()
        fixed: dict[Split, dict[str, Problem]] = {}
        for split, count in self._counts.items():
            fixed[split] = {}
            for number in range(count):
                problem = self._draw(f"{split}/{number}", known, self._accepts)
                known.add(self._digest(problem))
                fixed[split][f"{split}_{number:03d}"] = problem
        grids = {problem.grid for problems in fixed.values() for problem in problems.values()}
        if len(grids) > 1:
            shapes = " and ".join(str(grid) for grid in sorted(grids)[:2])
            raise InputError(f"{self.name}: expected problems with one grid shape, found {shapes}")
        return fixed

    @functools.cached_property
    def _held_out(self) -> frozenset[str]:
        """The digests of the validation and test problems."""
        return frozenset(map(self._digest, (*self.validation, *self.test)))

    def _fits(self, problem: Problem) -> bool:
        """Whether a training problem is accepted and within the bounds."""
        check(f"{self.name}: grid", problem.grid == self.grid, f"{self.grid} in all problems")
        if self._largest is None and (_size(problem) > self._most).any():
            return False
        return self._accepts(problem)

    def _accepts(self, problem: Problem) -> bool:
        return self._accept is None or bool(self._of_user("accept", self._accept, problem))

    def _of_user(self, name: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """What a function of the user's returns; raises InputError if it raises any error."""
        try:
            return function(*arguments)
        except InputError:
            raise
        except Exception as error:
            raise InputError(
                f"{self.name}: {name}: expected no error, found {type(error).__name__}: {error}"
            ) from error

    def _generated(self, key: str, attempt: int) -> Problem:
        """What the generator draws."""
        seed = int.from_bytes(hashlib.sha256(f"{self.name}/{key}/{attempt}".encode()).digest())
        problem = self._of_user("generator", self.generator, np.random.default_rng(seed))
        found = f"a Problem, found {problem!r}"
        check(f"{self.name}: generator", isinstance(problem, Problem), found)
        return cast(Problem, problem)

    def _within_largest(self, problem: Problem) -> Problem:
        """The problem; raises InputError if ``largest`` was given and the problem is larger."""
        if self._largest is not None:
            fits = problem.grid == self.grid and (_size(problem) <= self._most).all()
            largest, found = (
                (each.grid, *_size(each).tolist()) for each in (self.bounds[0], problem)
            )
            what = f"a grid, nets, pins and tracks as in all draws, found {largest} and {found}"
            check(f"{self.name}: largest", fits, what)
        return problem

    def _draw(
        self, key: str, excluded: Collection[str], fits: Callable[[Problem], bool]
    ) -> Problem:
        """Draws a problem that is not excluded; raises InputError after many attempts."""
        known = 0
        for attempt in range(ATTEMPTS):
            problem = self._generated(key, attempt)
            if self._digest(problem) in excluded:
                known += 1
            elif problem.to_route.any() and fits(problem):
                return self._within_largest(problem)
        raise InputError(
            f"{self.name}: the generator draws too few different problems that fit: {known} of "
            f"{ATTEMPTS} draws equal a validation or test problem or its mirror image, and "
            f"{ATTEMPTS - known} have nothing to route, are refused by accept or are larger than "
            "all of those; lower validation and test, or draw more varied problems"
        )


def _size(problem: Problem) -> NDArray[np.integer]:
    """(3,) nets, pins, and tracks of the widest edge; vias do not count."""
    tracks = problem.capacity.reshape(-1, AXES)[:, :VIA_AXIS].max()
    return np.array([len(problem.nets), len(problem.gcell_of_pins), tracks])


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
