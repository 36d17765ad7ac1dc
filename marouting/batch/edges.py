"""Which edges a net may cross, and what it takes of them.

An edge is used by a net once or not at all. The net's demand counts against the capacity as long as
it uses the edge; a via has no limit.
"""

from typing import Any

from marouting.batch.bits import byte_of, has, set_byte
from marouting.batch.state import Dynamic, Static
from marouting.kernels import as_index, compiled, i64, inlined
from marouting.problem.grid import AXES, VIA_AXIS

# There are as few branches as possible: what an agent meets is as good as random, and a branch that
# the processor mispredicts takes as long as a whole move.


@inlined
def uses(used: Any, m: int, n: int, edge: int) -> int:
    """1 if agent n of problem m uses an edge, else 0."""
    return has(used, m, n, edge)


@inlined
def demand_of(static: Static, m: int, n: int, cell: int, move: int) -> int:
    """The net's demand on the edge that a move crosses; 0 for a via."""
    demand = static.demand[m, n, as_index(static.position[cell, VIA_AXIS])]
    return demand * (move // 2 != VIA_AXIS)


@inlined
def has_room(static: Static, dynamic: Dynamic, m: int, n: int, cell: int, move: int) -> int:
    """1 if a move from a Gcell crosses a via, an edge that the net uses or one with room for it."""
    edge = as_index(static.edge[cell, move])
    via = move // 2 == VIA_AXIS
    room = dynamic.remaining[m, edge] >= demand_of(static, m, n, cell, move)
    return (via | room | uses(dynamic.used, m, n, edge)) & (static.exits[cell] >> move)


@inlined
def may_cross(static: Static, dynamic: Dynamic, m: int, n: int, cell: int, move: int) -> int:
    """1 if a move from a Gcell crosses its edge, 0 if it is blocked."""
    anyway = static.overflow_allowed & (static.exits[cell] >> move)
    return has_room(static, dynamic, m, n, cell, move) | anyway


@inlined
def take(dynamic: Dynamic, m: int, edge: int, demand: int) -> int:
    """Takes demand of an edge (releases it if negative); returns the overflow that this adds."""
    remaining = i64(dynamic.remaining[m, edge])
    added = max(demand - remaining, 0) - max(-remaining, 0)
    dynamic.remaining[m, edge] = remaining - demand
    dynamic.games[m].overflow += added
    return added


@compiled
def use_edges(static: Static, dynamic: Dynamic, m: int, n: int, byte: int, bits: int) -> None:
    """Makes a net use just these edges of a byte: takes the new ones, releases the others."""
    game = dynamic.games[m]
    changed = byte_of(dynamic.used, m, n, byte) ^ bits
    if changed == 0:
        return
    bit = 0
    while changed >> bit != 0:
        if changed >> bit & 1:
            edge = 8 * byte + bit
            takes = 2 * (bits >> bit & 1) - 1  # 1 or -1
            cell, move = as_index(edge // AXES), i64(2 * (edge % AXES))
            _ = take(dynamic, m, edge, i64(takes * demand_of(static, m, n, cell, move)))
            game.wirelength += takes
        bit += 1
    set_byte(dynamic.used, m, n, byte, bits)
