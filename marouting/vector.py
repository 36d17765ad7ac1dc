"""Many problems at once, in arrays: the engine's own form, for learners that want it all.

For Gymnasium's ways with one player a problem there is ``gymnasium.make_vec``; here every net of
every problem moves in every step.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marouting.engine import Engine, NetOrder, Overflow, Status, TurnOrder
from marouting.grid import MOVES
from marouting.observation import Observation, PaperObservation
from marouting.problem import Problem
from marouting.reward import PaperReward, Reward

Info = dict[str, NDArray[Any]]


class BatchEnv:
    """M problems of one grid shape, played side by side, all nets moving in every step.

    The rows of problems with fewer agents than the largest are filled up; ``present`` tells which
    agents there are. The arrays that :meth:`reset` and :meth:`step` return are the environment's
    own and are written over by the next call: copy what has to last.

    A problem whose episode is over starts its next one with the step after, in the manner of
    Gymnasium's ``AutoresetMode.NEXT_STEP``: that step ignores the problem's actions, its rewards
    are 0, and its observations are those of the new episode.

    Args:
        problems: the problems, all with the same grid shape.
        turn_order: ``round_robin``, or ``sequential``: the agents whose turn it is not wait.
        net_order: see :class:`marouting.Engine`.
        max_steps: see :class:`marouting.Engine`.
        overflow: see :class:`marouting.Engine`.
        observation: what an agent sees; None: the paper's.
        reward: what an agent gets; None: the paper's.
        autoreset: whether an episode that is over is followed by the next.

    Attributes:
        num_problems: M.
        num_agents: N, agents of the largest problem.
        present: (M, N) bool, where there is an agent.
        single_observation_space: the space of one agent's observation, of F numbers.
        engine: the engine, to be read.

    Raises:
        InputError: the problems do not go together, or an option is out of its range.
    """

    def __init__(
        self,
        problems: Sequence[Problem],
        *,
        turn_order: TurnOrder = "round_robin",
        net_order: NetOrder = "half_perimeter",
        max_steps: int | None = None,
        overflow: Overflow = "forbidden",
        observation: Observation | None = None,
        reward: Reward | None = None,
        autoreset: bool = True,
    ) -> None:
        self.engine = Engine(
            problems,
            turn_order=turn_order,
            net_order=net_order,
            max_steps=max_steps,
            overflow=overflow,
        )
        self.autoreset = autoreset
        self._observation = observation or PaperObservation()
        self._reward = reward or PaperReward()
        self.single_observation_space = self._observation.space(
            self.engine.problems, overflow == "allowed"
        )
        self.num_problems, self.num_agents = self.engine.nets.shape
        self.present = self.engine.tasks > 0
        shape = self.engine.nets.shape
        self._seen = np.zeros((*shape, *self.single_observation_space.shape), np.float32)
        self._mask = np.zeros((*shape, MOVES), np.int8)
        self._rewards = np.zeros(shape, np.float32)
        self._terminated = np.zeros(shape, np.bool_)
        self._truncated = np.zeros(shape, np.bool_)
        self._over = np.zeros(shape[0], np.bool_)

    def reset(self) -> tuple[NDArray[np.float32], Info]:
        """Starts the episodes of all problems.

        Returns:
            (M, N, F) float32 observations, and the info as of :meth:`step`.
        """
        self.engine.reset()
        self._over[:] = False
        return self._seen, self._look()

    def step(
        self, actions: NDArray[np.integer]
    ) -> tuple[
        NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_], Info
    ]:
        """Moves all agents, of each problem in turn order.

        Args:
            actions: (M, N) integers, 0 to 5, or −1 for no move. Those of agents that are done or
                absent do not matter.

        Returns:
            * (M, N, F) float32 observations,
            * (M, N) float32 rewards, 0 for agents that did not move,
            * (M, N) bool terminated: the agent's tasks are all joined,
            * (M, N) bool truncated: the agent's tasks have all ended and some failed,
            * an info with ``action_mask`` (M, N, 6) int8; ``active`` (M, N) bool, agents that can
              move next; ``over`` (M,) bool, episodes that ended with this step; and ``overflow``,
              ``wirelength`` and ``joined`` (M,), the metrics of the episodes as they stand, which
              for those over are the final ones.

            ``terminated`` and ``truncated`` stay true until the problem's next episode starts.

        Raises:
            ValueError: an array of another shape, or an action out of its range.
        """
        if np.shape(actions) != self._rewards.shape:
            raise ValueError(
                f"actions: expected shape {self._rewards.shape}, found {np.shape(actions)}"
            )
        again = self._over if self.autoreset else np.zeros_like(self._over)
        playing = ~again & (self.engine.games["active"] > 0)
        self.engine.step(actions)
        self._rewards[:] = self._reward(self.engine.agents)
        self._rewards[~playing] = 0
        if again.any():
            self.engine.reset(again)
        self._over = playing & (self.engine.games["active"] == 0)
        info = self._look()
        return self._seen, self._rewards, self._terminated, self._truncated, info

    def _look(self) -> Info:
        """Fills the arrays that the caller sees."""
        engine = self.engine
        pairs = engine.pairs(everyone=True)
        self._observation.write(engine, *pairs, self._seen.reshape(-1, self._seen.shape[-1]))
        engine.masks(*pairs, self._mask.reshape(-1, MOVES))
        status = engine.agents["status"]
        np.equal(status, int(Status.TERMINATED), out=self._terminated)
        np.equal(status, int(Status.TRUNCATED), out=self._truncated)
        return {
            "action_mask": self._mask,
            "active": status == int(Status.ACTIVE),
            "over": self._over,
            **{key: engine.games[key] for key in ("overflow", "wirelength", "joined")},
        }
