"""Games on a CUDA device compared with the same games on the processor, to the bit."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import marouting
from marouting.vector import BatchEnv
from policies.bench.cuda import WINDOW, on_host

WINDOW_ALL = {"kind": "window", "channels": ["capacity", "history", "own", "pins", "heads"]}

CASES: Sequence[Mapping[str, Any]] = (
    {},
    {"everyone": False},
    {"everyone": False, "turn_order": "round_robin"},
    {"turn_order": "sequential"},
    {"overflow": "allowed", "reward": {"kind": "normalised", "overflow_price": 2.0}},
    {"target": "tree", "nets": {"decomposition": "steiner"}},
    {"next_pin": "nearest"},
    {"mask": {"visited": True}, "release_failed": True, "max_steps": 20},
    {"rip_up": {"rounds": 2, "choose": "conflicts", "neighbours": 1}},
    {"rip_up": {"rounds": 1, "choose": "agents"}, "everyone": False},
    {"rip_up": {"rounds": 2, "choose": "history"}},
    {"observation": WINDOW, "reward": "team"},
    {"observation": WINDOW_ALL, "reward": "counterfactual", "everyone": False},
    {"observation": {**WINDOW, "channels": ["messages"]}, "wait": True, "message_bits": 3},
)
"""Options by which games are compared."""


def difference(host: Mapping[str, Any], found: Mapping[str, Any]) -> str | None:
    """The name of the first array that differs; None if all are equal to the bit."""
    for name, value in host.items():
        if isinstance(value, Mapping):
            inner = difference(value, found[name])
            if inner is not None:
                return f"{name}.{inner}"
        elif not np.array_equal(on_host(value), on_host(found[name])):
            return name
    return None


def compare(
    problems: Sequence[marouting.Problem], steps: int, seed: int = 0, **options: Any
) -> str | None:
    """Plays the same random moves on the processor and on the device.

    Args:
        problems: what is played.
        steps: how many steps; episodes begin again as they end.
        seed: of the moves; one in twenty is no move.
        **options: of the environments.

    Returns:
        What differs first, with the number of the step; None if nothing does.
    """
    host = BatchEnv(problems, **options)
    other: Any = BatchEnv(problems, device="cuda", **options)
    rng = np.random.default_rng(seed)
    order, number = host.engine.order, np.arange(len(problems))[:, None]
    place = np.arange(order.shape[1])
    turned = np.where(order < 0, place, order)  # the agent on the processor of a row of the device
    if np.array_equal(other.nets, host.engine.nets):
        order = turned = np.broadcast_to(place, order.shape)

    def by_row(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {name: by_row(part) for name, part in value.items()}
        rows = options.get("everyone", True) and np.ndim(value) > 1
        return value[number, turned] if rows else value

    obs, info = host.reset()
    found, told = other.reset()
    for step in range(steps):
        agents, known = on_host(told["agents"]), by_row(info["agents"])
        if not np.array_equal(known, np.where(agents < 0, agents, order[number, agents])):
            return f"step {step}: agents"
        seen = {**by_row({"obs": obs, **info}), "agents": agents}
        differs = difference(seen, {"obs": found, **told})
        if differs is not None:
            return f"step {step}: {differs}"
        mask = info["action_mask"]
        moves = (mask * rng.random(mask.shape)).argmax(-1)
        moves[rng.random(moves.shape) < 0.05] = -1
        obs, *flags, info = host.step(moves)
        found, *others, told = other.step(by_row(moves).astype(np.int32))
        names = "reward", "terminated", "truncated"
        differs = difference(
            by_row(dict(zip(names, flags, strict=True))), dict(zip(names, others, strict=True))
        )
        if differs is not None:
            return f"step {step}: {differs}"
    if not np.array_equal(host.state(), on_host(other.state())):
        return "state"
    for m in range(len(problems)):
        if host.engine.solution(m) != other.solution(m):
            return f"routes of game {m}"
    return None
