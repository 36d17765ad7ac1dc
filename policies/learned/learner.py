"""The interface of learners, which is all that the trainer knows about DQN, PPO or others.

A learner plays a :class:`marouting.player.Player` and learns from the results. The player
translates moves and masks if the observation has its own order of moves
(:func:`marouting.observations.move_order_of`). It has L networks: one
for each problem, or one that all problems share.
"""

import abc
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm
from torch.nn.modules.dropout import _DropoutNd

from marouting.config import Component, check
from marouting.errors import InputError
from marouting.game import NOBODY
from marouting.options import Agents
from marouting.player import Player
from marouting.problem.grid import MOVES
from policies.learned import greedy
from policies.learned.counter_rng import keys
from policies.learned.memory.pre_step import PreStep
from policies.learned.networks.stack import Stack
from policies.learned.per_network import COUNT, PerNetworkState


@dataclass(frozen=True)
class Setup:
    """The inputs of a learner.

    Attributes:
        names: names of its L networks: those of the problems, or ``("all",)`` for a shared one.
            Random numbers depend on the names, not on the other networks.
        games: number of games in the player, a multiple of L. Game m belongs to network
            ``m // (games // L)``.
        rows: K, rows of a game in the step buffers.
        obs_shape: of what one agent sees.
        state_shape: of one game's global state.
        player: the player that it will play, for rules about the game.
        seed: seed of the random numbers.
        device: device of the networks.
        threads: number of threads that it may use.
        episodes: of the whole training, per problem, for schedules.
        game_names: (games,) names of the problems, for random numbers.
    """

    names: tuple[str, ...]
    games: int
    rows: int
    obs_shape: tuple[int, ...]
    state_shape: tuple[int, ...]
    player: Player
    seed: int
    device: torch.device
    threads: int
    episodes: int
    game_names: tuple[str, ...]

    @property
    def actions(self) -> int:
        """A, how many actions an agent has."""
        return self.player.engine.actions

    @property
    def pays_late(self) -> bool:
        """Whether agents may be paid when they are done: others than the mover, by the reward."""
        fast = self.player.fast
        return self.player.everyone and (fast.pays_others is not None or not fast.pays_prices)

    def network_keys(self, purpose: str) -> NDArray[np.uint64]:
        """(L,) keys of random numbers, one per network."""
        return keys(self.seed, self.names, purpose)

    def game_keys(self, purpose: str) -> NDArray[np.uint64]:
        """(L, games / L) keys of random numbers, one per game."""
        return keys(self.seed, self.game_names, purpose).reshape(len(self.names), -1)


class Learner(PerNetworkState, abc.ABC):
    """L networks with their optimisers and memories.

    A subclass is a component of the kind ``learner``: its attribute ``Options`` is a dataclass with
    the fields ``network``, a component, and ``masking``, whether only moves that cross an edge are
    chosen.

    Args:
        setup: what it starts with.
        options: an instance of its ``Options``.

    Attributes:
        networks: those that choose moves, the ones that are saved.
        updates: (L,) int64 gradient steps taken.
        loss: (L,) float64 sum of the losses of all gradient steps.
        backend: how it computes, for the log.
        learning_starts: transitions that each network must have seen before it plays.
        burn_in: who plays until then, see :func:`policies.learned.burn_in.guide`.
    """

    Options: ClassVar[type[Any]]
    agents: ClassVar[Agents | None] = None
    """The only ``env.agents`` that it is for; None: it is for both."""

    endless: ClassVar[Mapping[str, Any]] = {}
    """Defaults of options that differ when problems are endless."""

    rows: ClassVar[tuple[str, ...]] = ("updates", "loss")
    backend: str = "torch"
    learning_starts: int = 0
    burn_in: str = "random"
    networks: Stack
    updates: NDArray[np.int64]

    def __init__(self, setup: Setup, options: Any) -> None:
        self.setup, self.options = setup, options
        self.device = setup.device
        count = len(setup.names)
        self.updates = np.zeros(count, np.int64)
        self.loss = torch.zeros(count, dtype=torch.float64, device=setup.device)

    def limits(self) -> dict[str, tuple[float, float]]:
        """See :meth:`.PerNetworkState.limits`."""
        return {**super().limits(), "updates": COUNT}

    @classmethod
    def start(cls, setup: Setup, options: Any) -> "Learner":
        """The learner for a setup; another class may be quicker where it applies."""
        return cls(setup, options)

    @classmethod
    def network(cls, options: Any, obs_shape: tuple[int, ...], actions: int = MOVES) -> nn.Module:
        """One of its networks, with random weights, for those that are saved to go into."""
        return new_network(options, obs_shape, actions)

    def _stack(self, purpose: str, sees: tuple[int, ...], outputs: int) -> Stack:
        """Its networks with random weights, by random numbers of their own for a purpose."""
        seeds = self.setup.network_keys(purpose).astype(np.int64).tolist()
        stack = Stack(lambda: new_network(self.options, sees, outputs), seeds, self.device)
        zeros = torch.zeros(len(seeds), 1, *sees, device=self.device)
        try:
            stack.view.gradient(stack.view(zeros).sum(), torch.empty_like(stack.flat))
        except RuntimeError as error:  # such as of torch.func.vmap about a recurrent layer
            reason = str(error).splitlines()[0]
            several = "; train.shared=true needs no torch.func.vmap" if len(seeds) > 1 else ""
            raise InputError(f"learner.network: it cannot be trained: {reason}{several}") from None
        return stack

    @classmethod
    def masks(cls, options: Any) -> bool:
        """Whether only moves that cross an edge are chosen: ``masking`` among the options."""
        return bool(getattr(options, "masking", False))

    @property
    def stored(self) -> NDArray[np.int64]:
        """(L,) transitions ever taken in; the burn-in ends with :attr:`learning_starts` of them."""
        return np.zeros(len(self.updates), np.int64)

    def exploration(self, episode: int) -> float:  # noqa: ARG002
        """The chance of a random move in an episode (counted from 0), for logs."""
        return 0.0

    def set_episodes(self, episodes: NDArray[np.int64]) -> None:
        """Takes note of the episode (games,) that each game is in, for schedules."""

    def begin(self, weights: Sequence[Mapping[str, Tensor]]) -> None:
        """Begins with other weights than random ones.

        Args:
            weights: the ``state_dict`` of each of its L networks, of the same shapes.
        """
        for row, state in enumerate(weights):
            self.networks.take(row, state)

    def observe(self, player: Player, before: PreStep) -> None:
        """Takes in what came of the player's last step, whose moves a guide of the burn-in chose.

        Learners with :attr:`learning_starts` have one; others are not called.
        """

    @abc.abstractmethod
    def play(self, player: Player, steps: int) -> None:
        """Plays and learns.

        Args:
            player: played by the learner's moves.
            steps: how many at most; it returns after one in which an episode ended.
        """

    def play_greedily(self, player: Player, networks: NDArray[np.int64]) -> None:
        """Plays the games of a player to their end, without exploration.

        Args:
            player: of M games, whose episodes have just begun. In sequential order it has one row a
                game, that of the agent whose turn it is.
            networks: (R,) the rows of the networks that play M/R games each, one network's after
                another's.
        """
        masking = self.masks(self.options)
        layers = greedy.layers_of(player, self.networks.module, masking=masking)
        if layers is not None and self.device.type == "cpu":
            weights = self.networks.flat.numpy()[networks]
            greedy.play_out(player, layers, weights, masking=masking)
            return
        view = self.networks.part(networks)
        for _ in play_steps(
            player,
            lambda seen: view(seen.to(self.device)),
            networks=len(networks),
            masking=masking,
        ):
            pass

    def _games(self, array: NDArray[Any]) -> NDArray[Any]:
        """An array with one row per game as (L, games / L, …)."""
        return array.reshape(len(self.updates), -1, *array.shape[1:])


def play_steps(
    player: Player, rate: Callable[[Tensor], Tensor], *, networks: int = 1, masking: bool
) -> Iterator[None]:
    """Plays the games of a player to their end, always by the move that is rated highest.

    Args:
        player: of M games, whose episodes have begun.
        rate: (L, B, *S) float32 observations to (L, B, A) ratings of the actions, by L networks.
        networks: L, how many networks play M/L games each, one network's after another's.
        masking: whether only moves that cross an edge are chosen.

    Yields:
        After every step.
    """
    b = player.buffers
    while b.active.any():
        movers = player.movers
        where, seen = by_network(networks, b.obs, movers)
        with torch.no_grad():
            ratings = rate(torch.from_numpy(seen))[torch.from_numpy(where)]
        b.actions[:] = NOBODY
        b.actions[movers] = best_moves(ratings, b.mask[movers] if masking else None)
        player.step()
        yield


def by_network(
    networks: int, rows: NDArray[np.float32], which: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Some rows of games, side by side for networks that each play as many games.

    Args:
        networks: L.
        rows: (M, K, …) of all games.
        which: (M, K) which of them.

    Returns:
        (L, B) where there is a row, and (L, B, …) the rows in the order of ``which``, else zeros.
    """
    counts = which.reshape(networks, -1).sum(axis=1)
    where = np.arange(counts.max(initial=0)) < counts[:, None]
    out = np.zeros((*where.shape, *rows.shape[2:]), np.float32)
    out[where] = rows[which]
    return where, out


def best_moves(outputs: Tensor, mask: NDArray[np.int8] | None) -> NDArray[np.int16]:
    """(B,) the moves of the highest outputs (B, A), within a mask (B, A) if there is one."""
    values = outputs.detach().cpu().numpy()
    if mask is not None:
        values = np.where(mask == 0, -np.inf, values)
    return values.argmax(axis=1).astype(np.int16)


def check_network(options: Any) -> None:
    """Raises InputError if a learner's options name a network that is none of PyTorch's modules."""
    named = getattr(options, "network", None)
    if isinstance(named, Component) and not issubclass(named.cls, nn.Module):
        raise InputError(
            f"learner.network: expected a class derived from torch.nn.Module, found {named.name}"
        )


def new_network(options: Any, sees: tuple[int, ...], outputs: int) -> nn.Module:
    """A network with random weights, in evaluation mode, in which it also learns.

    Raises:
        InputError: it has no parameters, or some that are not trained or that layers share; layers
            that work differently in training; or a buffer that is random: trainings save parameters
            only, and make the buffers again.
    """
    module: nn.Module = options.network.make(sees, outputs).eval()
    own = dict(module.named_parameters())
    check("learner.network", own, "parameters to train, found none")
    for name, weight in module.named_parameters(remove_duplicate=False):
        what = f"parameters that are all trained, found {name}, which is not; make it a buffer"
        check("learner.network", weight.requires_grad, what)
        check("learner.network", name in own, f"no parameters that layers share, found {name}")
    for layer in module.modules():
        alike = not isinstance(layer, _DropoutNd | _BatchNorm)
        what = f"layers that work alike in training and in play, found {type(layer).__name__}"
        check("learner.network", alike, what)
    if any(True for _ in module.buffers()):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(_OTHER_SEED)
            twin: nn.Module = options.network.make(sees, outputs)
        for (name, buffer), other in zip(module.named_buffers(), twin.buffers(), strict=True):
            what = f"buffers without random numbers, found {name}; make it a parameter"
            check("learner.network", torch.equal(buffer, other), what)
    what = f"one from ({', '.join(map(str, ('B', *sees)))}) to (B, {outputs})"
    try:
        with torch.no_grad():
            shape = getattr(module(torch.zeros(2, *sees)), "shape", None)
    except Exception as error:  # whatever a user's network raises
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"learner.network: expected {what}: {reason}") from error
    check(
        "learner.network", shape == (2, outputs), f"{what}, found {shape and (*shape,)} for B = 2"
    )
    return module


_OTHER_SEED = 6007
"""Any seed but those of networks, which are drawn."""
