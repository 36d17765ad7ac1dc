"""Calls as tasks of Ray, on this machine or on many.

Ray chooses where a task runs and when, sends its arguments, and runs it again when its process or
its machine is lost. Here calls become tasks, and a Ray is started or joined. Files are not sent:
what tasks read and write has to lie on storage that all machines see.
"""

import contextlib
import logging
import os
import signal
import socket
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import ray
from ray.exceptions import RayError, RayTaskError

from marouting.errors import InputError
from marouting.registry import allowing_code, code_allowed, register, registered
from marouting.scenarios import load, loaded
from policies.engines.base import THREADS, Call, environment

RETRIES = 3
"""How often a task is run again whose process or machine was lost."""

ADDRESS = "RAY_ADDRESS"
"""The variable that says where a Ray runs that is to be joined."""


def _start(cpus: int) -> None:
    """Starts or joins a Ray; raises InputError if that is not possible."""
    where = os.environ.get(ADDRESS)
    own: dict[str, Any] = {"address": "local", "num_cpus": cpus, "include_dashboard": False}
    # Its processes find what this one finds. On other machines that is the user's: runtime_env.
    paths = os.pathsep.join(path or str(Path.cwd()) for path in sys.path)
    handler = signal.getsignal(signal.SIGTERM)
    try:
        if where:
            _check_reachable(where)
        with environment(PYTHONPATH=paths, RAY_USAGE_STATS_ENABLED="0"):
            ray.init(**({} if where else own), log_to_driver=False, logging_level=logging.CRITICAL)
    except (ConnectionError, RuntimeError, ValueError, OSError, RayError) as error:
        reason = str(error).strip().splitlines()[0] if str(error).strip() else repr(error)
        expected = f"{ADDRESS}={where}: expected a Ray" if where else "engine: no Ray starts"
        raise InputError(f"{expected}: {reason}") from None
    finally:
        with contextlib.suppress(ValueError, TypeError):  # of another thread, or none of Python's
            signal.signal(signal.SIGTERM, handler)  # Ray's own leaves with another status


def _check_reachable(where: str) -> None:
    """Raises OSError if nobody answers at host:port; Ray itself would try for minutes."""
    host, _, port = where.removeprefix("ray://").rpartition(":")
    if host and port.isdecimal():
        socket.create_connection((host.strip("[]"), int(port)), _PATIENCE).close()


_PATIENCE = 10.0
"""Seconds to wait for an answer of a Ray that is to be joined."""


class RayEngine:
    """Runs calls as tasks of Ray, with as many CPUs as threads.

    That is the Ray at RAY_ADDRESS, or this process's own if it has one, or else a new one, which
    uses only this machine, with a limit of parallel tasks, no log output, no dashboard and no usage
    statistics, and ends with the engine or with this process.

    Raises:
        InputError: there is none at RAY_ADDRESS, none can be started, or no task ever has so many
            CPUs.
    """

    def __init__(self, jobs: int, threads: int) -> None:
        self._threads = threads
        self._running: dict[Any, int] = {}
        self._started_here = not ray.is_initialized()
        if self._started_here:
            _start(jobs * threads)
        most = max((node["Resources"].get("CPU", 0) for node in _nodes()), default=0)
        if most < threads:
            self.close()
            raise InputError(f"threads: expected at most {most:g}, as the Ray has, found {threads}")

    def run(self, calls: Sequence[Call]) -> Iterator[dict[int, Any]]:
        """Makes calls; see :meth:`policies.engines.base.Engine.run`."""
        gpus = max((call.gpus for call in calls), default=0)
        if gpus > max((node["Resources"].get("GPU", 0) for node in _nodes()), default=0):
            raise InputError("device: expected cpu: this Ray has no GPU")
        variables = {"env_vars": dict.fromkeys(THREADS, str(self._threads))}
        task = ray.remote(max_retries=RETRIES, num_cpus=self._threads, runtime_env=variables)(_run)
        context = ray.put((str(Path.cwd()), registered(), loaded(), code_allowed()))
        self._running = {
            task.options(num_gpus=call.gpus).remote(call.function, context, *call.arguments): number
            for number, call in enumerate(calls)
        }
        while self._running:
            done, _ = ray.wait(list(self._running), timeout=1)
            # Of all others that are ready, too: each look takes time in proportion to all.
            if done:
                done, _ = ray.wait(list(self._running), num_returns=len(self._running), timeout=0)
            yield {self._running.pop(one): _result(one) for one in done}

    def close(self) -> None:
        """Ends the tasks at once."""
        for task in self._running:
            with contextlib.suppress(RayError, ValueError):
                ray.cancel(task, force=True)
        if self._started_here:
            ray.shutdown()


def _nodes() -> list[dict[str, Any]]:
    """The machines that are there."""
    nodes: Any = ray.nodes  # untyped
    return [node for node in nodes() if node["Alive"]]


def _run(
    function: Any,
    context: tuple[str, Sequence[tuple[str, str, str]], Sequence[str], bool | frozenset[str]],
    *arguments: Any,
) -> Any:
    """A task; it works in the folder of the process that asked for it, as that one would.

    It knows the same components and scenarios by name, and files may name the same code.
    """
    folder, components, scenarios, allowed = context
    for component in components:
        register(*component)
    try:
        with allowing_code(allowed), contextlib.chdir(folder):
            for name in scenarios:
                load(name)
            return function(*arguments)
    except FileNotFoundError as error:
        if error.filename != folder:
            raise
        raise InputError(f"{folder}: expected this folder on every machine of the Ray") from None


def _result(task: Any) -> Any:
    """What a task returned; raises what it raised."""
    try:
        return ray.get(task)
    except RayTaskError as error:
        raise error.cause from None
    except RayError as error:
        reason = str(error).strip().splitlines()[0]
        raise InputError(
            f"a task was lost {RETRIES + 1} times, perhaps because memory ran out: expected fewer "
            f"at once, or smaller problems: {reason}"
        ) from None
