"""# Global Routing, version 0.

![An episode: each color is a net, each head an agent](pictures/episode.svg)

Every net of a chip is an agent, and all agents share one grid of routing cells (Gcells). A route
uses capacity on every edge that it crosses, so nets compete for edges.

| | |
|---|---|
| Import | `from marouting import global_routing_v0` |
| Actions | Discrete |
| Parallel API | Yes, natively |
| Manual control | No |
| Agents | `net_0`, `net_1`, …: one per net |
| Action shape | () |
| Action values | 0 to 5; more with `rip_up={"choose": "agents"}`, `wait` and `message_bits` |
| Observation shape | (12,), float32, by default; depends on `observation` |
| Observation values | see the table below |
| State shape | (X, Y, 5 Z), float32, on a grid of X×Y×Z Gcells |
| Render modes | `ansi`, `rgb_array`, `human` |

A net's pins are split into two-pin **tasks**, which its agent routes one after the other: it starts
at one pin and moves to the other, one Gcell per step. `env.unwrapped.solution()` returns the
routes, which `marouting.evaluate` judges by the rules of the ISPD 2008 contest.
:mod:`marouting.game` defines all rules of the game.

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

`parallel_env` is the same game with PettingZoo's Parallel interface. Within a step its agents still
move one after another, in turn order, so two nets never claim the last track of an edge at once.
`raw_env` is `env` without the wrappers that check actions and the order of calls.
`gymnasium.make("marouting/GlobalRouting-v0")` is the same game with one agent that moves all nets.

## Agents

Every net is an agent, except those with all pins in one Gcell: they have nothing to route and are
listed in `idle_nets`. An agent leaves `agents` when all its tasks have ended. With
`agents_persist=True` it stays until the last agent is done. Until then it is paid if the reward
pays it, its mask allows a single action, which has no effect, and `info["active"]` is false (infos
have `active` from the first step on).

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
stays where it is, and the step counts towards `max_steps`. An edge that the net already uses is
free to cross again. Vias have unlimited capacity.

With `wait=True` there is one more move, the last one: the agent stays. The step counts and pays
like that of a blocked move. Waiting is never masked.

With `message_bits=k` every action also writes a message of k bits: with M moves, action
`move + M * message` makes the move and writes the message, so there are M · 2^k actions. The
message stands until the agent's next action. The observation `window` shows it to all agents
around, in its channel `messages`:

```python
from marouting import global_routing_v0

sees = {"kind": "window", "channels": ["capacity", "heads", "messages"], "message_bits": 2}
env = global_routing_v0.parallel_env(wait=True, message_bits=2, observation=sees)
observations, infos = env.reset(seed=42)
waits, moves = 6, 7
env.step(dict.fromkeys(env.agents, waits + moves * 3))  # all stay, and set both bits
```

## Action mask

`info["action_mask"]` and `action_mask(agent)` are int8 arrays with one entry per action: 1 for
moves that are not blocked. The mask is never all zeros: if every move is blocked, it is all ones.
After `reset`, infos contain only the mask. With `mask={"in_observation": True}` observations are
dictionaries with the keys `observation` and `action_mask`, which `observation_key` and `mask_key`
rename.

## Observation space

The paper's 12 numbers, in Gcells and tracks:

| index | number | values |
|---|---|---|
| 0–2 | x, y, z of the agent's Gcell | 0 to X − 1, Y − 1, Z − 1 |
| 3–5 | offset to the target in x, y, z (target minus agent) | −(X − 1) to X − 1, and so on |
| 6–9 | remaining capacity of the edges of moves 0 to 3 | 0 off the grid, negative if it overflows |
| 10–11 | the same for moves 4 and 5, the vias | 10, or 0 off the grid |

Two other observations have values of about ±1 and the same shape on every grid, so one network can
be used for all problems:

* `window` (:class:`marouting.batch.window.WindowObservation`): the Gcells around the agent, with
  remaining capacity, the expected demand of the other nets, the net's own edges and pins, and other
  agents. The window is mirrored so that the target is always in the +x, +y direction. `mirrored`
  converts an action of the window to one of the grid; the trainer does so automatically.
* `outlook` (:class:`policies.generalist.outlook.OutlookObservation`): each move's extra
  shortest-path cost, the net's unconnected pins, and a window with all layers merged. The network
  of the router `generalist` uses it.

```python
import numpy as np
from marouting import global_routing_v0
from marouting.batch.window import mirrored, move_order

env = global_routing_v0.env(observation={"kind": "window", "radius": 3, "layers": 1})
env.reset(seed=42)
observation, *_, info = env.last()
free = np.take_along_axis(info["action_mask"], move_order(observation), -1)
ahead = free.argmax()  # the first move that is free; 0 is towards the target in x
env.step(int(mirrored(ahead, observation)))
```

## State

`state()` has five numbers for each Gcell: the remaining capacity of its +x and +y edges, the number
of nets that use the via to the layer above, the number of agents in it, and the number of agents
whose target it is. With `observation="window"` the state has the channels of the window, for the
whole grid.

## Rewards

| `reward` | who is paid | for what |
|---|---|---|
| `paper` (default) | the agent that moves | +100 if it reaches its target, −1 for any other move |
| `normalised` | the agent that moves | the same with +1 and −0.01, as most libraries expect |
| `team` | every agent, also those that are done | the decrease in the cost of the whole solution |
| `difference` | the agent that moves | the same decrease |
| `counterfactual` | every agent | the decrease in the cost that is there because of its net |
| `potential` | the agent that moves | the decrease in its distance to the target |
| `mixed` | as its parts say | the weighted sum of several rewards |

The cost is wirelength + 10 × overflow + 100 × unconnected tasks; the factors are options
(:mod:`marouting.rewards`). Because of a net there are its wirelength and unconnected tasks, the
overflow that it adds, and tasks of other nets that failed because it alone was in their way. An
agent that is done has left `agents` and cannot be paid any more; with `agents_persist=True`, and in
`BatchEnv`, it is paid until the episode is over.

```python
from marouting import global_routing_v0

env = global_routing_v0.parallel_env(
    problem={"nets": 10, "count": 50},
    reward={"kind": "mixed", "parts": [{"kind": "paper"}, {"kind": "team", "weight": 0.1}]},
)
```

## End of an episode

A task is **connected** (`joined` in the code) when the agent reaches its target, and **fails**
after `max_steps` steps. Then the next task starts. After its last task an agent is **terminated**
if all its tasks are connected, and **truncated** if any of them failed.

The last info of the agent that ends the game (with `agents_persist`, of every agent) contains the
results of the game: `overflow`, `wirelength`, `joined`, `tasks`, `open` (tasks that are not
connected), `steps` and `is_success` (everything is connected, without overflow). The dictionary
`metrics` repeats five of them, as `metrics()` returns them.

When a move ends a task, the next observation already belongs to the next task. The info therefore
has `task_ended` (1: connected, 2: failed), and `task_obs` and `task_mask`, which the agent would
have seen in the Gcell where the task ended. In the AEC environment this info comes with the agent's
next turn. For learning, bootstrap from `task_obs` after a failed task, which only ran out of steps;
do not bootstrap after a connected one.

## Rip-up and reroute

With `rip_up={"rounds": K}`, K rounds follow once all nets have been routed. In a round the nets
that `choose` selects are ripped up one after another, and rerouted around the others. A reroute
that makes the solution worse is undone. With `choose="agents"` each agent decides in its turn:
action 6 rips up its own net.

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

Agents that wait for the next round stay in `agents`, as with `agents_persist`. An example of the
gain: if every net follows A*, the paper's rules connect all nets on 4 of 10 test problems of
`multi-pin-8x8-v0`, and these options with three rounds and two neighbours on 9 of 10
([`rip_up.py`](examples/rip_up.py)).

## Problems

`problem` is a `Problem`, a file, or a mapping of generator options
(:class:`marouting.generator.GeneratorOptions`) or of a file with controls, such as
``{"path": "chip.def", "layers": "2..6"}`` (:class:`marouting.problem.controls.ProblemFile`). It may
also be a folder or a list. Every episode then plays one of its problems, drawn at random;
`problem_name` says which. With `scenario` and `split` the problems are those of a benchmark
scenario (:mod:`marouting.scenarios`): a new training problem in every episode, or one of the fixed
validation or test problems.

## Many problems at once

`BatchEnv` plays M problems side by side in compiled code, with arrays of shape (M, agents, …). The
rules are the same; `tests/test_game.py` compares both implementations. `info` says which agents
moved (`acted`), whether a task ended (`task_ended`: 1 connected, 2 failed), and what the agents
observed at the end of a task, before the next one began (`final_obs`):

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

The rows of agents that are done stay, and are paid, until the problem's episode is over. With
`agents_persist=True` they are also terminated or truncated only then, as in PettingZoo's
interfaces. A problem whose episode is over starts the next one with the next step; with
`play_once=True` each of a list of problems, or of the problems of a split, is played once:

```python
import numpy as np
from marouting.vector import BatchEnv

env = BatchEnv(scenario="toy-4x4-v0", split="validation", play_once=True)
obs, info = env.reset()
while info["active"].any():
    obs, reward, terminated, truncated, info = env.step(info["action_mask"].argmax(axis=-1))
print(info["final_info"]["wirelength"].sum())
```

`BatchEnv(64, scenario="mixed-v0")` plays 64 games, each with a new problem in every episode; the
names are in `info["problem"]`. Likewise, `problem={"nets": 10, "seed": None}` generates new
problems, and `problem="folder"` draws from the files of a folder. The same seed gives the same
problems for any number of `threads`. `save()` returns the state of all games, `restore()` returns
to it, and `set_order()` sets the turn order. [`batch_ppo.py`](examples/libraries/batch_ppo.py)
trains PPO on `BatchEnv` in 60 lines.

## Arguments

Keyword arguments of `env`, `raw_env`, `parallel_env` and `gymnasium.make`, and keys of `env` in a
configuration (:class:`marouting.options.GameOptions`).

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
