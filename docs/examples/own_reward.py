"""An own reward: one that pays the whole team for what all nets together use.

A reward is any callable like ``marouting.Reward``: it is asked about every single move and sees the
games before and after it. In YAML it goes by its module and class
(``marouting train own.yaml --allow-code``)::

    env:
      reward: {kind: "own_reward:TeamReward", joined: 20}
"""

import numpy as np

from marouting import global_routing_v0


class TeamReward:
    """Every net is paid the same: for each task that any net joins, less the wire it took.

    Args:
        joined: for a task that is joined.
        wire: taken off for every edge newly used.
    """

    def __init__(self, joined: float = 10.0, wire: float = 1.0) -> None:
        self.joined, self.wire = joined, wire

    def __call__(self, games, before, movers):
        """(M, N) what the moves of ``movers`` (M,) pay the N agents of each problem."""
        del movers  # everybody is paid, whoever moved
        now, then = games.games, before.games  # (M,) records
        joined = now["joined"] - then["joined"]
        wire = now["wirelength"] - then["wirelength"]
        paid = self.joined * joined - self.wire * wire
        return np.broadcast_to(paid[:, None], games.agents.shape)


if __name__ == "__main__":
    env = global_routing_v0.env(problem={"nets": 10, "seed": 1}, reward=TeamReward(), max_steps=500)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    paid = dict.fromkeys(env.agents, 0.0)
    for agent in env.agent_iter():
        # What others' moves have paid an agent accumulates until its turn.
        _, reward, terminated, truncated, info = env.last()
        paid[agent] += reward
        last = agent
        over = terminated or truncated
        env.step(None if over else int(rng.choice(np.flatnonzero(info["action_mask"]))))
    metrics = env.unwrapped.metrics()
    expected = 10 * metrics["joined"] - metrics["wirelength"]
    print(f"joined {metrics['joined']} of {metrics['tasks']}, wirelength {metrics['wirelength']}")
    print(f"{last} was the last to finish and was paid for all that happened: {paid[last]:.0f}")
    print(f"10 × joined − wirelength: {expected}")
