"""A rule of one's own: vias run out, as they do in the code of the paper's authors.

The rules are the methods of ``marouting.game.Game``. A subclass changes one of them, and an
environment with this game plays by it::

    class ScarceViasAEC(global_routing_v0.raw_env):
        game_class = ScarceVias
"""

import numpy as np

from marouting import generate, global_routing_v0
from marouting.game import NEW, Game
from marouting.problem.grid import AXES, VIA_AXIS

TRACKS = 10


class ScarceVias(Game):
    """Between two layers of a Gcell there are ten tracks, of which every net takes one."""

    def reset(self) -> None:
        """All tracks are free."""
        super().reset()
        for via in range(VIA_AXIS, len(self.remaining), AXES):
            self.remaining[via] = min(self.remaining[via], TRACKS)

    def _take(self, n: int, edge: int, sign: int = 1) -> int:
        """A net takes a track of a via as it takes its demand of other edges."""
        if edge % AXES != VIA_AXIS:
            return super()._take(n, edge, sign)
        self.remaining[edge] -= sign
        return 0


class ScarceViasAEC(global_routing_v0.raw_env):
    """The AEC environment by this rule."""

    game_class = ScarceVias


if __name__ == "__main__":
    problem = generate(1, nets=50, seed=0, reduced_edges=0)[0]
    env = ScarceViasAEC(problem)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    crossed = 0
    for agent in env.agent_iter():
        _, _, terminated, truncated, info = env.last()
        over = terminated or truncated
        env.step(None if over else int(rng.choice(np.flatnonzero(info["action_mask"]))))
        crossed += not over and env.game.crossing[env.possible_agents.index(agent)] == NEW
    left = np.array(env.game.remaining)[VIA_AXIS::AXES]
    there = np.array(problem.capacity)[VIA_AXIS::AXES] > 0
    print("wirelength:", env.metrics()["wirelength"], "= new edges crossed:", crossed)
    print("tracks left of the fullest via:", int(left[there].min()))
