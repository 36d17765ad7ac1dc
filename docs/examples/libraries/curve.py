"""What the recipes of this folder share: their arguments, the curve that they print, how they end.

::

    python RECIPE.py [ALGORITHM] [--seed 0] [--steps N]

A recipe prints a row from time to time. It ends when its policy joins 0.95 of the nets or more,
with exit status 0. If it has not come so far after N steps, its exit status is 1.
"""

import argparse
import sys
import time

GOAL = 0.95


class Curve:
    """The rows of one training: steps, processor seconds, share of the nets joined.

    Args:
        algorithms: words that the recipe takes, the first of them unless another is given.
        steps: moves of nets after which it gives up, unless ``--steps`` is given.

    Attributes:
        algorithm, seed, steps: what is given on the command line.
    """

    def __init__(self, *algorithms: str, steps: int) -> None:
        parser = argparse.ArgumentParser()
        if algorithms:
            first = algorithms[0]
            parser.add_argument("algorithm", nargs="?", choices=algorithms, default=first)
        parser.add_argument("--seed", type=int, default=0)
        parser.add_argument("--steps", type=int, default=steps)
        given = parser.parse_args()
        self.algorithm: str = getattr(given, "algorithm", "")
        self.seed: int = given.seed
        self.steps: int = given.steps
        self._share = 0.0
        print("steps processor_seconds joined", flush=True)

    def row(self, steps: int, joined: float) -> bool:
        """Prints a row; returns whether to go on.

        Args:
            steps: moves of nets so far.
            joined: the share of the nets that the policy joins without exploration.
        """
        self._share = joined
        print(int(steps), round(time.process_time(), 1), round(joined, 3), flush=True)
        return joined < GOAL and steps < self.steps

    def end(self) -> None:
        """Ends the process, with an error unless the last row has come to 0.95."""
        if self._share < GOAL:
            sys.exit(f"joined {self._share:.3f} of the nets, expected {GOAL} or more")
        sys.exit()
