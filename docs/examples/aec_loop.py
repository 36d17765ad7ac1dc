"""Every net in turn: PettingZoo's AEC loop with two simple policies.

An agent sees 12 numbers: where it stands (x, y, z), how far its target is (dx, dy, dz), and the
remaining capacity of the six edges around it. The action mask says which moves cross an edge.
"""

import numpy as np

from marouting import Move, global_routing_v0

TOWARDS = (
    (3, Move.EAST, Move.WEST),  # the number that holds the distance, the move for +, that for −
    (4, Move.NORTH, Move.SOUTH),
    (5, Move.UP, Move.DOWN),
)


def at_random(_, mask, rng):
    """Any move that crosses an edge."""
    return int(rng.choice(np.flatnonzero(mask)))


def towards_the_target(observation, mask, rng):
    """A move that comes nearer; where none crosses an edge, or one time in ten, any move."""
    nearer = [
        plus if observation[i] > 0 else minus for i, plus, minus in TOWARDS if observation[i] != 0
    ]
    nearer = [int(move) for move in nearer if mask[move]]
    if not nearer or rng.random() < 0.1:
        return at_random(observation, mask, rng)
    return nearer[rng.integers(len(nearer))]


def play(policy, seed):
    """One episode; returns the metrics and the sum of all rewards."""
    env = global_routing_v0.env(problem={"nets": 20, "seed": 1, "reduced_edges": 0})
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    total = 0.0
    for _ in env.agent_iter():
        observation, reward, terminated, truncated, info = env.last()
        total += reward
        over = terminated or truncated
        env.step(None if over else policy(observation, info["action_mask"], rng))
    return env.unwrapped.metrics(), total


for policy in (at_random, towards_the_target):
    metrics, total = play(policy, seed=0)
    print(
        f"{policy.__name__}: joined {metrics['joined']} of {metrics['tasks']}, "
        f"wirelength {metrics['wirelength']}, rewards {total:.0f}"
    )
