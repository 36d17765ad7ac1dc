"""An own policy as a router: it plays the environment, and the benchmark scores its routes.

marouting benchmark --scenario toy-4x4-v0 --router own_policy:OwnPolicy
"""

import numpy as np

import marouting
from marouting import global_routing_v0


class OwnPolicy:
    """Every net moves towards its target where it can; put your network in the place of ``act``."""

    def route(self, problem: marouting.Problem) -> marouting.Solution:
        """The routes of one episode."""
        env = global_routing_v0.parallel_env(problem=problem)
        observations, infos = env.reset(seed=0)
        while env.agents:
            actions = {a: self.act(observations[a], infos[a]["action_mask"]) for a in env.agents}
            observations, *_, infos = env.step(actions)
        return env.solution()

    def act(self, observation, mask) -> int:
        """The first unblocked move that brings the net nearer to its target, else a via."""
        dx, dy = observation[3:5]
        wanted = [dx > 0, dx < 0, dy > 0, dy < 0, True, True]
        return int(np.argmax(mask * wanted))


if __name__ == "__main__":
    problem = marouting.generate(1, grid=(6, 6, 2), nets=8, seed=1)[0]
    print(marouting.evaluate(problem, OwnPolicy().route(problem)))
