"""PPO where games, rollouts, networks and updates are on one device, and stay there.

The algorithm is that of :mod:`policies.learned.algorithms.ppo`, with the same options, losses and
networks. What differs is how a rollout is kept: as so many steps of all games, with time as the
first axis. A minibatch is all moves of some of these steps, drawn at random.

The last move of an agent waits until its game is over, or the agent is ripped up and moves again:
rewards may pay the agent until then. It is learned from with the moves of that step.

Rows of games (M, N) are kept with games fastest, R = N · M in all: as the device has them
(:mod:`marouting.cuda.env`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from marouting.batch.window import WindowObservation
from marouting.config import check
from marouting.errors import InputError
from marouting.game import Ending
from marouting.observations import has_move_order
from marouting.problem.grid import MOVES
from marouting.vector import BatchEnv
from policies.learned.algorithms.ppo import PPOOptions
from policies.learned.checkpoint import FINITE, as_rows, checked, from_rows
from policies.learned.learner import check_network, new_network
from policies.learned.machine import torch_device

_NEVER = -1e9


@dataclass(frozen=True)
class Iteration:
    """A rollout and what was learned from it.

    Attributes:
        steps: moves of agents in it.
        episodes: episodes that ended in it.
        joined: share of the tasks that ended in it that were connected.
        loss: of the critic.
    """

    steps: int
    episodes: int
    joined: float
    loss: float


class Moves(NamedTuple):
    """K moves of agents, and what PPO learns from them.

    Attributes:
        obs: (F, K) what the agents saw.
        mask: (A, K) the moves that they could make.
        action: (K,) the moves that they made.
        chance: (K,) the logarithms of the chances of these.
        value: (K,) what the critic expected.
        returns: (K,) what it should have expected.
        state: (S, J) the states of games, which a central critic saw as well; S is 0 for others.
        game: (K,) the columns of ``state``.
    """

    obs: Tensor
    mask: Tensor
    action: Tensor
    chance: Tensor
    value: Tensor
    returns: Tensor
    state: Tensor
    game: Tensor

    @classmethod
    def joined(cls, parts: Sequence["Moves"]) -> "Moves":
        """All moves of some."""
        if len(parts) == 1:
            return parts[0]
        *rest, game = zip(*parts, strict=True)
        states = [0, *(part.state.shape[1] for part in parts[:-1])]
        shifted = [g + at for g, at in zip(game, np.cumsum(states).tolist(), strict=True)]
        return cls(*(torch.cat(list(each), dim=-1) for each in (*rest, shifted)))


class DevicePPO:
    """PPO, IPPO or MAPPO with one actor for all agents.

    Args:
        env: the games, in which all agents have a row; their problems are drawn.
        observation: the observation of ``env``.
        options: of the learner; ``num_envs`` and ``rollout`` are for the processor.
        steps: steps of all games between updates.
        seed: of the weights and of all that is drawn.

    Attributes:
        progress: the share of the training that is done, by which the learning rate falls.
        waits: (R,) whether the last move of an agent of an earlier rollout waits.
        updates: gradient steps so far.
        actor: gives the scores of moves.
        critic: gives the value of what an agent sees.

    Raises:
        InputError: the observation has an order of moves that is not known on a device, moves have
            messages, or torch cannot use the device.
    """

    def __init__(
        self,
        env: BatchEnv,
        observation: Any,
        options: PPOOptions,
        *,
        steps: int = 32,
        seed: int = 0,
    ) -> None:
        self.env, self.options, self.steps = env, options, steps
        self.device = torch_device("cuda" if on_cuda(env) else "cpu")
        known = not has_move_order(observation) or type(observation) is WindowObservation
        check("env.observation", known, "paper or window on a device")
        self.mirrored = has_move_order(observation)
        self.agents, self.games = env.num_agents, env.num_problems
        self.rows = self.agents * self.games
        features = int(np.prod(env.single_observation_space.shape))
        self.central = options.critic == "central"
        self.state_size = int(np.prod(env.single_state_space.shape)) if self.central else 0
        self.actions = int(env.single_action_space.n)
        check("message_bits", self.actions <= MOVES + 2, "0 on a device")
        check_network(options)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            actor = new_network(options, (features,), self.actions)
            critic = new_network(options, (features + self.state_size,), 1)
        self.actor: nn.Module = actor.to(self.device)
        self.critic: nn.Module = critic.to(self.device)
        self.adam = torch.optim.Adam(
            self._parameters(), options.learning_rate, eps=1e-5, fused=self.device.type == "cuda"
        )
        self.random = torch.Generator(self.device).manual_seed(seed)
        each = steps, self.rows
        new: dict[str, Any] = {"device": self.device}
        self.obs = torch.zeros((steps, features, self.rows), **new)
        self.global_state = torch.zeros((steps, self.state_size, self.games), **new)
        self.mask = torch.zeros((steps, self.actions, self.rows), dtype=torch.bool, **new)
        self.action = torch.zeros(each, dtype=torch.int64, **new)
        self.chance, self.reward = (torch.zeros(each, **new) for _ in range(2))
        self.value = torch.zeros((steps + 1, self.rows), **new)
        self.after = torch.zeros(each, **new)
        self.acted, self.joined, self.failed = torch.zeros((3, *each), dtype=torch.bool, **new)
        self.over = torch.zeros((steps, self.games), dtype=torch.bool, **new)
        self.waits = torch.zeros(self.rows, dtype=torch.bool, **new)
        # Those that wait, by row; ``returns`` is what has been paid so far.
        self.waiting = self._made(0, torch.arange(self.rows, **new), self.reward[0], by_row=True)
        self.progress, self.updates = 0.0, 0
        self.now, self.info = env.reset()

    # --- what the environment has, as tensors -------------------------------------------------

    def tensor(self, array: Any) -> Tensor:
        """An array of the environment, without a copy."""
        if self.device.type == "cuda":
            return torch.as_tensor(array, device=self.device)
        return torch.from_numpy(array if isinstance(array, np.ndarray) else array._ary)

    def flat(self, array: Any) -> Tensor:
        """(R,) of (M, N), or (F, R) of (M, N, F)."""
        tensor = self.tensor(array)
        turned = tensor.permute(*reversed(range(tensor.dim())))
        return turned.reshape(*turned.shape[:-2], self.rows)

    # --- play ---------------------------------------------------------------------------------

    @torch.no_grad()
    def play(self) -> None:
        """Fills the rollout."""
        for t in range(self.steps):
            obs, mask = self.obs[t], self.mask[t]
            obs.copy_(self._seen(self.now))
            mask.copy_(self._turned(self.flat(self.info["action_mask"]), obs))
            if self.central:
                self.global_state[t].copy_(self._state())
            scores = self.actor(obs.t())
            if self.options.masking:
                scores = scores.masked_fill(~mask.t(), _NEVER)
            chances = torch.log_softmax(scores, dim=1)
            noise = torch.empty_like(chances).exponential_(generator=self.random)
            chosen = (chances - noise.log()).argmax(dim=1)  # Gumbel's way to draw by chances
            self.action[t] = chosen
            self.chance[t] = chances.gather(1, chosen[:, None])[:, 0]
            self.value[t] = self.critic(self._both(obs, self.global_state[t]).t())[:, 0]
            moves = self._moves(chosen, obs).to(torch.int16).view(self.agents, self.games).t()
            self._step(moves)
            self.reward[t] = self.flat(self.paid) * self.options.reward_scale
            ending = self.flat(self.info["task_ended"])
            self.acted[t] = self.flat(self.info["acted"])
            self.joined[t], self.failed[t] = ending == Ending.JOINED, ending == Ending.FAILED
            self.over[t] = self.tensor(self.info["over"])
            if not self.options.final_failures:
                seen = self._seen(self.info["final_obs"])
                state = self._state() if self.central else self.global_state[t]
                self.after[t] = self.critic(self._both(seen, state).t())[:, 0]
        seen = self._seen(self.now)
        state = self._state() if self.central else self.global_state[0]
        self.value[self.steps] = self.critic(self._both(seen, state).t())[:, 0]

    def _step(self, moves: Tensor) -> None:
        """Makes the moves (M, N)."""
        if on_cuda(self.env):
            actions: Any = self.env.actions  # type: ignore[attr-defined]
            self.tensor(actions).copy_(moves)
        else:
            actions = moves.numpy()
        self.now, self.paid, _, _, self.info = self.env.step(actions)

    def _seen(self, obs: Any) -> Tensor:
        return self.flat(obs) if obs.ndim == 3 else self.flat(obs.reshape(*obs.shape[:2], -1))

    def _state(self) -> Tensor:
        state = self.tensor(self.env.state())
        return state.reshape(self.games, -1).t()

    def _both(self, obs: Tensor, state: Tensor) -> Tensor:
        """(F + S, R) what the critic sees."""
        if not self.central:
            return obs
        every = state[:, None].expand(-1, self.agents, -1).reshape(self.state_size, self.rows)
        return torch.cat((obs, every))

    def _turned(self, mask: Tensor, obs: Tensor) -> Tensor:
        """(A, R) masks in the observation's order of moves."""
        mask = mask.bool()
        if not self.mirrored:
            return mask
        turned = mask.clone()
        for axis in range(2):
            back = obs[axis] < 0
            pair = mask[2 * axis : 2 * axis + 2]
            turned[2 * axis : 2 * axis + 2] = torch.where(back, pair.flip(0), pair)
        return turned

    def _moves(self, chosen: Tensor, obs: Tensor) -> Tensor:
        """(R,) the moves on the grid."""
        if not self.mirrored:
            return chosen
        back = torch.where(chosen < 2, obs[0] < 0, obs[1] < 0) & (chosen < MOVES - 2)
        return chosen ^ back.long()

    # --- learning -----------------------------------------------------------------------------

    @torch.no_grad()
    def advantages(self) -> tuple[Tensor, Tensor]:
        """(T, R) generalised advantage estimates (Schulman et al., 2016), and which moves wait.

        What is paid to an agent after its last move of an episode counts as paid for that move. Of
        a move that waits, the estimate holds what has been paid so far.
        """
        o = self.options
        advantage, waits = torch.zeros_like(self.reward), torch.zeros_like(self.acted)
        ahead, gain = self.value[self.steps].clone(), torch.zeros_like(self.reward[0])
        late, zero = torch.zeros_like(gain), torch.zeros_like(gain)
        idle = ~self.flat(self.info["active"]).bool()  # after the rollout, in a game that goes on
        for t in reversed(range(self.steps)):
            over = self.over[t].repeat(self.agents)
            ahead, gain, late = (torch.where(over, zero, part) for part in (ahead, gain, late))
            idle &= ~over
            acted, joined, failed = self.acted[t], self.joined[t], self.failed[t]
            ahead = torch.where(joined, zero, torch.where(failed, self.after[t], ahead))
            gain = torch.where(joined | failed, zero, gain)
            late = late + self.reward[t]
            found = late + o.gamma * ahead - self.value[t] + o.gamma * o.gae_lambda * gain
            advantage[t] = found
            waits[t] = acted & idle
            idle &= ~acted
            gain = torch.where(acted, torch.where(waits[t], zero, found), gain)
            ahead = torch.where(acted, self.value[t], ahead)
            late = torch.where(acted, zero, late)
        return advantage, waits

    def learn(self) -> Tensor:
        """The updates of a rollout; returns the critic's mean loss."""
        o = self.options
        left = max(1 - self.progress, 0.0) if o.anneal else 1.0
        for group in self.adam.param_groups:
            group["lr"] = o.learning_rate * left
        moves = [some for some in self._learned_from() if len(some.action)]
        loss = torch.zeros((), device=self.device)
        if not moves:
            return loss
        size = max(1, min(self.steps, round(o.minibatch / self.rows)))
        count = 0
        for _ in range(o.epochs):
            order = torch.randperm(len(moves), generator=self.random, device=self.device)
            for part in torch.split(order.cpu(), size):
                count += 1
                loss += self._update(Moves.joined([moves[t] for t in part.tolist()]))
        return loss / count

    @torch.no_grad()
    def _learned_from(self) -> list[Moves]:
        """The moves of every step that are learned from; those whose games go on begin to wait."""
        advantage, waits = self.advantages()
        learned, found = self.acted & ~waits, []
        for t in range(self.steps):
            again = self.waits & self.acted[t]  # ripped up, the agent moves again
            self.waiting.returns.add_(self.reward[t] * (self.waits & ~again))
            ends = again | self.waits & self.over[t].repeat(self.agents)
            self.waits &= ~ends
            late = ends.nonzero()[:, 0]
            *parts, _ = (part.index_select(-1, late) for part in self.waiting)
            waited = Moves._make([*parts, torch.arange(len(late), device=self.device)])
            moves = self._made(t, learned[t].nonzero()[:, 0], advantage[t])
            found.append(Moves.joined([moves, waited]) if len(late) else moves)
        for t in range(self.steps):
            rows = waits[t].nonzero()[:, 0]
            made = self._made(t, rows, advantage[t], by_row=True)
            for kept, new in zip(self.waiting[:-1], made[:-1], strict=True):
                kept[..., rows] = new
            self.waits[rows] = True
        return found

    def _made(self, t: int, rows: Tensor, advantage: Tensor, *, by_row: bool = False) -> Moves:
        """The moves of some rows (K,) in a step, whose advantages (R,) are given.

        Args:
            t: the step.
            rows: of the agents.
            advantage: of all rows.
            by_row: whether every move has a state of its own.
        """
        obs, mask, action, chance, value = (
            part[t].index_select(-1, rows)
            for part in (self.obs, self.mask, self.action, self.chance, self.value)
        )
        returns, state, game = advantage[rows] + value, self.global_state[t], rows % self.games
        if by_row:
            state, game = state.index_select(1, game), torch.arange(len(rows), device=self.device)
        return Moves(obs, mask, action, chance, value, returns, state, game)

    def _update(self, moves: Moves) -> Tensor:
        """A gradient step; returns the critic's loss."""
        o = self.options
        obs, mask, action, chance, expected, returns, state, game = moves
        both = torch.cat((obs, state.index_select(1, game))) if self.central else obs
        scores = self.actor(obs.t())
        if o.masking:
            scores = scores.masked_fill(~mask.t(), _NEVER)
        chances = torch.log_softmax(scores, dim=1)
        gain = returns - expected
        gain = gain - gain.mean()
        gain = gain / (gain.square().mean().sqrt() + 1e-8)
        ratio = (chances.gather(1, action[:, None])[:, 0] - chance).exp()
        clipped = ratio.clamp(1 - o.clip, 1 + o.clip)
        policy = -torch.minimum(ratio * gain, clipped * gain).mean()
        entropy = -(chances.exp() * chances).sum(dim=1).mean()
        value = self.critic(both.t())[:, 0]
        error = (value - returns).square().mean() / 2
        self.adam.zero_grad(set_to_none=True)
        (policy - o.entropy * entropy + error).backward()
        for network in (self.actor, self.critic):
            nn.utils.clip_grad_norm_(network.parameters(), o.max_gradient, foreach=True)
        self.adam.step()
        self.updates += 1
        return error.detach()

    def iterate(self) -> Iteration:
        """Plays a rollout and learns from it."""
        self.play()
        loss = self.learn()
        acted, joined, failed = (int(t.sum()) for t in (self.acted, self.joined, self.failed))
        return Iteration(
            steps=acted,
            episodes=int(self.over.sum()),
            joined=joined / max(joined + failed, 1),
            loss=float(loss),
        )

    # --- checkpoints --------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """What it takes to go on: plain data and tensors."""
        env: Any = self.env
        flat = nn.utils.parameters_to_vector
        moments = [self.adam.state.get(p, {}) for p in self._parameters()]
        return {
            "actor": flat(self.actor.parameters()).detach().cpu(),
            "critic": flat(self.critic.parameters()).detach().cpu(),
            "moments": [{k: v.detach().cpu() for k, v in m.items()} for m in moments],
            "random": self.random.get_state().cpu(),
            "waits": self.waits.to("cpu", copy=True),
            "waiting": [part[..., self.waits].cpu() for part in self.waiting[:-1]],
            "updates": self.updates,
            "games": [as_rows(array) for array in _games(env)],
        }

    def load_state(self, state: Mapping[str, Any], where: str) -> None:
        """Goes back to what :meth:`state` gave; raises InputError if it does not fit."""
        for name, network in (("actor", self.actor), ("critic", self.critic)):
            now = nn.utils.parameters_to_vector(network.parameters()).detach()
            kept = checked(state[name], now.cpu(), f"{where}: {name}").to(self.device)
            nn.utils.vector_to_parameters(kept, network.parameters())
        for parameter, kept in zip(self._parameters(), state["moments"], strict=True):
            if kept:
                found = {
                    k: checked(kept[k], parameter.detach().cpu(), f"{where}: {k}").to(self.device)
                    for k in ("exp_avg", "exp_avg_sq")
                }
                step = checked(kept["step"], torch.zeros(()), f"{where}: step")
                self.adam.state[parameter] = {"step": step.to(self._adam_steps), **found}
        self.waits.copy_(checked(state["waits"], self.waits.cpu(), f"{where}: waits"))
        parts = self.waiting._asdict()
        del parts["game"]
        for (name, part), kept in zip(parts.items(), state["waiting"], strict=True):
            now = part[..., self.waits].cpu()
            limits = (0.0, self.actions - 1.0) if name == "action" else FINITE
            part[..., self.waits] = checked(kept, now, f"{where}: {name}", limits).to(self.device)
        try:
            self.random.set_state(state["random"])
        except (RuntimeError, TypeError):
            raise InputError(f"{where}: random: expected a generator's state") from None
        self.updates = int(state["updates"])
        env: Any = self.env
        name, games, own = f"{where}: games", state["games"], _games(env)
        check(name, len(games) == len(own), f"{len(own)} arrays, found {len(games)}")
        played, *arrays = [from_rows(*each, name) for each in zip(games, own, strict=True)]
        # A state has places in tables of problems, which kernels do not check.
        check(name, np.array_equal(played, own[0]), "those of such a training")
        env.restore(env.save()._replace(games=arrays))

    @property
    def _adam_steps(self) -> torch.device:
        """Where Adam counts its steps: a fused one does on the device."""
        return self.device if self.device.type == "cuda" else torch.device("cpu")

    def _parameters(self) -> list[nn.Parameter]:
        return [*self.actor.parameters(), *self.critic.parameters()]

    @torch.no_grad()
    def __call__(self, obs: Any, mask: Any) -> Any:
        """The best moves (B,) by observations (B, *S) and masks (B, A), for ``evaluate_policy``."""
        seen = torch.as_tensor(np.ascontiguousarray(obs), device=self.device).flatten(1).t()
        allowed = self._turned(torch.as_tensor(np.asarray(mask), device=self.device).t(), seen)
        scores = self.actor(seen.t()).masked_fill(~allowed.t(), _NEVER)
        return self._moves(scores.argmax(dim=1), seen).cpu().numpy()


def on_cuda(env: BatchEnv) -> bool:
    """Whether an environment is on a CUDA device, which may be simulated."""
    return hasattr(env, "actions") and not env._device.simulated  # type: ignore[attr-defined]


def _games(env: Any) -> list[NDArray[Any]]:
    """The state of games on a device, after a digest of what they play."""
    saved = env.save()
    return [np.frombuffer(saved.identity[-1], np.uint8), *saved.games]
