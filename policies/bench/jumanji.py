"""Jumanji's Connector, to compare speeds with: ``python -m policies.bench --against jumanji``.

Connector-v3 (Bonnet et al., *Jumanji: a Diverse Suite of Scalable Reinforcement Learning
Environments in JAX*, 2024) is the nearest relative in a compiled library: ten agents on a 10×10
grid lay paths that may not cross. It runs as its authors do, ``vmap`` and ``jit``; a whole episode
is one ``lax.scan``, with every step's observation, mask and reward carried along, so that nothing
is left out and no time goes into calls. Its resets, which take far longer than its steps, are not
counted.
"""

import contextlib
import importlib.util
import os
from collections.abc import Iterator

import numpy as np

from marouting import InputError
from policies.bench.measure import Work

_STEPS = 50  # Connector's own time limit
_EPISODES = 4  # for every call: long enough for a clock, short enough to take turns


@contextlib.contextmanager
def one_core() -> Iterator[None]:
    """Keeps this thread, and those that it starts, on one of its cores, where the system can."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def connector(batch: int) -> Work:
    """Episodes of games of Connector-v3 side by side, with random moves; gives the agent-steps.

    Threads of XLA are as many as cores when it is imported here: within :func:`one_core`, one.

    Raises:
        InputError: jumanji is not installed; neither it nor jax is a dependency.
    """
    if importlib.util.find_spec("jumanji") is None:
        raise InputError("--against jumanji: expected the package jumanji: pip install jumanji")
    os.environ["JAX_PLATFORMS"] = "cpu"
    import jax
    import jumanji

    env = jumanji.make("Connector-v3")
    start = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.PRNGKey(0), batch))
    shape = (_STEPS, batch, env.num_agents)
    moves = jax.numpy.asarray(np.random.default_rng(0).integers(5, size=shape), np.int32)

    @jax.jit
    def play(first: object, moves: object) -> object:
        def step(now: tuple[object, object], move: object) -> tuple[object, None]:
            return jax.vmap(env.step)(now[0], move), None

        return jax.lax.scan(step, first, moves)[0]

    def work() -> float:
        for _ in range(_EPISODES):
            jax.block_until_ready(play(start, moves))
        return _EPISODES * float(moves.size)

    return work
