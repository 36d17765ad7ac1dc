"""Trained networks that play: in a loop over the environment, and on whole problems."""

import contextlib
import functools
import os
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, NotRequired, TypedDict

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from marouting import EnvOptions, InputError, PolicyResult, Problem, Solution, evaluate_policy
from marouting.batch.engine import Engine
from marouting.batch.prices import Negotiation
from marouting.config import MOST, allowing_code_of, between, build, check, component, plain
from marouting.observations import has_move_order, move_order_of
from marouting.options import ORDERS, PLAYED
from marouting.player import Player
from marouting.registry import allowing_code
from marouting.scenarios import Split
from marouting.source import ProblemSampler
from policies.learned import greedy
from policies.learned.checkpoint import checked, read_checkpoint
from policies.learned.learner import best_moves, play_steps
from policies.results.run_folder import TrainingFigures


def player_of(
    env: EnvOptions,
    problems: Sequence[Problem] | ProblemSampler,
    negotiation: Negotiation | None = None,
    *,
    trains: bool = False,
) -> Player:
    """A player of the game that a configuration's ``env`` describes, for networks.

    Args:
        env: the options.
        problems: the problems, or what games draw theirs from.
        negotiation: how nets negotiate; None: they do not.
        trains: whether a learner is to see what each agent is paid, also those that wait for their
            turn: then each has a row in sequential order as well, with ``agents: multi``.

    Raises:
        InputError: the problems do not go together.
    """
    draws = problems if isinstance(problems, ProblemSampler) else None
    room = draws.episodes.room if draws else None
    held = problems.problems.tolist() if isinstance(problems, ProblemSampler) else problems
    engine = Engine(
        held,
        env,
        room=room,
        negotiation=negotiation,
        turn_order=env.turn_order or ORDERS[env.agents],
    )
    observation, reward = env.observation.make(), env.reward.make()
    everyone = env.agents == "multi" and (trains or not engine.static.sequential)
    return Player(engine, observation, reward, everyone=everyone, draws=draws, reorder_moves=True)


def check_weights(weights: Mapping[str, Any], module: nn.Module) -> None:
    """Raises InputError unless weights from a file are those of a network."""
    expected = module.state_dict()
    if weights.keys() != expected.keys():
        raise InputError(f"expected {', '.join(expected)}, found {', '.join(map(str, weights))}")
    for name, tensor in expected.items():
        _ = checked(weights[name], tensor, name)


def policy_origin(episodes: int) -> str:
    """What tables call routes that a network walks without exploration."""
    return f"policy after {episodes} episodes, greedy"


@dataclass(frozen=True)
class Routed:
    """A solution and where it is from; see :class:`policies.routers.base.Routed`."""

    solution: Solution
    report: dict[str, Any]


class _Saved(TypedDict):
    """What a file of trained networks holds beside their weights."""

    names: list[str]
    episodes: list[Annotated[int, between(0, MOST)]]
    obs_shape: tuple[Annotated[int, between(1, MOST)], ...]
    env: EnvOptions
    learner: dict[str, Any]
    negotiation: NotRequired[Negotiation | None]
    figures: NotRequired[TrainingFigures]


class TrainedPolicy:
    """A trained network that always takes the move that it rates highest.

    Args:
        module: the network: (B, *S) float32 observations to (B, A) ratings.
        masking: whether it chooses only among the moves that cross an edge.
        obs_shape: S.
        env: the game that it was trained in.
        origin: where it is from, for reports.
        negotiation: its prices; None: none.
        training: what its training took, as :class:`policies.results.run_folder.TrainingFigures`.
        learner: the name of what learned it.
        network: the network's kind and options, as in a configuration; None: not known.
    """

    def __init__(
        self,
        module: nn.Module,
        masking: bool,
        obs_shape: tuple[int, ...],
        env: EnvOptions,
        origin: str = "",
        negotiation: Negotiation | None = None,
        training: Mapping[str, Any] | None = None,
        learner: str = "",
        network: Any = None,
    ) -> None:
        self.training, self.learner, self.network = dict(training or {}), learner, network
        self.module, self.masking = module, masking
        self.obs_shape, self.env, self.origin = obs_shape, env, origin
        self.negotiation = negotiation
        self._observation = env.observation.make()

    @staticmethod
    def load(
        path: str | os.PathLike[str], name: str | None = None, *, allow_code: bool = False
    ) -> "TrainedPolicy":
        """The policy in a file of trained networks, or in the checkpoint of a training.

        Args:
            path: the file.
            name: the problem whose network to take, where the file holds several.
            allow_code: whether the file may name its learner, network, observation and reward as
                ``module:Class``, which is code that is imported.

        Raises:
            InputError: the file cannot be used, names code that it may not, or holds several
                networks and none of that name.
        """
        where = os.fspath(path)
        with allowing_code(allow_code):
            state = read_checkpoint(path, training=False)
        kept = build(_Saved, state, where)
        names, env, obs_shape = kept["names"], kept["env"], kept["obs_shape"]
        learner = component("learner", kept["learner"], where=f"{where}: learner")
        weights: Any = state.get("weights")
        fits = isinstance(weights, list) and len(names) == len(weights) == len(kept["episodes"]) > 0
        check(f"{where}: weights", fits, "a network for each name")
        if len(names) > 1 and name not in names:
            known = textwrap.shorten(str(names), 80)
            raise InputError(f"{where}: expected the name of a problem in {known}, found {name}")
        row = names.index(name) if name in names else 0
        try:
            make = functools.partial(learner.cls.network, learner.options, obs_shape, env.actions)
            # First without memory, whatever sizes the file names; not every network can be made so.
            with contextlib.suppress(RuntimeError), torch.device("meta"):
                check_weights(weights[row], make())
            module = make()
            check_weights(weights[row], module)
            module.load_state_dict(weights[row])
            masking = learner.cls.masks(learner.options)
        except (InputError, RuntimeError, AttributeError, TypeError, ArithmeticError) as error:
            reason = " ".join(str(error).split())[:120]
            raise InputError(f"{where}: weights do not fit the network: {reason}") from None
        origin = policy_origin(kept["episodes"][row])
        about = kept.get("negotiation"), asdict(kept.get("figures") or TrainingFigures())
        network = plain(getattr(learner.options, "network", None))
        return TrainedPolicy(module, masking, obs_shape, env, origin, *about, learner.name, network)

    def act(self, observation: NDArray[np.float32], mask: NDArray[np.int8]) -> int:
        """The best of the moves for an observation (*S) and mask (A,) of an environment."""
        return int(self.moves(observation[None], mask[None])[0])

    def moves(
        self, observations: NDArray[np.float32], masks: NDArray[np.int8]
    ) -> NDArray[np.int16]:
        """(K,) int16 best moves for observations (K, *S) and masks (K, A) of environments.

        Masks and moves are those of the grid, also where the network chooses among an observation's
        own moves.

        Raises:
            InputError: the observations are of another shape than those of the training.
        """
        observations = np.asarray(observations, np.float32)
        what = f"shape ({', '.join(map(str, ('K', *self.obs_shape)))}), found {observations.shape}"
        check("observations", observations.shape[1:] == self.obs_shape, what)
        with torch.no_grad():
            ratings = self.module(torch.from_numpy(observations))
        if not has_move_order(self._observation):
            return best_moves(ratings, masks if self.masking else None)
        order = move_order_of(self._observation, observations, self.env.actions, self.env.messages)
        turned = np.take_along_axis(masks, order, -1)
        best = best_moves(ratings, turned if self.masking else None)
        return np.take_along_axis(order, best[:, None].astype(np.int64), -1)[:, 0].astype(np.int16)

    def _rate(self, seen: Tensor) -> Tensor:
        """Ratings for :func:`.play_steps`, by one network."""
        ratings: Tensor = self.module(seen[0])[None]
        return ratings

    def evaluate(self, scenario: str, split: Split = "test") -> PolicyResult:
        """Its figures on a split of a scenario, in the game that it was trained in.

        Raises:
            InputError: see :func:`marouting.evaluate_policy`.
        """
        with allowing_code_of(self.env):
            return evaluate_policy(self.moves, scenario, split, **self.options)

    @property
    def options(self) -> dict[str, Any]:
        """The options of the environment in which it was trained."""
        options: dict[str, Any] = plain(self.env)
        for name in (*PLAYED, "agents"):
            del options[name]
        return {**options, "turn_order": self.env.turn_order or ORDERS[self.env.agents]}

    @property
    def parameters(self) -> int:
        """The number of its network's parameters."""
        return sum(one.numel() for one in self.module.parameters())

    def check(self, problem: Problem) -> Player:
        """A player of a problem, with the options that the policy was trained with.

        Raises:
            InputError: the game shows observations of another shape than the network was trained
                on.
        """
        player = player_of(self.env, [problem], self.negotiation)
        shape = player.buffers.obs.shape[2:]
        if shape != self.obs_shape:
            raise InputError(
                f"checkpoint: expected observations of shape {shape}, "
                f"found a network for {self.obs_shape}"
            )
        return player

    def solve(self, problem: Problem) -> Routed:
        """The policy's routes for a problem, with the options that it was trained with.

        Raises:
            InputError: the game shows observations of another shape than the network was trained
                on.
        """
        player = self.check(problem)
        player.reset()
        layers = greedy.layers_of(player, self.module, masking=self.masking)
        if layers is not None:
            weights = nn.utils.parameters_to_vector(self.module.parameters()).detach()
            greedy.play_out(player, layers, weights[None].numpy(), masking=self.masking)
        else:
            for _ in play_steps(player, self._rate, masking=self.masking):
                pass
        return Routed(player.engine.solution(), {"from": self.origin})

    def play(self, problem: Problem) -> Iterator[Engine]:
        """The game of :meth:`solve`.

        Yields:
            The same engine at the beginning and after every step.

        Raises:
            InputError: as :meth:`solve` does.
        """
        player = self.check(problem)
        player.reset()
        yield player.engine
        for _ in play_steps(player, self._rate, masking=self.masking):
            yield player.engine
