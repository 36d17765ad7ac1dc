"""Jumanji's Connector, to compare speeds with: ``python -m policies.bench --against jumanji``.

Connector-v3 (Bonnet et al., *Jumanji: a Diverse Suite of Scalable Reinforcement Learning
Environments in JAX*, 2024) is the nearest relative in a compiled library: ten agents on a 10×10
grid lay paths that may not cross. It runs as its authors do, ``vmap`` and ``jit``; a whole episode
is one ``lax.scan``, with every step's observation, mask and reward carried along, so that nothing
is left out and no time goes into calls. Its resets, which take far longer than its steps, are not
counted.

Neither jumanji nor jax is a dependency: they are imported by a process of their own, and only
there.
"""

import contextlib
import importlib.util
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator

from marouting import InputError

_STEPS = 50  # Connector's own time limit
_EPISODES = 4  # for every answer: long enough for a clock, short enough to take turns


@contextlib.contextmanager
def one_core() -> Iterator[None]:
    """Keeps this thread, and every process that it starts, on one of its cores.

    By ``os.sched_setaffinity``; where the system has none, nothing is kept.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


class Connector:
    """A process that plays Connector-v3 whenever it is called.

    Threads of XLA are as many as the process has cores: started within :func:`one_core`, one.

    Args:
        batch: games side by side.

    Raises:
        InputError: jumanji is not installed, or does not run.
    """

    def __init__(self, batch: int) -> None:
        if importlib.util.find_spec("jumanji") is None:
            raise InputError("--against jumanji: expected the package jumanji: pip install jumanji")
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 - closed with the process
        self._process = subprocess.Popen(
            [sys.executable, "-c", f"from policies.bench.jumanji import serve; serve({batch})"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            env={**os.environ, "JAX_PLATFORMS": "cpu"},
        )
        self._answer()  # compiled

    def __call__(self) -> float:
        """Plays some episodes with random moves; returns the agent-steps."""
        assert self._process.stdin is not None
        print(file=self._process.stdin, flush=True)
        return self._answer()

    def _answer(self) -> float:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            self._process.communicate()
            self._errors.seek(0)
            last = (self._errors.read().strip().splitlines() or ["it ended without a word"])[-1]
            raise InputError(f"--against jumanji: expected it to run, found {last}")
        return float(line)

    def close(self) -> None:
        """Ends the process."""
        self._process.communicate()
        self._errors.close()

    def __enter__(self) -> "Connector":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def serve(batch: int) -> None:
    """What the process does: 0 once all is compiled; then for every line the agent-steps made."""
    import jax
    import jumanji
    import numpy as np

    env = jumanji.make("Connector-v3")
    start = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.PRNGKey(0), batch))
    shape = (_STEPS, batch, env.num_agents)
    moves = jax.numpy.asarray(np.random.default_rng(0).integers(5, size=shape), np.int32)

    @jax.jit
    def play(first: object, moves: object) -> object:
        def step(now: tuple[object, object], move: object) -> tuple[object, None]:
            return jax.vmap(env.step)(now[0], move), None

        return jax.lax.scan(step, first, moves)[0]

    jax.block_until_ready(play(start, moves))
    print(0, flush=True)
    for _ in sys.stdin:
        for _ in range(_EPISODES):
            jax.block_until_ready(play(start, moves))
        print(_EPISODES * moves.size, flush=True)
