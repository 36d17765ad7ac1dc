"""Rip-up and reroute: what options of the game bring to nets that all move as A* does.

All ten test problems of ``multi-pin-8x8-v0`` that are played here can be routed without overflow.
But nets that are routed first take edges that others need. Rip-up rounds reroute them.

    python docs/examples/rip_up.py
"""

import time
from typing import Any

from marouting import Engine, evaluate, scenarios
from marouting.search.guides import AStar

OPTIONS: dict[str, dict[str, Any]] = {
    "the paper's game": {},
    "target: tree": {"target": "tree"},
    "and next_pin: nearest": {"target": "tree", "next_pin": "nearest"},
    "and 3 rounds": {"rip_up": {"rounds": 3}},
    "and 2 neighbours": {"rip_up": {"rounds": 3, "neighbours": 2}},
    "and 10 rounds of conflicts": {
        "rip_up": {"rounds": 10, "choose": "conflicts", "neighbours": 2},
    },
    "and 10 rounds by history": {"rip_up": {"rounds": 10, "choose": "history", "neighbours": 2}},
}  # fmt: skip
NET_AWARE = {"target": "tree", "next_pin": "nearest", "release_failed": True}

scenario = scenarios.get("multi-pin-8x8-v0")
problems = scenario.test[:10]
print(f"{'options':28} {'open tasks':>10} {'joined problems':>15} {'above optimum':>13} {'s':>6}")
for name, options in OPTIONS.items():
    engine = Engine(problems, **(NET_AWARE if "rip_up" in options else {}), **options)
    guide, start = AStar(engine), time.process_time()
    while (engine.games["agent"] >= 0).any():
        engine.step(guide.moves(*engine.pairs(everyone=False)))
    seconds = time.process_time() - start
    found = [evaluate(problem, engine.solution(m)) for m, problem in enumerate(problems)]
    best = [scenario.reference(problem).wirelength for problem in problems]
    open_tasks = sum(judged.tasks - judged.joined for judged in found)
    whole = [m for m, judged in enumerate(found) if judged.connected]
    above = "-"
    if whole:
        ratio = sum(found[m].wirelength for m in whole) / sum(best[m] for m in whole)
        above = f"{100 * (ratio - 1):.1f} %"
    print(f"{name:28} {open_tasks:10} {len(whole):15} {above:>13} {seconds:6.2f}")
