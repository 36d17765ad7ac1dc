"""The DQN as a policy in a loop over the environment, and as a router of problems."""

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from marouting import Engine, EnvOptions, InputError, Problem, Solution
from marouting.config import build
from marouting.game.state import NOBODY
from marouting.options import ORDERS
from marouting.problem.grid import MOVES
from policies.learned.checkpoint import read_checkpoint
from policies.learned.config import Config
from policies.learned.qnetwork import Layers, count, forward
from policies.learned.trainer import Episode, Trainer


class QPolicy:
    """A trained Q-network that always takes the move of the highest value.

    Args:
        sizes: units of the layers, inputs first.
        weights: (P,) float32.
        masking: whether to choose among the moves that cross an edge only.
        env: the game that the network was trained in.
    """

    def __init__(
        self, sizes: tuple[int, ...], weights: torch.Tensor, masking: bool, env: EnvOptions
    ) -> None:
        self.sizes = sizes
        self.masking = masking
        self.env = env
        self._layers = Layers.of(weights.reshape(1, -1), sizes)

    @staticmethod
    def load(path: str | os.PathLike[str], name: str | None = None) -> "QPolicy":
        """The policy in a checkpoint or policy file.

        Args:
            path: the file.
            name: the problem whose network to take, where the file holds several.

        Raises:
            InputError: the file cannot be used, or holds several networks and none of that name.
        """
        where = os.fspath(path)
        state = read_checkpoint(path)
        try:
            names, weights = list(state["names"]), state["weights"]
            sizes = tuple(int(size) for size in state["sizes"])
            masking, plain = bool(state["masking"]), state["env"]
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{where}: expected a whole checkpoint: {error!r}") from None
        env = build(EnvOptions, plain, where) if isinstance(plain, Mapping) else EnvOptions()
        if len(sizes) < 2:
            raise InputError(f"{where}: sizes: expected two or more, found {sizes}")
        expected = (len(names), count(sizes))
        if (
            not isinstance(weights, torch.Tensor)
            or weights.dtype != torch.float32
            or weights.shape != expected
            or not names
            or min(sizes) < 1
            or sizes[-1] != MOVES
        ):
            shape = tuple(getattr(weights, "shape", ()))
            raise InputError(f"{where}: weights: expected shape {expected}, found {shape}")
        if len(names) > 1 and name not in names:
            raise InputError(f"{where}: expected a problem named as one of {names}, found {name}")
        row = names.index(name) if name in names else 0
        return QPolicy(sizes, weights[row], masking, env)

    def act(self, observation: NDArray[np.float32], mask: NDArray[np.int8]) -> int:
        """The best move; see :class:`policies.routers.base.Policy`."""
        return int(self.moves(observation[None], mask[None])[0])

    def moves(self, observations: NDArray[np.float32], masks: NDArray[np.int8]) -> NDArray[np.int8]:
        """(K,) int8 best moves for observations (K, F) and masks (K, 6)."""
        with torch.no_grad():
            values = forward(self._layers, torch.from_numpy(observations)[None])[-1][0].numpy()
        if self.masking:
            values[masks == 0] = -np.inf
        return values.argmax(axis=1).astype(np.int8)

    def route(self, problem: Problem) -> Solution:
        """The routes that the policy walks on a problem, in the game that it was trained in.

        Raises:
            InputError: the network sees another number of features than the game shows.
        """
        env = self.env
        everyone = env.agents == "multi"
        engine = Engine([problem], env, turn_order=env.turn_order or ORDERS[env.agents])
        seen_as = env.observation.make()
        (features,) = seen_as.space(engine.problems, env.overflow == "allowed").shape
        if features != self.sizes[0]:
            raise InputError(f"checkpoint: expected {features} inputs, found {self.sizes[0]}")
        while engine.games[0]["agent"] != NOBODY:
            pairs = engine.pairs(everyone)
            seen = np.empty((len(pairs[1]), features), np.float32)
            seen_as.write(engine, *pairs, seen)
            moves = self.moves(seen, engine.masks(*pairs))
            engine.step(moves[None] if everyone else moves)
        return engine.solution()


class DQNRouter:
    """Routes a problem with a DQN: a trained one, or one trained on the problem (the paper).

    Args:
        config: what to train; its ``env.problem`` and ``out`` do not matter here.
        checkpoint: a trained policy to walk with; None trains on every problem anew.
        watch: called with the episodes of a training as they end.
        network: the problem whose network to take from a checkpoint that holds several.
    """

    name = "dqn"

    def __init__(
        self,
        config: Config | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        watch: Callable[[list[Episode]], Any] | None = None,
        network: str | None = None,
    ) -> None:
        self.config = config or Config()
        self.policy = None if checkpoint is None else QPolicy.load(checkpoint, network)
        self._watch = watch

    def route(self, problem: Problem) -> Solution:
        """The best episode's routes, or those that the checkpoint's policy walks."""
        if self.policy is not None:
            return self.policy.route(problem)
        config = replace(self.config, train=replace(self.config.train, tensorboard=False))
        trainer = Trainer({"problem": problem}, config)
        for episodes in trainer.run():
            if episodes and self._watch is not None:
                self._watch(episodes)
        return trainer.solutions()["problem"]
