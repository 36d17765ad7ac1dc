"""The training loop: M problems side by side, from burn-in to solutions, checkpointed.

One loop serves both ways to play. With ``agents: single`` each problem moves the net whose turn
it is, one transition a step (the paper); with ``agents: multi`` all its nets move at once and one
network, shared by the nets of a problem, learns from all their transitions. Either way every
problem has its own network, memory and random numbers, and the stack only saves time.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numba
import numpy as np
import torch
from numpy.typing import NDArray

from marouting import InputError, Problem, Solution
from marouting.config import ORDERS
from marouting.engine import NOBODY, Crossing, Ending
from marouting.grid import MOVES
from marouting.observation import writer
from marouting.search import AStar
from policies.config import Config
from policies.learned import loop
from policies.learned.checkpoint import FORMAT
from policies.learned.dqn import DQN
from policies.learned.replay import Replay
from policies.learned.streams import keys


@dataclass(frozen=True)
class Episode:
    """One finished episode of one problem, as ``metrics.jsonl`` holds it.

    Attributes:
        problem: the problem's name.
        episode: counted from 0.
        reward: summed over all moves.
        joined: two-pin tasks joined.
        tasks: two-pin tasks in all.
        overflow: of the routes, joined or not.
        wirelength: of the routes, joined or not.
        steps: moves made.
        epsilon: chance of a random move.
        loss: mean loss of the episode's gradient steps.
        updates: gradient steps of the problem so far.
        best: whether no earlier episode was better.
    """

    problem: str
    episode: int
    reward: float
    joined: int
    tasks: int
    overflow: int
    wirelength: int
    steps: int
    epsilon: float
    loss: float
    updates: int
    best: bool


Moves = Callable[[], NDArray[np.int8]]
"""Chooses (M, K) moves for the agents asked, in the state that the trainer has looked at."""

# Plain numbers compare many times quicker than members of an IntEnum.
_NONE, _JOINED = int(Crossing.NONE), int(Ending.JOINED)


class Trainer:
    """Trains a DQN on each of M problems of one grid shape.

    The solution of a problem is the best episode's: most tasks joined, then least overflow, then
    least wirelength, then earliest.

    Args:
        problems: the problems by name.
        config: what to do.

    Raises:
        InputError: the problems do not go together, or the device is not there.
    """

    def __init__(self, problems: Mapping[str, Problem], config: Config) -> None:
        self.config = config
        self.names = tuple(problems)
        torch.set_num_threads(config.train.threads)
        most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
        numba.set_num_threads(min(config.train.threads, most))
        env, dqn = config.env, config.dqn
        self.everyone = env.agents == "multi"
        self.engine = env.engine(list(problems.values()), ORDERS[env.agents])
        (features,) = env.observation.space(self.engine.problems, env.overflow == "allowed").shape
        sizes = (features, *dqn.hidden, MOVES)
        stack, agents = self.engine.nets.shape
        self.learner = DQN(
            sizes,
            keys(config.seed, self.names, "weights").astype(np.int64).tolist(),
            gamma=dqn.gamma,
            learning_rate=dqn.learning_rate,
            batch_size=dqn.batch_size,
            target_period=dqn.target_period,
            init=dqn.init,
            device=_device(config.train.device),
            backend=config.train.backend,
            threads=config.train.threads,
        )
        self.replay = Replay(stack, dqn.buffer_size, features, dqn.masking)
        self.episodes = np.zeros(stack, np.int64)  # episodes finished
        self.moves_made = np.zeros(stack, np.int64)  # steps of the loop that had a move
        self.owed = np.zeros(stack, np.int64)  # moves not yet answered by a gradient step
        self.reward = np.zeros(stack, np.float64)  # of the running episode
        self.loss = np.zeros((2, stack), np.float64)  # sum and number in the running episode
        self.score = np.full((stack, 3), np.iinfo(np.int64).max)  # unjoined, overflow, wirelength
        self.best_episode = np.full(stack, NOBODY, np.int64)
        self.best_used = self.engine.play.used.copy()
        self._keys = {p: keys(config.seed, self.names, p) for p in ("explore", "sample", "burn-in")}
        lanes = agents if self.everyone else 1
        self._shape = stack, lanes
        self._seen = np.zeros((stack, lanes, features), np.float32)
        self._arrived = np.zeros((stack, lanes, features), np.float32)
        self._mask = np.ones((stack, lanes, MOVES), np.int8)
        self._arrived_mask = np.ones((stack, lanes, MOVES), np.int8)
        self._moves = np.empty((stack, lanes), np.int8)
        # What the moves did: the part of an AGENT record that a reward looks at.
        self._done: dict[str, NDArray[Any]] = {
            "crossing": np.empty((stack, lanes), np.int8),
            "ending": np.empty((stack, lanes), np.int8),
            "overflow": np.empty((stack, lanes), np.int32),
        }
        self._over = np.empty(stack, np.bool_)
        self._epsilon = np.empty(stack)
        # The agents asked for moves: all of them, or of each problem the one whose turn it is.
        rows, everybody = self.engine.pairs(everyone=True)
        self._rows = rows if self.everyone else np.arange(stack, dtype=np.int32)
        self._agents = everybody.reshape(stack, -1)[:, :lanes].copy()
        self._write = writer(env.observation, self.engine)

    @property
    def updates(self) -> NDArray[np.int64]:
        """(M,) gradient steps taken for each problem."""
        return self.learner.steps

    @property
    def running(self) -> NDArray[np.bool_]:
        """(M,) problems that still have episodes to train."""
        return self.episodes < self.config.train.episodes

    # --- one step of all problems -------------------------------------------------------------

    def _look(self, seen: NDArray[np.float32], mask: NDArray[np.int8]) -> None:
        """Observations, and masks where they are used, of the agents asked."""
        agents = self._agents.reshape(-1)
        self._write(self._rows, agents, seen.reshape(-1, seen.shape[-1]))
        if self.config.dqn.masking:
            self.engine.masks(self._rows, agents, mask.reshape(-1, MOVES))

    def _step(self, choose: Moves) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Moves the agents, stores what happened, starts what comes next.

        Returns:
            (M, K) which agents moved, and (M,) the problems whose episode is over.
        """
        world, play = self.engine.world, self.engine.play
        if not self.everyone:
            self._agents[:, 0] = play.games["agent"]
        self._look(self._seen, self._mask)
        moves = choose()
        done = self._done
        loop.advance(world, play, self.everyone, self._agents, moves, *done.values())
        reward = self.config.env.reward(done)
        moved = done["crossing"] != _NONE
        self._look(self._arrived, self._arrived_mask)
        self.replay.add(
            moved,
            self._seen,
            moves,
            reward,
            self._arrived,
            done["ending"] != _JOINED,
            self._arrived_mask if self.config.dqn.masking else None,
        )
        self.reward += reward.sum(axis=1)
        loop.settle(world, play, self.everyone, self._over)
        return moved, self._over

    def _burn_in_moves(self) -> Moves:
        """Whose moves fill the memory before training."""
        if self.config.dqn.burn_in == "astar":
            astar = AStar(self.engine)
            return lambda: astar.moves(self._rows, self._agents.reshape(-1)).reshape(self._shape)
        counters = np.zeros(len(self.names), np.int64)
        nothing = np.zeros((*self._shape, MOVES), np.float32)
        always = np.ones(len(self.names))
        return lambda: self._pick(nothing, always, "burn-in", counters)

    def burn_in(self) -> None:
        """Fills the memories with the moves of A* or of random walks, episode after episode."""
        moves = self._burn_in_moves()
        filled = np.zeros(len(self.names), np.bool_)

        def choose() -> NDArray[np.int8]:
            chosen = moves()
            chosen[filled] = NOBODY
            return chosen

        while not filled.all():
            _, over = self._step(choose)
            filled |= self.replay.stored >= self.config.dqn.burn_in_size
            if over.any():
                self.engine.reset(over)
        self.engine.reset()
        self.reward[:] = 0

    def _pick(
        self,
        values: NDArray[np.float32],
        epsilon: NDArray[np.float64],
        purpose: str,
        counters: NDArray[np.int64],
    ) -> NDArray[np.int8]:
        """ε-greedy moves (M, K) of the agents asked; NOBODY for those that may not move."""
        loop.pick(
            self.engine.play,
            self._agents,
            values,
            self._mask,
            self.config.dqn.masking,
            epsilon,
            self._keys[purpose],
            counters,
            self._moves,
        )
        return self._moves

    def _choose(self) -> NDArray[np.int8]:
        """The learners' own ε-greedy moves."""
        values = self.learner.values(self._seen)
        return self._pick(values, self._epsilon, "explore", self.moves_made)

    def _learn(self, moved: NDArray[np.bool_]) -> None:
        """The gradient steps that the moves just made ask for."""
        self.owed += moved.sum(axis=1)
        due = self.owed // self.config.dqn.steps_per_update
        self.owed -= due * self.config.dqn.steps_per_update
        self.loss[0] += self.learner.learn(self.replay, self._keys["sample"], due)
        self.loss[1] += due

    def _set_epsilon(self) -> None:
        dqn, episodes = self.config.dqn, self.config.train.episodes
        self._epsilon[:] = [dqn.epsilon_at(int(e), episodes) for e in self.episodes]

    def run(self) -> Iterator[list[Episode]]:
        """Trains to the end; after every step, yields the episodes that ended with it.

        Between two steps the trainer is in a state that :meth:`state` can save.
        """
        if not self.replay.stored.any():
            self.burn_in()
        self._set_epsilon()
        while self.running.any():
            moved, over = self._step(self._choose)
            self._learn(moved)
            yield self._finish(over) if over.any() else []

    def _finish(self, over: NDArray[np.bool_]) -> list[Episode]:
        """Scores the episodes that are over and starts the next ones."""
        finished = []
        for m in np.flatnonzero(over).tolist():
            metrics = self.engine.metrics(m)
            score = (metrics.tasks - metrics.joined, metrics.overflow, metrics.wirelength)
            best = bool(score < tuple(self.score[m].tolist()))
            if best:
                self.score[m] = score
                self.best_episode[m] = self.episodes[m]
                self.best_used[m] = self.engine.play.used[m]
            finished.append(
                Episode(
                    problem=self.names[m],
                    episode=int(self.episodes[m]),
                    reward=float(self.reward[m]),
                    epsilon=float(self._epsilon[m]),
                    loss=float(self.loss[0, m] / max(self.loss[1, m], 1)),
                    updates=int(self.updates[m]),
                    best=best,
                    **asdict(metrics),
                )
            )
        self.episodes[over] += 1
        self.reward[over] = 0
        self.loss[:, over] = 0
        self.engine.reset(over & self.running)
        self._set_epsilon()
        return finished

    def solutions(self) -> dict[str, Solution]:
        """The best episode's routes of every problem that has finished one."""
        return {
            name: self.engine.solution(m, self.best_used[m])
            for m, name in enumerate(self.names)
            if self.best_episode[m] != NOBODY
        }

    # --- checkpoints --------------------------------------------------------------------------

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """Everything that changes in training, as arrays to copy from or into."""
        own = ("episodes", "moves_made", "owed", "reward", "loss", "score", "best_episode")
        play = self.engine.play
        return {
            **{name: getattr(self, name) for name in own},
            "best_used": self.best_used,
            **{f"replay.{name}": a for name, a in self.replay.memory._asdict().items()},
            "play.remaining": play.remaining,
            "play.used": play.used,
            # Records have no counterpart in torch: their bytes do.
            "play.agents": play.agents.view(np.uint8),
            "play.games": play.games.view(np.uint8),
        }

    def policy(self) -> dict[str, Any]:
        """What it takes to play with the networks: plain data and tensors."""
        env = asdict(self.config.env)
        del env["problem"]
        return {
            "format": FORMAT,
            "names": list(self.names),
            "sizes": list(self.learner.sizes),
            "masking": self.config.dqn.masking,
            "env": env,
            "weights": self.learner.weights.cpu(),
        }

    def state(self) -> dict[str, Any]:
        """Everything that it takes to go on as if never stopped."""
        return {
            **self.policy(),
            "learner": {name: t.cpu() for name, t in self.learner.tensors().items()},
            "trainer": {name: torch.from_numpy(a) for name, a in self._arrays().items()},
        }

    def load_state(self, state: Mapping[str, Any], where: str) -> None:
        """Goes back to what :meth:`state` gave.

        Args:
            state: the saved state.
            where: the file it is from, for messages.

        Raises:
            InputError: it is of another kind, shape or set of problems.
        """
        if "trainer" not in state:
            raise InputError(f"{where}: expected a checkpoint of a training, found a policy")
        if state["names"] != list(self.names):
            raise InputError(f"{where}: expected problems {self.names}, found {state['names']}")
        if state["sizes"] != list(self.learner.sizes):
            raise InputError(
                f"{where}: expected layers {self.learner.sizes}, found {state['sizes']}"
            )
        arrays = {name: torch.from_numpy(array) for name, array in self._arrays().items()}
        for kept, now in (
            (state["learner"], self.learner.tensors()),
            (state["trainer"], arrays),
        ):
            for name, tensor in now.items():
                if name not in kept or kept[name].shape != tensor.shape:
                    shape = tuple(kept[name].shape) if name in kept else "nothing"
                    raise InputError(
                        f"{where}: {name}: expected shape {tuple(tensor.shape)}, found {shape}"
                    )
                tensor.copy_(kept[name])
        self._set_epsilon()


def _device(name: str) -> torch.device:
    try:
        device = torch.device(name)
        torch.zeros(1, device=device).cpu()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"device: expected cpu, or cuda where there is one: {reason}") from None
    return device
