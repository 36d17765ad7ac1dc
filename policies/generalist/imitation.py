"""Imitation: a network learns an expert's moves, in games that it plays itself.

The expert has a solution of every problem, from negotiated congestion, and computes the **regret**
of every move: the extra cost of the cheapest routing that begins with it
(:mod:`policies.generalist.regrets`). It does so in any state, so the network is trained on the
states that its own moves lead to (Ross, Gordon, Bagnell, "A reduction of imitation learning and
structured prediction to no-regret online learning", AISTATS 2011).

For a state with regrets r and the network's probabilities p of the moves, the loss is

    −log Σ p exp(−16 r) + ``regret`` · Σ p min(r, 4)

It does not prefer one of several best moves. Moves that cost a small fraction of an edge more, as
occur with prices, are nearly as good.

Games with prices (``train.negotiation``) teach both kinds of rounds: a share of the episodes
(``plain``) begins with a first walk without prices, which keeps the capacity that later nets need.

The network is meant to be shared by nets and problems: ``train.shared: true``, and ``train.games``
to draw a new problem for every episode. The games: ``agents: single``, ``target: tree``.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from marouting import Problem, Solution
from marouting.batch.prices import UNIT
from marouting.checks import check_fields
from marouting.config import MOST, Component, check, component_field, take_components
from marouting.game import NOBODY
from marouting.kernels import compiled
from marouting.memory import check_memory
from marouting.observations import has_move_order, move_order_of
from marouting.player import Player
from marouting.problem.grid import MOVES
from policies.generalist.regrets import MASKED, Regrets
from policies.learned.counter_rng import uniform, uniforms
from policies.learned.exploration import Exploration
from policies.learned.learner import Learner, Setup
from policies.learned.networks.adam import Adam
from policies.learned.networks.stack import View
from policies.learned.per_network import COUNT
from policies.routers.pathfinder import PathfinderOptions, PathfinderRouter

_MOST_REGRET = 100.0
"""Larger regrets, in edges, are remembered as this one; −1 stands for a move that is masked."""

_SHARPNESS = 16.0
"""How quickly a move counts as worse: a regret of this part of an edge halves it, nearly."""

_SEEN_REGRET = 4.0
"""Larger ones do not count more in the loss."""

_SURE = 1e3
"""By how much the score of a move that is to be made exceeds all others."""

_SCHEDULE = PathfinderOptions(
    repair_after=5,
    overflow_stall_weight=1,
    repair_stall_passes=30,
    min_repair_fraction=1.0,
    patience_factor=8,
    seconds=None,
)
"""How the expert negotiates. It is that of the training of the shipped weights: another one has
other solutions, and weights."""


@dataclass(frozen=True, kw_only=True)
class ImitationOptions:
    """The options of imitation learning.

    Attributes:
        network: gives the scores of the six moves. By default a multilayer perceptron with layers
            of 160 and 128.
        learning_rate: of Adam.
        anneal: whether the learning rate falls to 0 along a cosine until the last episode.
        memory: states that are remembered; the oldest go first.
        batch: states of a gradient step.
        reuse: how often a state is learned from, on average.
        regret: weight of the expected regret in the loss.
        expert_fraction: share of the episodes that the expert plays. Until ``batch`` states are
            collected it plays all of them.
        drawn: share of the episodes in which the network samples its moves. In the others it makes
            the most probable ones.
        expert_moves: share of the moves in the network's episodes that the expert makes.
        plain: share of the episodes that begin with plain rounds. Without prices all do.
        passes: number of passes of negotiated congestion for the expert's solution.
        masking: whether only moves that cross an edge are chosen.
    """

    network: Component = component_field("network", "mlp", hidden=(160, 128))
    learning_rate: float = 1e-3
    anneal: bool = True
    memory: int = 300_000
    batch: int = 1024
    reuse: float = 3.0
    regret: float = 0.1
    expert_fraction: float = 0.15
    drawn: float = 0.4
    expert_moves: float = 0.05
    plain: float = 0.5
    passes: int = 200
    masking: bool = True

    def __post_init__(self) -> None:
        take_components(self)
        bounds = dict.fromkeys(("memory", "batch", "passes"), (1, MOST))
        bounds |= dict.fromkeys(("expert_fraction", "drawn", "expert_moves", "plain"), (0, 1))
        check_fields(self, reuse=(0, 1000), regret=(0, np.inf), **bounds)
        check("learning_rate", self.learning_rate > 0, "a number above 0")
        check("batch", self.batch <= self.memory, f"a number from 1 to memory, {self.memory}")
        check("masking", self.masking, "true: the expert makes no other moves")


class Imitation(Learner):
    """Imitation in torch, on any device, for any network and observation."""

    Options = ImitationOptions
    rows: ClassVar[tuple[str, ...]] = (
        *Learner.rows, "store", "kept", "pending_updates", "progress", "begun", "plain", "last",
        "keys", "coming", "table", "attach", "pins", "many", "low", "high",
    )  # fmt: skip
    parts: ClassVar[tuple[str, ...]] = ("networks", "adam", "explore")

    def __init__(self, setup: Setup, options: ImitationOptions) -> None:
        super().__init__(setup, options)
        o, player, games = options, setup.player, setup.games
        check("train.shared", len(setup.names) == 1, "true, for imitation")
        check("env.agents", not player.everyone, "single, for imitation")
        rules = player.engine.rules
        check("env.rip_up.choose", not rules.asks, "all, conflicts or history, for imitation")
        check("env.wait", setup.actions == MOVES, "false, and message_bits 0, for imitation")
        self.backend = f"torch, batched on {setup.device}"
        self.networks = self._stack("weights", setup.obs_shape, setup.actions)
        self.adam = Adam(self.networks.flat)
        self.explore = Exploration(setup.game_keys("explore"))
        self.keys = setup.network_keys("sample")
        self.features = int(np.prod(setup.obs_shape))
        numbers = self.features + MOVES
        check_memory(
            2 * o.memory * numbers, "learner.memory: {} states of {} numbers", o.memory, numbers
        )
        store = np.zeros((1, o.memory, numbers), np.float16)
        self.store = torch.from_numpy(store)
        self.kept = np.zeros(1, np.int64)
        self.pending_updates = np.zeros(1)  # gradient steps
        self.progress = np.zeros(1)  # episodes played, as a share of all
        self.begun = np.zeros((1, games), np.int64)  # episodes that each game has begun
        self.plain = np.zeros((1, games), np.bool_)  # whether the episode began with a plain walk
        self.last = np.full((1, games), NOBODY, np.int64)  # who moved last in each game
        self.regrets = Regrets(player.engine)
        for name, array in self.regrets.lessons._asdict().items():
            if name in self.rows:
                setattr(self, name, array[None])  # the same memory
        self._solutions: dict[int, tuple[Problem, Solution]] = {}
        self._solver = PathfinderRouter(replace(_SCHEDULE, passes=o.passes))
        self._out = np.zeros((games, MOVES), np.int32)

    def limits(self) -> dict[str, tuple[float, float]]:
        """See :meth:`.PerNetworkState.limits`."""
        engine = self.setup.player.engine
        agents, cells = engine.nets.shape[1], engine.grid.gcells
        return {
            **super().limits(),
            **dict.fromkeys(("kept", "pending_updates", "begun", "coming"), COUNT),
            **dict.fromkeys(("table", "attach"), (0.0, float(MASKED))),
            "progress": (0.0, 1.0),
            "last": (NOBODY, agents - 1.0),
            "pins": (0.0, cells - 1.0),
            "many": (0.0, float(self.regrets.lessons.pins.shape[1])),
        }

    def set_episodes(self, episodes: NDArray[np.int64]) -> None:
        """See :meth:`policies.learned.learner.Learner.set_episodes`."""
        self.progress[:] = min(float(episodes.mean()) / self.setup.episodes, 1.0)

    # --- play ---------------------------------------------------------------------------------

    def play(self, player: Player, steps: int) -> None:
        """See :meth:`policies.learned.learner.Learner.play`."""
        now, view = player.buffers, self.networks.row(0)
        chance = np.zeros(now.acted.shape, np.float32)
        for _ in range(steps):
            learns = self._begin(player)
            regrets = self._regrets(player)
            with torch.no_grad():
                seen = torch.from_numpy(now.obs[:, 0]).to(self.device)
                scores = view(seen[None])[0].cpu().numpy()
            led = self._led(scores, regrets)[:, None]
            self.explore.sample(now, player.movers, led, True, chance)
            self._remember(now.obs[:, 0], regrets, learns)
            self.last[0] = now.agents[:, 0]
            player.step()
            while self.pending_updates[0] >= 1:
                self.learn()
                self.pending_updates -= 1
            if now.over.any():
                return

    def _begin(self, player: Player) -> NDArray[np.bool_]:
        """Begins episodes and walks; returns (M,) whose states may be learned from."""
        engine, last = player.engine, self.last[0]
        games, learns = engine.games, player.buffers.active[:, 0].copy()
        priced, begins = engine.priced, games["steps"] == 0
        if begins.any():
            self.begun[0] += begins
            self.regrets.lessons.coming[begins] = 0
            if priced:
                kinds = np.zeros(len(games))
                _draw(self.explore.keys[0], self.begun[0], _PLAIN, kinds)
                self.plain[0, begins] = kinds[begins] < self.options.plain
                engine.begin_plain(begins & self.plain[0])
                learns[begins & self.plain[0]] = False  # the first agent has seen prices
        new = (games["agent"] != last) & (games["agent"] != NOBODY) & (games["round"] == 0)
        waits = (new | begins) & ((games["plain"] == 1) | (not priced))
        for m in np.flatnonzero(waits).tolist():
            n, solution = int(games["agent"][m]), self._solution(m, engine.problems[m])
            if begins[m]:
                self.regrets.expect(m, np.flatnonzero(engine.tasks[m]), solution, 1)
            self.regrets.expect(m, np.array([n]), solution, -1)
        return learns

    def _solution(self, m: int, problem: Problem) -> Solution:
        """The expert's solution of the problem that game m plays."""
        known = self._solutions.get(m)
        if known is None or known[0] is not problem:
            known = self._solutions[m] = problem, self._solver.route(problem)
        return known[1]

    def _regrets(self, player: Player) -> NDArray[np.int32]:
        """(M, 6) regrets of the moves, in the order of the player's actions."""
        now, out = player.buffers, self._out
        self.regrets.write(np.arange(len(out), dtype=np.int32), now.agents[:, 0], out)
        if not has_move_order(player.observation):
            return out
        order = move_order_of(player.observation, now.obs[:, 0], MOVES)
        return np.take_along_axis(out, order, -1)

    def _led(self, scores: NDArray[np.float32], regrets: NDArray[np.int32]) -> NDArray[np.float32]:
        """(M, 6) scores by which moves are sampled: the expert's or the network's."""
        o = self.options
        ways, helps = np.zeros((2, len(scores)))
        _draw(self.explore.keys[0], self.begun[0], _EPISODE, ways)
        _draw(self.explore.keys[0], self.explore.counters[0], _HELP, helps)
        expert = (ways < o.expert_fraction) | (helps < o.expert_moves)
        expert |= self.kept[0] < o.batch
        sure = np.where(regrets < MASKED, scores, -np.inf).argmax(axis=1)
        greedy = np.where(np.arange(MOVES) == sure[:, None], _SURE, np.float32(0))
        own = np.where((ways < o.expert_fraction + o.drawn)[:, None], scores, greedy)
        led: NDArray[np.float32] = np.where(
            expert[:, None], np.where(regrets == 0, _SURE, np.float32(0)), own
        ).astype(np.float32)
        return led

    def _remember(
        self, obs: NDArray[np.float32], regrets: NDArray[np.int32], learns: NDArray[np.bool_]
    ) -> None:
        """Stores the states in which there is a choice."""
        o = self.options
        choice = learns & ((regrets < MASKED).sum(axis=1) > 1)
        count = int(choice.sum())
        places = (self.kept[0] + np.arange(count)) % o.memory
        store = self.store[0].numpy()
        store[places, : self.features] = obs[choice].reshape(count, self.features)
        given = regrets[choice]
        store[places, self.features :] = np.where(
            given < MASKED, np.minimum(given / UNIT, _MOST_REGRET), -1
        )
        self.kept += count
        if self.kept[0] >= o.batch:
            self.pending_updates += count * o.reuse / o.batch

    # --- learning -----------------------------------------------------------------------------

    def learn(self) -> None:
        """One gradient step on a sample of the memory."""
        o, view = self.options, self.networks.row(0)
        lanes = torch.arange(o.batch)
        key = torch.from_numpy(self.keys.view(np.int64))
        draws = uniforms(key, torch.from_numpy(self.updates), lanes)[0]
        places = (draws * min(int(self.kept[0]), o.memory)).long()
        rows = self.store[0].index_select(0, places).to(self.device).float()
        obs = rows[:, : self.features].view(o.batch, *self.setup.obs_shape)
        loss = imitation_loss(view, obs, rows[:, self.features :], o.regret)
        gradient = torch.empty_like(self.networks.flat)
        view.gradient(loss, gradient)
        rate = o.learning_rate
        if o.anneal:
            rate *= (1 + float(np.cos(np.pi * self.progress[0]))) / 2
        self.adam.step(self.networks.flat, gradient, torch.ones(1, 1, device=self.device), rate)
        self.loss += loss.detach().double()
        self.updates += 1


_EPISODE, _HELP, _PLAIN = 8, 9, 10
"""Lanes of random numbers that moves do not use."""


@compiled
def _draw(keys: Any, counters: Any, lane: int, out: Any) -> None:
    """Fills ``out`` (M,) with a random number for each game."""
    for m in range(len(out)):
        out[m] = uniform(keys[m], counters[m], lane)


def imitation_loss(view: View, obs: Tensor, regrets: Tensor, weight: float) -> Tensor:
    """The loss of the module's docstring.

    Args:
        view: gives the scores of moves.
        obs: (B, *S) float32 states.
        regrets: (B, 6) float32, −1 for masked moves.
        weight: of the expected regret.
    """
    # (6, B): torch is several times as fast over the long axis.
    regrets = regrets.t()
    scores = view(obs[None])[0].t().masked_fill(regrets < 0, -1e9)
    chances = torch.log_softmax(scores, dim=0)
    best = torch.logsumexp(chances - _SHARPNESS * regrets.clamp(min=0), dim=0)
    expected = (chances.exp() * regrets.clamp(0, _SEEN_REGRET)).sum(dim=0)
    return (weight * expected - best).mean()
