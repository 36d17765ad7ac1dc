"""# Global Routing, version 0.

![An episode: each color is a net, each head an agent](pictures/episode.svg)

Every net of a chip is an agent, and all agents route on one grid of Gcells. A route uses capacity
of the edges that it crosses, so nets compete for edges.

| | |
|---|---|
| Import | `from marouting import global_routing_v0` |
| Actions | Discrete |
| Parallel API | Yes, natively |
| Manual control | No |
| Agents | `net_0`, `net_1`, …: every net |
| Action shape | () |
| Action values | 0 to 5; 0 to 6 where agents choose rip-up |
| Observation shape | (12,), float32; another one with another `observation` |
| Observation values | see the table below |
| State shape | (X, Y, 5 Z), float32, on a grid of X×Y×Z Gcells |
| Render modes | `ansi`, `rgb_array`, `human` |

A net's pins are split into two-pin **tasks**, which its agent routes one after the other: it starts
at one pin and moves to the other, one Gcell per step. `env.unwrapped.solution()` returns the
routes, which `marouting.evaluate` judges by the rules of the ISPD 2008 contest.
:mod:`marouting.game` has all rules of the game.

## Usage

```python
from marouting import global_routing_v0

env = global_routing_v0.env(problem={"nets": 10, "seed": 1}, render_mode="ansi")
env.reset(seed=42)
for agent in env.agent_iter():
    observation, reward, terminated, truncated, info = env.last()
    over = terminated or truncated
    env.step(None if over else env.action_space(agent).sample(info["action_mask"]))
print(env.render())
```

`parallel_env` is the same game with PettingZoo's Parallel interface: in each step the nets move one
after the other in turn order, as they do in `env`. `raw_env` is `env` without the wrappers that
check actions and the order of calls. `gymnasium.make("marouting/GlobalRouting-v0")` is the game for
one player, who moves all nets.

## Agents

Every net is an agent. A net with all its pins in one Gcell has nothing to route and is no agent;
`idle_nets` lists it. An agent leaves when all its tasks have ended. With `agents_persist` it stays
among `agents`, with rewards of 0 and a mask whose only move does nothing, until all agents end
together; from the first step on, `info["active"]` says whether an agent still plays.

## Actions

| action | move |
|---:|---|
| 0 | EAST, +x |
| 1 | WEST, −x |
| 2 | NORTH, +y |
| 3 | SOUTH, −y |
| 4 | UP, +z: a via to the layer above |
| 5 | DOWN, −z: a via to the layer below |
| 6 | rip up the agent's own net; only with `rip_up={"choose": "agents"}` |

A move across an edge without enough remaining capacity, or off the grid, is **blocked**: the agent
stays, and the step counts. An edge that the net already uses is free to cross again. Vias have
unlimited capacity.

## Action mask

`info["action_mask"]` and `action_mask(agent)` hold an int8 array of length 6, with 1 for every move
that is not blocked. The mask is never all zero: if all moves are blocked, it is all ones. The infos
of `reset` hold nothing else. With `mask={"in_observation": True}` observations are dictionaries
with the keys `observation` and `action_mask`; `observation_key` and `mask_key` beside it give both
other names.

## Observation space

The paper's 12 numbers, in Gcells and tracks:

| index | number | values |
|---|---|---|
| 0–2 | x, y, z of the agent's Gcell | 0 to X − 1, Y − 1, Z − 1 |
| 3–5 | x, y, z of the target less those of the agent | −(X − 1) to X − 1, and so on |
| 6–9 | remaining capacity of the edges of moves 0 to 3 | 0 off the grid, negative in overflow |
| 10–11 | the same for moves 4 and 5, the vias | 10, or 0 off the grid |

Two other observations have numbers of order 1 and the same shape on every grid, so that one network
fits all problems:

* `window` (:class:`marouting.batch.window.WindowObservation`): the Gcells around the agent, with
  remaining capacity, the demand expected of other nets, its own edges and pins, and other agents.
  It is mirrored so that the target lies ahead; `mirrored` turns its moves into those of the grid,
  and trainings do so by themselves.
* `outlook` (:class:`policies.generalist.outlook.OutlookObservation`): each move's extra
  shortest-path cost, the net's open pins, and a window with all layers in one. The generalist
  learns from it.

```python
import numpy as np
from marouting import global_routing_v0
from marouting.batch.window import mirrored, move_order

env = global_routing_v0.env(observation={"kind": "window", "radius": 3, "layers": 1})
env.reset(seed=42)
observation, *_, info = env.last()
free = np.take_along_axis(info["action_mask"], move_order(observation), -1)
ahead = free.argmax()  # 0, the first move of the window: towards the target in x
env.step(int(mirrored(ahead, observation)))
```

## State

`state()` has five numbers for each Gcell: the remaining capacity of its edges towards +x and +y,
the number of nets that use its via upwards, the number of agents in it, and the number of agents
whose target it is. With the observation `window` it has that observation's channels for the whole
grid.

## Rewards

The agent that moves gets +100 when it reaches the target pin of its task, and −1 for any other
move. `reward="normalised"` pays +1 and −0.01. For cooperative rewards there are `team`,
`difference`, `potential` and `mixed` (:mod:`marouting.rewards`):

```python
from marouting import global_routing_v0

env = global_routing_v0.parallel_env(
    problem={"nets": 10, "count": 50},
    reward={"kind": "mixed", "parts": [{"kind": "paper"}, {"kind": "team", "weight": 0.1}]},
)
```

## End of an episode

A task is **joined** when the agent reaches its target, and **fails** after `max_steps` steps. Then
the next one starts. An agent is **terminated** when all its tasks are joined. It is **truncated**
when its last task has ended and at least one failed. Agents that end with the game, the last of all
or with `agents_persist` every one, have the game's `metrics` in their last info (overflow,
wirelength, tasks joined, tasks, steps), and as `overflow`, `wirelength`, `joined`, `tasks`, `open`,
`steps` and `is_success` what loggers look for.

The info after a move that ended a task, the last one as well, has `task_ended` (1: joined, 2: it
failed), and as `task_obs` and `task_mask` what the agent saw where it arrived; the observation is
that of its next task. In the AEC environment it comes with the agent's next turn. To bootstrap, use
`task_obs` after a failed task, which only ran out of steps, and nothing after a joined one.

## Rip-up and reroute

With `rip_up={"rounds": K}` nets are ripped up after all have been routed, and rerouted around the
others. A reroute that makes the solution worse is undone. `choose` selects the nets of a round.
With `choose: agents` each agent decides in its turn: action 6 rips up its own net.

```python
from marouting import global_routing_v0

env = global_routing_v0.parallel_env(
    target="tree",
    next_pin="nearest",
    mask={"visited": True},
    release_failed=True,
    rip_up={"rounds": 3, "choose": "conflicts", "neighbours": 2},
    reward={"kind": "difference", "open": 20},
)
```

Agents that wait for the next round stay in `agents`, with a mask whose only move does nothing. From
the first step on, `info["active"]` says who still moves. Nets that all move as A* does connect 4 of
10 test problems of `multi-pin-8x8-v0` completely by the paper's rules, and 9 of 10 with three
rounds and two neighbours ([`rip_up.py`](examples/rip_up.py)).

## Problems

`problem` is a `Problem`, a file, or a mapping of the generator's options
(:class:`marouting.generator.GeneratorOptions`). It may also be several of these, such as a folder;
then every episode plays one of them, drawn at random, and `problem_name` names it. With `scenario`
and `split` the environment plays a level of the benchmark (:mod:`marouting.scenarios`): a new
training problem in every episode, or one of the validation or test problems.

## Many problems at once

`BatchEnv` plays M problems side by side in arrays of shape (M, agents, …), compiled. It plays the
same game: `tests/test_game.py` compares the two. `info` says which agents moved (`acted`), whether
a task ended (`task_ended`: 1 joined, 2 failed), and what they observed on arrival, before the next
task began (`final_obs`):

```python
import numpy as np
import marouting
from marouting.vector import BatchEnv

env = BatchEnv(marouting.generate(8, nets=10, seed=1))
obs, info = env.reset()
before = obs.copy()  # the next step overwrites the arrays
actions = info["action_mask"].argmax(axis=-1)
obs, reward, terminated, truncated, info = env.step(actions)
ended = info["task_ended"] != 0
next_obs = np.where(ended[..., None], info["final_obs"], obs)
bootstrap = info["task_ended"] != 1  # a failed task only ran out of steps
# Where info["acted"], a transition is (before, actions, reward, next_obs, bootstrap).
```

`BatchEnv(64, scenario="mixed-v0")` plays 64 games, each with a new problem in every episode; the
names are in `info["problem"]`. `BatchEnv(64, problem={"nets": 10, "seed": None})` and `BatchEnv(64,
problem="folder")` do the same. The same seed gives the same problems for any number of `threads`.
`save()` and `restore()` handle the state of all games, and `set_order()` the turn order.
[`batch_ppo.py`](examples/libraries/batch_ppo.py) is PPO on it in 60 lines.

## Arguments

`env`, `raw_env`, `parallel_env` and `gymnasium.make` take them as keywords, and configurations
under the key `env` (:class:`marouting.options.GameOptions`).

## Version history

* v0: first release.
"""

from typing import Any

from pettingzoo import AECEnv
from pettingzoo.utils.wrappers import AssertOutOfBoundsWrapper, OrderEnforcingWrapper

from marouting.env.aec import GlobalRoutingAEC as raw_env
from marouting.env.parallel import GlobalRoutingParallel as parallel_env
from marouting.source import Source

__all__ = ["env", "parallel_env", "raw_env"]


def env(problem: Source = None, **options: Any) -> AECEnv:
    """The AEC environment with the wrappers that check actions and the order of calls.

    Args:
        problem: see :data:`marouting.source.Source`.
        **options: the fields of :class:`marouting.options.GameOptions`.

    Raises:
        InputError: an option or the problem cannot be used.
    """
    return OrderEnforcingWrapper(AssertOutOfBoundsWrapper(raw_env(problem, **options)))
