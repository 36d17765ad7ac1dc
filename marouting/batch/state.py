"""The state of the game: what does not change during an episode, and what does.

The state of M problems with N agents on one grid shape is held in plain arrays, with the problem as
the first axis. There are G Gcells, E edges, Z layers, K tasks over all problems, and P nets at most
that are rerouted at a time. Arrays of options that are switched off have no elements. Sets of edges
and Gcells are rows of bits (:mod:`marouting.batch.bits`). During play only
:mod:`marouting.batch.rules`, and what it calls, changes the dynamic state.
"""

import enum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from marouting.game import mask_table
from marouting.problem.grid import MOVES


class Choice(enum.IntEnum):
    """Which nets are ripped up in a round; see :mod:`marouting.batch.rounds`."""

    ALL = 0  #: all, in turn order
    CONFLICTS = 1  #: those with open tasks or on full edges, in turn order
    HISTORY = 2  #: those on edges that were full in this or earlier rounds, the most often first
    AGENTS = 3  #: those whose agents answer so when they are asked, in turn order


AGENT = np.dtype(
    [
        ("cell", np.int32),  # Gcell where the agent is
        ("target", np.int32),  # Gcell of the task's target pin
        ("task", np.int32),  # row of the task in the table of tasks
        ("steps", np.int32),  # steps taken in this task
        ("joined", np.int32),  # tasks joined so far
        ("added_overflow", np.int32),  # overflow that the last move added
        ("status", np.int8),  # Status
        ("crossing", np.int8),  # Crossing of the last move
        ("ending", np.int8),  # Ending of the last move
        ("message", np.uint8),  # what the agent wrote with its last move
    ],
    align=True,
)
"""One agent's state; the engine holds (M, N) of them."""

GAME = np.dtype(
    [
        ("turn", np.int32),  # place in the turn order of the agent to move
        ("agent", np.int32),  # the agent to move, or NOBODY
        ("active", np.int32),  # agents still active
        ("joined", np.int32),  # tasks joined
        ("steps", np.int32),  # moves made
        ("overflow", np.int64),  # overflow of all edges
        ("wirelength", np.int64),  # edges used, summed over the nets
        # Of rip-up rounds:
        ("round", np.int32),  # the present round; 0 while nets walk for the first time
        ("place", np.int32),  # place in the round's order of the net to be considered next
        ("ripped", np.int32),  # nets that are rerouted at present
        ("reroutes", np.int32),  # how often nets have been ripped up in this round
        ("just_ripped", np.int8),  # nets have just released their edges, and none has moved since
        ("asked", np.int8),  # the agent to move is asked whether to rip up its net
        ("kept_joined", np.int32),  # tasks joined before nets were ripped up
        ("kept_overflow", np.int64),  # overflow likewise
        ("kept_wirelength", np.int64),  # wirelength likewise
        ("kept_cost", np.int64),  # what the routes before cost their net, in a priced round
        ("began_joined", np.int32),  # tasks joined at the beginning of the round
        ("began_overflow", np.int64),  # overflow likewise
        ("began_wirelength", np.int64),  # wirelength likewise
        ("plain", np.int32),  # rounds in a row that have not been priced, this one included
        # Of priced rounds:
        ("present", np.int32),  # what one net too many adds to the cost of an edge, in parts of it
        ("stuck", np.int32),  # rounds in a row without gain
        ("negotiations", np.int32),  # how often they have followed plain ones
        ("fewest", np.int64),  # least overflow after a priced round since the last plain one
        ("best_joined", np.int32),  # tasks joined by the best routes so far
        ("best_overflow", np.int64),  # overflow likewise
        ("best_wirelength", np.int64),  # wirelength likewise
    ],
    align=True,
)
"""One problem's state; the engine holds (M,) of them."""


class Option(enum.IntEnum):
    """Places in ``Static.options``.

    The state of the options is in two arrays instead of many: numba unpacks every array at each
    call. ``TREE`` to ``BEST`` are rows of ``Dynamic.sets``, ``LINE`` to ``QUEUE`` columns of
    ``Dynamic.numbers``; -1 stands for one that no option needs. The others are numbers.
    """

    TREE_TARGET = 0  #: whether any Gcell of the net's tree ends a task
    NEAREST_NEXT = 1  #: whether the open pin nearest to the tree is the next task
    MASK_VISITED = 2  #: whether masks leave out Gcells visited in the task
    RELEASE_FAILED = 3  #: whether a failed task releases its edges
    ROUNDS = 4  #: rip-up rounds
    RIP_UP = 5  #: Choice
    RIPPED_MOST = 6  #: P, the most nets that are rerouted at a time
    PATIENCE = 7  #: rounds after which one more net is rerouted at a time; 0: P from the first
    PRESENT = 8  #: GAME.present in the first walk
    STEP_DECAY = 9  #: how fast price changes shrink, in per cent
    TREE = 10  #: N sets of Gcells that edges join to the first pin
    VISITED = 11  #: N sets of Gcells visited in the present task
    TAKEN = 12  #: N sets of edges newly used in the present task
    KEPT = 13  #: P sets of edges that nets had before they were ripped up
    BEGUN = 14  #: N sets of tasks that have been begun, counted from the net's first
    BEST = 15  #: N sets of edges, the best routes so far
    LINE = 16  #: N places in turn order, in the order of the rip-up round
    RIPPED = 17  #: P nets that are rerouted; NOBODY where there is none
    KEPT_JOINED = 18  #: P numbers of tasks that they had joined
    HISTORY = 19  #: E numbers of rip-up rounds at whose start the edge was full
    PRICES = 20  #: E prices of edges, in parts of ``prices.PRICE_SCALE``
    BEST_JOINED = 21  #: N numbers of tasks that the best routes so far have joined
    QUEUE = 22  #: G, or at least P, numbers to work with
    ROWS = 23  #: R, all rows
    COLUMNS = 24  #: C, all columns
    MOVES = 25  #: moves of an agent, whatever its message; see ``Rules.moves``
    WAIT = 26  #: whether the last of them is to stay


class Static(NamedTuple):
    """What does not change during an episode."""

    neighbour: NDArray[np.int32]  # (G, 6) Gcell that a move leads to, or OFF_GRID
    edge: NDArray[np.int32]  # (G, 6) edge that a move crosses; off the grid E - 1, which is none
    exits: NDArray[np.uint8]  # (G,) bit per move: it stays on the grid
    position: NDArray[np.int32]  # (G, 3) x, y, z of a Gcell
    capacity: NDArray[np.int32]  # (M, E) capacity of every edge
    demand: NDArray[np.int32]  # (M, N, Z) demand of an agent on an edge of a layer
    tasks: NDArray[np.int32]  # (K, 2) start and target Gcell of every task
    first: NDArray[np.int32]  # (M, N + 1) agent n has the tasks first[n] to first[n + 1] - 1
    order: NDArray[np.int32]  # (M, N) agents in turn order, then NOBODY
    sequential: bool  # whether a net finishes before the next one starts
    overflow_allowed: bool  # whether moves may cross edges without enough remaining capacity
    max_steps: int  # steps after which a task fails
    extended: bool | None  # True if an option beyond the paper's is on, otherwise None: then
    # compiled code knows by the type that it need not look, and is as quick as without options
    options: NDArray[np.int64]  # (len(Option),) what those options say, and where their state is


class Dynamic(NamedTuple):
    """What changes during an episode."""

    remaining: NDArray[np.int32]  # (M, E) capacity minus demand
    used: NDArray[Any]  # (M, N, ceil(E / 8)) uint8, bit e % 8 of byte e // 8: the net uses edge e
    agents: NDArray[Any]  # (M, N) AGENT
    games: NDArray[Any]  # (M,) GAME
    sets: NDArray[Any]  # (M, R, ceil(E / 8)) uint8, sets of options; see Option
    numbers: NDArray[np.int64]  # (M, C) numbers of the options; see Option


MASKS = mask_table(MOVES)  # (64, 6) int8, see :func:`marouting.game.mask_table`
