"""The training loop: M problems side by side, from burn-in to solutions, checkpointed.

One loop serves both ways to play. With ``agents: single`` each problem moves the net whose turn
it is, one transition a step (the paper); with ``agents: multi`` all its nets move at once and one
network, shared by the nets of a problem, learns from all their transitions. Either way every
problem has its own network, memory and random numbers, and the stack only saves time: a problem
that has trained its episodes leaves it. With ``shared: true`` there is one network, with one
memory, for all problems and all nets.
"""

import copy
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from marouting import InputError, Problem, Solution
from marouting.config import plain
from marouting.game.engine import Engine
from marouting.game.state import NOBODY
from marouting.options import ORDERS
from marouting.problem.grid import MOVES
from policies.learned.burn_in import guide, solution_files
from policies.learned.checkpoint import FORMAT
from policies.learned.config import Config
from policies.learned.dqn import Rule, backend_for, backends
from policies.learned.replay import Replay
from policies.learned.stack import Stack
from policies.learned.streams import keys
from policies.learned.threads import use_threads


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


SHARED = ("all",)
"""The network that all problems share, where there is one, under which its keys are drawn."""

_STEPS = 200
"""Steps between two looks at a clock or for an interrupt: a few hundredths of a second each."""


class Trainer:
    """Trains a DQN on each of M problems of one grid shape.

    The solution of a problem is the best episode's, as ``train.best`` says.

    Args:
        problems: the problems by name.
        config: what to do.

    Raises:
        InputError: the problems do not go together, or the device is not there.
    """

    def __init__(self, problems: Mapping[str, Problem], config: Config) -> None:
        self.config = config
        self.problems = dict(problems)
        self.names = tuple(problems)
        use_threads(config.train.threads)
        env, dqn = config.env, config.dqn
        _ = solution_files(dqn.burn_in, self.names)  # whether they are there
        engine = Engine(
            list(problems.values()), env, turn_order=env.turn_order or ORDERS[env.agents]
        )
        self._whole = engine  # of all problems, those too that have left the stack
        self.stack = Stack(
            engine,
            everyone=env.agents == "multi",
            masked=dqn.masking,
            observation=env.observation.make(),
            reward=env.reward.make(),
            keys=keys(config.seed, self.names, "explore"),
        )
        count, _, features = self.stack.lanes.seen.shape
        if dqn.shared and dqn.buffer_size < self.stack.lanes.moves.size:
            raise InputError(
                f"buffer_size: expected at least {self.stack.lanes.moves.size}, "
                "the moves of one step"
            )
        networks = SHARED if dqn.shared else self.names
        device = _device(config.train.device)
        self.learner = backends()[config.train.backend or backend_for(device)](
            Replay(len(networks), dqn.buffer_size, features, dqn.masking, device),
            dqn.hidden,
            MOVES,
            seeds=keys(config.seed, networks, "weights").astype(np.int64).tolist(),
            keys=keys(config.seed, networks, "sample"),
            rule=Rule(dqn.batch_size, dqn.gamma, dqn.target_period, dqn.learning_rate),
            steps_per_update=dqn.steps_per_update,
            init=dqn.init,
            threads=config.train.threads,
        )
        # What stays of each problem.
        self.episodes = np.zeros(count, np.int64)  # episodes finished
        self.score = np.full((count, 3), np.inf)  # of the best episode: less is better
        self.best_episode = np.full(count, NOBODY, np.int64)
        self.best_used = engine.dynamic.used.copy()
        self._weights = self.learner.weights.cpu().clone()  # (networks, P) of those that left
        # The problems in the stack: those that still have episodes to train, and at the end those
        # that had the last ones.
        self.places = np.arange(count)
        self._before = np.zeros((2, count))  # loss and steps of the network before the episode
        self._set_epsilon()

    @property
    def engine(self) -> Engine:
        """The game of the problems in the stack."""
        return self.stack.engine

    def _keep(self, which: NDArray[np.integer]) -> None:
        """Goes on with some places of the stack alone (ascending); the others leave it."""
        if not self.config.dqn.shared:
            _ = self.weights  # those of the problems that leave are kept
            self.learner.keep(which)
        self.stack = self.stack.part(which)
        self.places, self._before = self.places[which], self._before[:, which]

    @property
    def weights(self) -> Tensor:
        """(problems, P) float32, or (1, P) of the shared one: the networks, on the processor."""
        self._weights[... if self.config.dqn.shared else self.places] = self.learner.weights.cpu()
        return self._weights

    @property
    def running(self) -> NDArray[np.bool_]:
        """(M,) which problems in the stack still have episodes to train."""
        return self.episodes[self.places] < self.config.train.episodes

    @property
    def updates(self) -> NDArray[np.int64]:
        """(M,) gradient steps taken by the networks of the problems in the stack."""
        return np.broadcast_to(self.learner.steps, self.places.shape)

    def burn_in(self) -> None:
        """Fills the memories with the moves of a guide, episode after episode."""
        moves = guide(self.config.dqn.burn_in, self.problems, self.engine, self.config.seed)
        stack, engine = copy.copy(self.stack), self.engine
        count = len(self.places)
        stack.lanes = lanes = stack.lanes._replace(
            keys=keys(self.config.seed, self.names, "burn-in"),
            epsilon=np.ones(count),
            counters=np.zeros(count, np.int64),
            total=np.zeros(count),
        )
        problem = np.repeat(np.arange(count), lanes.agents.shape[1])
        filled = np.zeros(count, np.bool_)
        while not filled.all():
            stack.look()
            if moves is None:
                stack.pick()
            else:
                lanes.moves.reshape(-1)[:] = moves.moves(problem, lanes.agents.reshape(-1))
            lanes.moves[filled] = NOBODY
            stack.move()
            self.learner.replay.add(lanes)
            filled |= self.learner.replay.stored >= self.config.dqn.burn_in_size
            if lanes.over.any():
                engine.reset(lanes.over)
        engine.reset()

    def _set_epsilon(self) -> None:
        dqn, episodes = self.config.dqn, self.config.train.episodes
        self.stack.lanes.epsilon[:] = [
            dqn.epsilon_at(int(e), episodes) for e in self.episodes[self.places]
        ]

    def run(self) -> Iterator[list[Episode]]:
        """Trains to the end; after some steps of all problems, yields the episodes that ended.

        Between times the trainer is in a state that :meth:`state` can save.
        """
        if not self.learner.replay.stored.any():
            self.burn_in()
        while self.running.any():
            self.learner.play(self.stack, _STEPS)
            over = self.stack.lanes.over
            yield self._finish(over) if over.any() else []

    def _finish(self, over: NDArray[np.bool_]) -> list[Episode]:
        """Scores the episodes that are over and starts the next ones."""
        finished = []
        updates, lanes = self.updates, self.stack.lanes
        losses = np.broadcast_to(self.learner.loss.cpu().numpy(), over.shape)
        for m in np.flatnonzero(over).tolist():
            problem = int(self.places[m])
            metrics = self.engine.metrics(m)
            reward = float(lanes.total[m])
            by: tuple[float, ...] = metrics.overflow, metrics.wirelength
            if self.config.train.best == "reward":
                by = -reward, 0.0
            score = (metrics.tasks - metrics.joined, *by)
            best = bool(score < tuple(self.score[problem].tolist()))
            if best:
                self.score[problem] = score
                self.best_episode[problem] = self.episodes[problem]
                self.best_used[problem] = self.engine.dynamic.used[m]
            loss, steps = losses[m] - self._before[0, m], updates[m] - self._before[1, m]
            finished.append(
                Episode(
                    problem=self.names[problem],
                    episode=int(self.episodes[problem]),
                    reward=reward,
                    epsilon=float(lanes.epsilon[m]),
                    loss=float(loss / max(steps, 1)),
                    updates=int(updates[m]),
                    best=best,
                    **asdict(metrics),
                )
            )
        self.episodes[self.places[over]] += 1
        lanes.total[over] = 0
        self._before[:, over] = losses[over], updates[over]
        running = self.running
        self.engine.reset(over & running)
        if running.any() and not running.all():
            self._keep(np.flatnonzero(running))
        self._set_epsilon()
        return finished

    def solutions(self) -> dict[str, Solution]:
        """The best episode's routes of every problem that has finished one."""
        return {
            name: self._whole.solution(m, self.best_used[m])
            for m, name in enumerate(self.names)
            if self.best_episode[m] != NOBODY
        }

    # --- checkpoints --------------------------------------------------------------------------

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """What changes in training but the learner, as arrays to copy from or into."""
        own = ("episodes", "score", "best_episode", "best_used", "places", "_before")
        dynamic, lanes = self.engine.dynamic, self.stack.lanes
        return {
            **{name: getattr(self, name) for name in own},
            "counters": lanes.counters,
            "total": lanes.total,
            "weights": self._weights.numpy(),
            "dynamic.remaining": dynamic.remaining,
            "dynamic.used": dynamic.used,
            # Records have no counterpart in torch: their bytes do.
            "dynamic.agents": dynamic.agents.view(np.uint8),
            "dynamic.games": dynamic.games.view(np.uint8),
        }

    def policy(self) -> dict[str, Any]:
        """What it takes to play with the networks: plain data and tensors."""
        env = plain(self.config.env)
        del env["problem"]
        return {
            "format": FORMAT,
            "names": list(self.names),
            "sizes": list(self.learner.sizes),
            "masking": self.config.dqn.masking,
            "env": env,
            "weights": self.weights,
        }

    def state(self) -> dict[str, Any]:
        """Everything that it takes to go on as if never stopped."""
        return {
            **self.policy(),
            "learner": self.learner.state(),
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
        places = np.asarray(state["trainer"]["places"], np.int64)
        if not np.array_equal(places, np.intersect1d(self.places, places)) or not len(places):
            raise InputError(f"{where}: expected places of problems, found {places}")
        self._keep(np.searchsorted(self.places, places))
        learner = self.learner.state()
        arrays = {name: torch.from_numpy(array) for name, array in self._arrays().items()}
        for kept, now in ((state["learner"], learner), (state["trainer"], arrays)):
            for name, tensor in now.items():
                if name not in kept or kept[name].shape != tensor.shape:
                    shape = tuple(kept[name].shape) if name in kept else "nothing"
                    raise InputError(
                        f"{where}: {name}: expected shape {tuple(tensor.shape)}, found {shape}"
                    )
        for name, tensor in arrays.items():
            tensor.copy_(state["trainer"][name])
        self.learner.load_state(state["learner"])
        self._set_epsilon()


def _device(name: str) -> torch.device:
    try:
        device = torch.device(name)
        torch.zeros(1, device=device).cpu()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"device: expected cpu, or cuda where there is one: {reason}") from None
    return device
