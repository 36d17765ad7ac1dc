"""TorchRL: an environment on :class:`marouting.vector.BatchEnv`, M games in a batch.

TorchRL's ``PettingZooWrapper`` plays one game at a time, and needs ``agents_persist``::

    from policies.integrations.torchrl import RoutingEnv

    env = RoutingEnv(marouting.generate(16, nets=10), reward="normalised")
    env.rollout(100)["next", "nets", "reward"]  # (16, 50, 10, 1)

A policy that :func:`save` has saved is scored by ``marouting benchmark --router
'policies.integrations.torchrl:Policy file=policy.pt'``, or in Python
(:func:`marouting.evaluate_policy`). To load one runs the code that it holds.
"""

import os
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from marouting.config import check
from marouting.vector import BatchEnv, Info
from policies.integrations.saved import Training, load

GROUP = "nets"
"""The group of all agents."""


class RoutingEnv(EnvBase):
    """M games, in each of which every net is an agent of one group, ``nets``.

    Agents stay to the end of their game: once all tasks of one have ended, it sees zeros and its
    mask has a single move, which does nothing. Rewards that pay nets for what others do still pay
    it. A game ends, ``terminated``, when all its agents are done.

    ======================================  ===================  ==================================
    ``("nets", "observation")``             (M, N, *S) float32   what agents see
    ``("nets", "action_mask")``             (M, N, A) bool       moves that cross an edge
    ``("nets", "action")``                  (M, N) int64         moves
    ``("nets", "reward")``                  (M, N, 1) float32    what the step paid
    ``reward``                              (M, 1) float32       in its place, with ``shared``
    ``done``, ``terminated``                (M, 1) bool          whether the game is over
    ``("info", "acted")``                   (M, 1) float32       agents that moved in the step
    ``("info", "joined")``                  (M, 1) float32       share of the tasks that are joined
    ``("info", "overflow")``                (M, 1) float32       overflow
    ``("info", "wirelength")``              (M, 1) float32       wirelength
    ``state``                               (M, X, Y, …)         the global state, with ``state``
    ======================================  ===================  ==================================

    Args:
        problems: see :class:`marouting.vector.BatchEnv`.
        state: whether there is the global state, for critics that see it.
        shared: whether all agents get one reward, the mean of what the step paid those that the
            problem has.
        device: where tensors are; the games are on the processor.
        **options: the other arguments of :class:`marouting.vector.BatchEnv`.

    Attributes:
        batch: the games, to be read.
        group_map: the agents of the group.
        taken: what it has been used for; ``training`` is a flag of torch's modules.

    Raises:
        InputError: an option or a problem cannot be used.
    """

    def __init__(
        self,
        problems: Any = None,
        *,
        state: bool = False,
        shared: bool = False,
        device: Any = None,
        **options: Any,
    ) -> None:
        for name in ("autoreset", "play_once"):
            check(name, name not in options, "none: TorchRL resets games that are over")
        check("everyone", options.pop("everyone", True) is True, "true: every net has a row")
        self.batch = batch = BatchEnv(problems, autoreset=False, **options)
        m, n = batch.num_problems, batch.num_agents
        super().__init__(device=device, batch_size=[m])
        self.taken = Training(options)
        self.group_map = {GROUP: [f"agent_{i}" for i in range(n)]}
        self._state, self._shared = state, shared
        self._seed_to_be: int | None = None
        box, actions = batch.single_observation_space, int(batch.single_action_space.n)
        low, high = (torch.from_numpy(b).expand(m, n, *box.shape) for b in (box.low, box.high))
        seen = {
            "observation": Bounded(low, high, (m, n, *box.shape), dtype=torch.float32),
            "action_mask": Categorical(2, (m, n, actions), dtype=torch.bool),
        }
        info = {key: Unbounded((m, 1)) for key in ("acted", "joined", "overflow", "wirelength")}
        specs = {GROUP: Composite(seen, shape=(m, n)), "info": Composite(info, shape=(m,))}
        if state:
            space = batch.single_state_space
            specs["state"] = Unbounded((m, *space.shape), dtype=torch.float32)
        self.observation_spec = Composite(specs, shape=(m,), device=device)
        moves = Composite({"action": Categorical(actions, (m, n))}, shape=(m, n))
        self.action_spec = Composite({GROUP: moves}, shape=(m,), device=device)
        paid: dict[str, Any] = {"reward": Unbounded((m, 1))}
        if not shared:
            paid = {GROUP: Composite({"reward": Unbounded((m, n, 1))}, shape=(m, n))}
        self.reward_spec = Composite(paid, shape=(m,), device=device)
        flag = {key: Categorical(2, (m, 1), dtype=torch.bool) for key in ("done", "terminated")}
        self.done_spec = Composite(flag, shape=(m,), device=device)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        """Starts all games, or those that ``_reset`` marks."""
        del kwargs
        which = None if tensordict is None else tensordict.get("_reset", None)
        options = None if which is None else {"reset_mask": which.cpu().numpy().reshape(-1)}
        obs, info = self.batch.reset(seed=self._seed_to_be, options=options)
        self._seed_to_be = None
        over = np.zeros((self.batch.num_problems, 1), np.bool_)
        return self._tensors({"done": over, "terminated": over.copy(), **self._seen(obs, info)})

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Moves all agents."""
        obs, reward, _, _, info = self.batch.step(tensordict[GROUP, "action"].cpu().numpy())
        self.taken.agent_steps += int(info["acted"].sum())
        # A game that is over stays so until it is reset.
        over = (self.batch.engine.games["active"] == 0)[:, None]
        seen = self._seen(obs, info)
        if self._shared:
            seen["reward"] = reward.mean(axis=1, keepdims=True, where=self.batch.present)
        else:
            seen[GROUP]["reward"] = reward[..., None].copy()
        return self._tensors({"done": over, "terminated": over.copy(), **seen})

    def _set_seed(self, seed: int | None) -> None:
        """Takes a seed for the next reset."""
        self._seed_to_be = seed

    def _seen(self, obs: NDArray[np.float32], info: Info) -> dict[str, Any]:
        """What agents see, as arrays of the caller's own."""
        batch, active = self.batch, info["active"]
        mask = info["action_mask"].astype(np.bool_)
        mask[~active] = np.arange(mask.shape[2]) == 0
        obs = obs.copy()
        obs[~active] = 0
        tasks = batch.engine.tasks.sum(axis=1)
        figures = {"acted": info["acted"].sum(axis=1), "joined": info["joined"] / tasks}
        figures |= {key: info[key] for key in ("overflow", "wirelength")}
        columns = {key: np.asarray(v, np.float32)[:, None].copy() for key, v in figures.items()}
        seen: dict[str, Any] = {
            GROUP: {"observation": obs, "action_mask": mask},
            "info": columns,
        }
        if self._state:
            seen["state"] = batch.state().copy()
        return seen

    def _tensors(self, arrays: dict[str, Any]) -> TensorDictBase:
        m, n = self.batch.num_problems, self.batch.num_agents
        sizes = {GROUP: [m, n], "info": [m]}
        return TensorDict(
            {
                key: TensorDict(
                    {inner: torch.from_numpy(array) for inner, array in value.items()}, sizes[key]
                )
                if isinstance(value, dict)
                else torch.from_numpy(value)
                for key, value in arrays.items()
            },
            [m],
            device=self.device,
        )


class GroupMoves:
    """The moves of a policy for a group of N agents, without exploration.

    Args:
        policy: reads ``("nets", "observation")`` and ``("nets", "action_mask")``, and writes
            ``("nets", "action")``.
        agents: N; as many rows are put into a game, whosever they are.

    Attributes:
        parameters: the number of the policy's.
    """

    def __init__(self, policy: TensorDictModuleBase, agents: int) -> None:
        self._policy, self._agents = policy, agents
        self.parameters = sum(one.numel() for one in policy.parameters())

    def moves(self, observations: NDArray[np.float32], masks: NDArray[np.int8]) -> Any:
        """(B,) moves for observations (B, *S) and masks (B, A)."""
        rows, n = len(observations), self._agents
        games = -(-rows // n)
        seen = np.zeros((games * n, *observations.shape[1:]), np.float32)
        free = np.ones((games * n, masks.shape[1]), np.bool_)
        seen[:rows], free[:rows] = observations, masks > 0
        group = {
            "observation": torch.from_numpy(seen.reshape(games, n, *seen.shape[1:])),
            "action_mask": torch.from_numpy(free.reshape(games, n, -1)),
        }
        inputs = TensorDict({GROUP: TensorDict(group, [games, n])}, [games])
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            return self._policy(inputs)[GROUP, "action"].flatten()[:rows].numpy()


def save(policy: TensorDictModuleBase, env: RoutingEnv, file: str | os.PathLike[str]) -> None:
    """Saves a policy with the options of an environment and what its training there took."""
    batch = env.batch
    shape = batch.single_observation_space.shape
    kept = {"policy": policy, "agents": batch.num_agents, "obs_shape": shape}
    torch.save({**kept, **env.taken.saved()}, file)


class Policy(GroupMoves):
    """A policy that :func:`save` has saved; see :class:`GroupMoves`.

    It shares its parameters among all agents, which must not depend on each other's rows.

    Args:
        file: the file.
        teacher: whether it learned from something with sight of the whole problem; None: not known.

    Attributes:
        options, training, obs_shape: see :mod:`policies.experiment.played`.

    Raises:
        InputError: the file cannot be read, or is another one.
    """

    def __init__(self, file: str, teacher: bool | None = None) -> None:
        saved = "a policy that policies.integrations.torchrl.save has saved"
        kept = load(file, {"policy", "agents", "options"}, saved)
        super().__init__(kept["policy"], kept["agents"])
        self.options, self.training = kept["options"], {**kept["training"], "teacher": teacher}
        self.obs_shape = kept["obs_shape"]
