"""The training loop: M problems side by side, from burn-in to solutions, checkpointed.

One loop serves both ways to play, and every learner. With ``agents: single`` each game moves the
net whose turn it is, one transition per step (the paper); with ``agents: multi`` all its nets move
at once, and the network that the nets share learns from all their transitions. Either way every
problem has its own network and random numbers; playing them together only saves time. With
``shared: true`` there is one network for all problems, and with ``games`` as well, every episode
may be that of another problem.
"""

import functools
import math
import textwrap
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from marouting import InputError, Problem, Solution
from marouting.batch.state import Dynamic
from marouting.batch.step import StepBuffers
from marouting.config import check
from marouting.game import NOBODY
from marouting.observations import state_space_of
from marouting.player import Player, Saved
from marouting.source import ProblemSampler
from policies.learned.burn_in import GUIDES, guide, read_solutions
from policies.learned.checkpoint import (
    ANY,
    FINITE,
    TRAINING_FORMAT,
    as_rows,
    checked,
    from_rows,
)
from policies.learned.config import Config
from policies.learned.exploration import Exploration
from policies.learned.learner import Learner, Setup, check_network
from policies.learned.machine import torch_device, use_threads
from policies.learned.memory.pre_step import PreStep
from policies.learned.per_network import COUNT
from policies.learned.policy import TrainedPolicy, player_of
from policies.learned.saved import SavedNetworks, routes_score
from policies.results.rows import LARGEST
from policies.results.run_folder import Episode, GreedyEvaluation

SHARED = ("all",)
"""The name of the network that all problems share, where there is one."""

_STEPS = 200
"""The most steps between two looks at a clock or for an interrupt."""

_LOOK = 0.05
"""Seconds between these looks, if a step of all games and what is learned from it take less."""


class Trainer:
    """Trains a learner on M problems of one grid shape, or on problems that games draw.

    Args:
        problems: the problems by name. Where games draw theirs, those that the network is evaluated
            on.
        config: what to do.
        draws: what games draw their problems from; None: every problem has games of its own.

    Attributes:
        config: what to do.
        problems: the problems by name.
        names: their names.
        learner: what learns.
        player: the games: of each problem its copies one after another.
        episodes: (M,) int64, episodes finished; where games draw their problems (1,), of all games.
        steps: likewise, the moves that agents have made, in games that go on as well.
        drawn: whether games draw their problems.
        spent: the share of ``train.seconds`` that has passed, by ``clock``.
        clock: tells that share; by default no time is limited.
        score: (M, 3) of the best episode of each problem, less is better; infinite before one has
            ended. Empty where games draw their problems, as are the next two.
        best_episode: (M,) int64, which episode that was, from 0, or NOBODY.
        best: its routes, or None.
        backend: what computes the learner, in words.
        evaluations: the evaluations made since :meth:`run` last yielded.
        saved: the networks that are saved.

    Raises:
        InputError: the problems do not go together, the device is not there, or the learner does
            not fit the game.
    """

    def __init__(
        self, problems: Mapping[str, Problem], config: Config, draws: ProblemSampler | None = None
    ) -> None:
        self.config, self.problems, self.names = config, dict(problems), tuple(problems)
        train, learner = config.train, config.learner
        use_threads(train.threads)
        device = torch_device(train.device)
        # What needs no game is checked first.
        if not issubclass(learner.cls, Learner):
            raise InputError(
                f"learner: expected a class derived from {Learner.__module__}.Learner, "
                f"found {learner.name}"
            )
        check_network(learner.options)
        self.drawn = drawn = draws is not None
        check("train.games", drawn or train.games is None, "null: its problems are fixed")
        self._evaluator = player_of(config.env, list(problems.values()), config.train.negotiation)
        engine, count = self._evaluator.engine, 1 if drawn else len(self.names)
        source: Any = draws
        if draws is not None:
            self._copies = len(draws.counts)
            side_by_side = getattr(learner.options, "num_envs", 1)
            usual = side_by_side == getattr(type(learner.options), "num_envs", 1)
            check("learner.num_envs", usual, "no number beside train.games, which replaces it")
        else:
            self._copies = int(getattr(learner.options, "num_envs", 1))
            source = [problem for problem in problems.values() for _ in range(self._copies)]
        self.player = player_of(config.env, source, train.negotiation, trains=True)
        b = self.player.buffers
        shapes = [p.buffers.obs.shape[2:] for p in (self._evaluator, self.player)]
        what = f"the same shape for all problems, found {shapes[0]} and {shapes[1]}"
        check("env.observation", shapes[0] == shapes[1], what)
        self.learner: Learner = learner.cls.start(
            Setup(
                names=SHARED if train.shared else self.names,
                game_names=tuple(
                    f"{name}#{copy}" if copy else name
                    for name in (SHARED if drawn else self.names)
                    for copy in range(self._copies)
                ),
                games=len(b.over),
                rows=b.obs.shape[1],
                obs_shape=b.obs.shape[2:],
                state_shape=state_space_of(
                    self._evaluator.observation, engine.problems, engine.static.overflow_allowed
                ).shape,
                player=self.player,
                seed=config.seed,
                device=device,
                threads=train.threads,
                episodes=train.episodes,
            ),
            learner.options,
        )
        guide_ = self.learner.burn_in
        alone = not drawn or self.learner.learning_starts == 0 or guide_ in GUIDES
        check("learner.burn_in", alone, f"{' or '.join(GUIDES)} with train.games, found {guide_}")
        self.episodes, self.steps, self._told = np.zeros((3, count), np.int64)
        self.spent = 0.0
        self.clock: Callable[[], float] = float
        self._pace = math.inf  # seconds that an agent's move took last
        # What stays of each problem, unless each is played once, and of each network.
        best = 0 if drawn else count
        self.score = np.full((best, 3), np.inf)
        self.best_episode = np.full(best, NOBODY, np.int64)
        self.best: list[Solution | None] = [None] * best
        setup, networks = self.learner.setup, self.learner.networks.flat
        self.saved = SavedNetworks(config, setup.names, setup.obs_shape, setup.actions, networks)
        self._evaluated = np.zeros(len(networks), np.int64)  # episodes at the last evaluation
        self.evaluations: list[GreedyEvaluation] = []
        # Of the network before the episode: loss, steps.
        self._episode_start = np.zeros((len(b.over), 2))
        self.backend = self.learner.backend
        self._tell_episodes()

    @property
    def games(self) -> NDArray[np.int64]:
        """(games,) the problem of each game."""
        return np.repeat(np.arange(len(self.episodes)), self._copies)

    @property
    def running(self) -> NDArray[np.bool_]:
        """(M,) which problems still have episodes to train."""
        train = self.config.train
        if self.spent >= 1:
            return np.zeros_like(self.episodes, np.bool_)
        most = np.inf if train.steps is None else train.steps
        return (self.episodes < train.episodes) & (self.steps < most)

    @property
    def updates(self) -> NDArray[np.int64]:
        """(games,) gradient steps taken by the network of each game."""
        games = len(self.player.buffers.over)
        return np.repeat(self.learner.updates, games // len(self.learner.updates))

    @functools.cached_property
    def replayed(self) -> list[Solution]:
        """The solutions that the burn-in replays; raises InputError if they cannot be used."""
        return (
            read_solutions(self.learner.burn_in, self.problems)
            if self.learner.learning_starts
            else []
        )

    def burn_in(self) -> None:
        """Shows the learner the moves of a guide until every network has seen enough of them."""
        player, learner, config = self.player, self.learner, self.config
        if learner.learning_starts == 0:
            return
        b, games = player.buffers, self.games
        moves = guide(learner.burn_in, self.problems, player.engine, config.seed, self.replayed)
        chance = Exploration(learner.setup.game_keys("burn-in"))
        nothing = np.zeros(b.mask.shape, np.float32)
        masking = learner.masks(learner.options)
        game = np.repeat(np.arange(len(games)), b.agents.shape[1])
        player.reset()
        filled = np.zeros(len(games), np.bool_)
        while not filled.all():
            if moves is None:
                chance.epsilon_greedy(b, nothing, masking)
            else:
                asked = moves.moves(game, b.agents.reshape(-1))
                b.actions[:] = player.actions_of(asked.reshape(b.actions.shape))
            b.actions[filled] = NOBODY
            before = PreStep.of(player)
            player.step()
            learner.observe(player, before)
            enough = learner.stored >= learner.learning_starts
            filled |= np.repeat(enough, len(games) // len(enough))
            if b.over.any():
                player.reset(b.over.copy())
        player.reset()

    def _tell_episodes(self) -> None:
        """Tells the learner how far the training is, when episodes begin."""
        train, played = self.config.train, self.episodes
        if train.steps is not None or self.spent:
            # As many episodes of all as there have been steps of all, or time.
            made = self.steps / train.steps if train.steps else np.zeros(len(played))
            share = np.clip(made, self.spent, 1)
            played = np.maximum(played, (share * train.episodes).astype(np.int64))
        self._told[:] = played
        self.learner.set_episodes(self._told[self.games])

    def run(self) -> Iterator[list[Episode]]:
        """Trains to the end; after some steps of all games, yields the episodes that ended.

        Between times the trainer is in a state that :meth:`state` can save.
        """
        # From its first reset to its end a training has games in which somebody can move.
        if self.running.any() and not self.player.buffers.active.any():
            self.learner.begin(self.saved.start())
            self.player.reset()
            self.burn_in()
        while self.running.any():
            self.evaluations = []
            before, began = self.player.engine.games["steps"].copy(), time.monotonic()
            self.learner.play(self.player, self._steps_ahead)
            made = self.player.engine.games["steps"] - before
            self._pace = (time.monotonic() - began) / max(int(made.sum()), 1)
            np.add.at(self.steps, self.games, made)
            self.spent = self.clock()
            over = self.player.buffers.over.copy()
            yield self._finish(over) if over.any() or not self.running.any() else []

    @property
    def _steps_ahead(self) -> int:
        """Steps of all games until the trainer looks again: it stops soon after ``train.steps``.

        What comes of a training does not depend on when the trainer looks.
        """
        moves = self.player.buffers.actions.size
        ahead = _LOOK / (max(self._pace, 1e-9) * moves)
        if self.config.train.steps is not None:
            ahead = min(ahead, (self.config.train.steps - int(self.steps.sum())) // moves)
        return int(np.clip(ahead, 1, _STEPS))

    def _finish(self, over: NDArray[np.bool_]) -> list[Episode]:
        """Scores the episodes that are over and starts the next ones."""
        finished = []
        updates, games, player = self.updates, self.games, self.player
        losses = np.repeat(self.learner.loss.cpu().numpy(), len(games) // len(self.learner.loss))
        for g in np.flatnonzero(over).tolist():
            problem = int(games[g])
            if self.episodes[problem] >= self.config.train.episodes:
                continue  # another copy has played the last one
            metrics = player.engine.metrics(g)
            reward = float(player.buffers.total[g])
            if not abs(reward) <= LARGEST:  # nor NaN
                raise InputError(f"reward: expected finite rewards, found {reward} in an episode")
            best = False
            if player.draws is None:
                score = routes_score(metrics)
                if self.config.train.best == "reward":
                    score = score[0], -reward, 0.0
                best = bool(score < tuple(self.score[problem].tolist()))
            if best:
                self.score[problem] = score
                self.best_episode[problem] = self.episodes[problem]
                self.best[problem] = player.engine.solution(g)
            steps = updates[g] - self._episode_start[g, 1]
            loss = (float(losses[g]) - float(self._episode_start[g, 0])) / max(int(steps), 1)
            finished.append(
                Episode(
                    problem=player.draws.names[g] if player.draws else self.names[problem],
                    episode=int(self.episodes[problem]),
                    reward=reward,
                    epsilon=self.learner.exploration(int(self.episodes[problem])),
                    loss=loss if abs(loss) <= LARGEST else None,
                    updates=int(updates[g]),
                    best=best,
                    **asdict(metrics),
                )
            )
            self.episodes[problem] += 1
        self._episode_start[over, 0], self._episode_start[over, 1] = losses[over], updates[over]
        running = self.running
        self._evaluate(np.unique(games[over] if running.any() else games))
        self.player.reset(over & np.repeat(running, self._copies))
        self._tell_episodes()
        return finished

    def _evaluate(self, problems: NDArray[np.int64]) -> None:
        """Has networks that are due play without exploration, and keeps the best of each."""
        train = self.config.train
        network_of = np.arange(len(self.names)) * (not train.shared)  # the network of each problem
        self.evaluations = []
        played = np.broadcast_to(self.episodes, len(self.names))
        networks = np.unique(network_of[problems])
        episodes = np.array([played[network_of == network].min() for network in networks], np.int64)
        before = self._evaluated[networks]
        trains = np.broadcast_to(self.running, len(self.names))
        ended = np.array([not trains[network_of == network].any() for network in networks])
        due = (episodes >= before + train.evaluate_every) | ended
        # A training that ends by its steps or its time ends within an episode.
        due &= (episodes != before) | (ended & self.drawn)
        networks, episodes = networks[due], episodes[due]
        if not len(networks):
            return
        self._evaluated[networks] = episodes
        rows = np.zeros(1, np.int64) if train.shared else networks
        shown = np.flatnonzero(np.isin(network_of, networks)).reshape(len(networks), -1)
        player = self._evaluator.part(shown.ravel())
        player.reset()
        self.learner.play_greedily(player, rows)
        metrics_of = np.array([player.engine.metrics(m) for m in range(shown.size)], object)
        for network, row, now, places, metrics in zip(
            networks.tolist(), rows, episodes, shown, metrics_of.reshape(shown.shape), strict=True
        ):
            found = {
                self.names[m]: (int(played[m]), one) for m, one in zip(places, metrics, strict=True)
            }
            weights = self.learner.networks.flat[row]
            steps = int(self.steps.sum() if train.shared or self.drawn else self.steps[network])
            self.evaluations += self.saved.judge(network, weights, int(now), steps, found)

    def solutions(self) -> dict[str, Solution]:
        """The best episode's routes of every problem that has finished one.

        There are none where games draw their problems.
        """
        return {name: best for name, best in zip(self.names, self.best, strict=False) if best}

    def policy_of(self, problem: str) -> TrainedPolicy:
        """The saved network of a problem: that of the best evaluation, or of the last."""
        return self.saved.policy(0 if self.config.train.shared else self.names.index(problem))

    def origin(self, problem: str) -> str:
        """Which episode a problem's solution is from."""
        best = self.best_episode[self.names.index(problem)] + 1
        return f"episode {best} of {self.config.train.episodes}"

    # --- checkpoints --------------------------------------------------------------------------

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """What changes in training but the learner and the games; to copy from or into."""
        return {
            **{name: getattr(self, name) for name in _OWN},
            **self.saved.arrays(),
            **({"draws": self.player.draws.counts} if self.player.draws else {}),
        }

    def state(self) -> dict[str, Any]:
        """Everything that it takes to go on as if never stopped."""
        own = {**self._arrays(), "before": self._episode_start}
        games = {name: as_rows(array) for name, array in _games_of(self.player).items()}
        return {
            **self.saved.state(),
            "format": TRAINING_FORMAT,
            "problems": list(self.names),
            "in_all": self.config.train.episodes,
            "training": self.learner.state(),
            "trainer": {name: torch.from_numpy(array) for name, array in own.items()} | games,
            "routes": [best and torch.from_numpy(np.stack(best.uses)) for best in self.best],
        }

    def load_state(self, state: Mapping[str, Any], where: str) -> None:
        """Goes back to what :meth:`state` gave.

        Args:
            state: the saved state.
            where: the file it is from, for messages.

        Raises:
            InputError: it is of another kind, shape or set of problems, or cannot be the state of
                such a training.
        """
        if state["problems"] != list(self.names):
            found = textwrap.shorten(str(state["problems"]), 80)
            raise InputError(f"{where}: expected problems {self.names}, found {found}")
        then, most = state["in_all"], self.config.train.episodes
        if not (type(then) is int and 1 <= then <= most):
            raise InputError(f"{where}: in_all: expected a number from 1 to {most}")
        player, kept = self.player, state["trainer"]
        own, games = self._arrays(), _games_of(player)
        shaped = {**own, "before": self._episode_start}
        known = {"training": self.learner.state().keys(), "trainer": {*shaped, *games}}
        for part, names in known.items():
            if more := state[part].keys() - names:
                raise InputError(f"{where}: {min(more)}: expected nothing of that name")
        limits = {
            **dict.fromkeys(("score", "policy_score"), ANY),
            **dict.fromkeys(("episodes", "policy_episode", "_evaluated", "_told"), (0, then)),
            "best_episode": (NOBODY, then - 1),
            "draws": COUNT,
            "steps": COUNT,
        }
        arrays = {
            name: checked(
                kept.get(name),
                torch.from_numpy(array),
                f"{where}: {name}",
                limits.get(name, FINITE),
            ).numpy()
            for name, array in shaped.items()
        }
        best, played = arrays["best_episode"], arrays["episodes"]
        if (best >= played).any() or ((best == NOBODY) != (played == 0)).any():
            raise InputError(f"{where}: best_episode: expected one of the episodes")
        held = zip(state["routes"], self.problems.values(), strict=False)
        routes = [_routes(uses, problem, where) for uses, problem in held]
        if [solution is None for solution in routes] != (best == NOBODY).tolist():
            raise InputError(f"{where}: routes: expected those of every best episode")
        self.learner.load_state(state["training"], f"{where}: ")
        rows = [from_rows(kept.get(name), now, f"{where}: {name}") for name, now in games.items()]
        dynamic = Dynamic._make(rows[: len(Dynamic._fields)])
        buffers = StepBuffers._make(rows[len(Dynamic._fields) :])
        try:
            player.restore(Saved(dynamic, buffers, arrays.get("draws")))
        except ValueError as error:
            raise InputError(f"{where}: games: {error}") from None
        self.best = routes
        for name, array in own.items():
            array[...] = arrays[name]
        self._episode_start[...] = arrays["before"]
        over = (player.engine.games["active"] == 0).reshape(-1, self._copies)
        train = self.config.train
        # A run that ended by its steps or seconds may be going on with more of them.
        bounded = train.steps is not None or train.seconds is not None
        if not bounded and ((self.running & (self.episodes < then))[:, None] & over).any():
            raise InputError(f"{where}: expected games of all problems with episodes to train")
        begins = over & self.running[:, None] & (bounded or then < most)
        self.learner.set_episodes(self._told[self.games])
        if begins.any():  # where all had been played, more are to come
            self.player.reset(begins.ravel())
            self._tell_episodes()


_OWN = ("episodes", "steps", "score", "best_episode", "_evaluated", "_told")
"""Attributes of a trainer that a checkpoint holds, beside the learner, the games and the routes."""


def _games_of(player: Player) -> dict[str, NDArray[Any]]:
    """The arrays of a player's games by name: those of ``Dynamic``, then its buffers."""
    games = {f"games.{name}": array for name, array in player.engine.dynamic._asdict().items()}
    return games | {f"step.{name}": array for name, array in player.buffers._asdict().items()}


def _routes(kept: Any, problem: Problem, where: str) -> Solution | None:
    """The routes of a best episode from a checkpoint, None where there is none yet."""
    if kept is None:
        return None
    uses = kept.shape[1] if isinstance(kept, Tensor) and kept.ndim == 2 else 0
    like = torch.zeros((2, uses), dtype=torch.int64)
    net, edge = checked(kept, like, f"{where}: routes", COUNT).numpy()
    nets = len(problem.nets)
    if (net >= nets).any():
        raise InputError(f"{where}: routes: expected nets of the problem")
    order = np.argsort(net, kind="stable")
    ends = np.searchsorted(net[order], np.arange(1, nets))
    return Solution(problem, np.split(edge[order], ends))
