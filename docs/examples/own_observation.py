"""An own observation: the same 12 numbers as the paper's, and how crowded the grid is around.

An observation is any class with the two methods of ``marouting.Observation``. It works in every
interface of the environment, in the batch and in training. In YAML, which takes ``--allow-code``,
it goes by its module and class::

    env:
      observation: {kind: "own_observation:CrowdedObservation", radius: 2}
"""

import numpy as np
from gymnasium.spaces import Box

import marouting
from marouting import PaperObservation, global_routing_v0


class CrowdedObservation:
    """The paper's numbers, and how many other agents stand within some Gcells.

    Args:
        radius: Gcells in x and in y.
    """

    def __init__(self, radius: int = 1) -> None:
        self.paper, self.radius = PaperObservation(), radius

    def space(self, problems, overflow):
        """What one agent's observation looks like."""
        inner = self.paper.space(problems, overflow)
        most = np.float32(max(len(problem.nets) for problem in problems))
        return Box(np.append(inner.low, np.float32(0)), np.append(inner.high, most))

    def write(self, games, problems, agents, out):
        """Fills a row of ``out`` (K, 13) for each of K agents; −1 stands for no agent."""
        self.paper.write(games, problems, agents, out[:, :-1])
        x_y = games.grid.position[games.agents["cell"], :2]  # (M, N, 2)
        active = games.agents["status"] == 0  # (M, N)
        own = x_y[problems, agents]  # (K, 2)
        near = (np.abs(x_y[problems] - own[:, None]) <= self.radius).all(axis=2)  # (K, N)
        others = (near & active[problems]).sum(axis=1) - active[problems, agents]
        out[:, -1] = np.where(agents < 0, 0, others)


if __name__ == "__main__":
    problem = {"nets": 30, "seed": 1, "reduced_edges": 0}

    # As an object, in the Parallel environment.
    env = global_routing_v0.parallel_env(problem, observation=CrowdedObservation(radius=2))
    observations, infos = env.reset(seed=0)
    crowd = [int(observations[agent][-1]) for agent in env.agents]
    print("shape:", env.observation_space(env.agents[0]).shape)
    print("others within two Gcells:", crowd)

    # By name, in a configuration.
    marouting.register("observation", "crowded", CrowdedObservation)
    config = {"env": {"problem": problem, "observation": {"kind": "crowded", "radius": 0}}}
    observation, info = marouting.make(config).reset(seed=0)
    print(f"others where {info['net']} stands:", int(observation[-1]))
