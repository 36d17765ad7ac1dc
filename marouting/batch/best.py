"""The best routes so far: noted, and taken again.

The better routes have more tasks joined, then less overflow, then less wirelength.
"""

from marouting.batch.bits import byte_of, copy_row
from marouting.batch.edges import use_edges
from marouting.batch.state import Dynamic, Option, Static
from marouting.batch.tasks import clear, grow_tree, is_on, keeps_tree
from marouting.game import Status
from marouting.kernels import as_index, compiled, i64


@compiled
def _is_best(dynamic: Dynamic, m: int) -> bool:
    """Whether the present routes are better than the best of earlier rounds."""
    game = dynamic.games[m]
    if game.joined != game.best_joined:
        return game.joined > game.best_joined
    if game.overflow != game.best_overflow:
        return game.overflow < game.best_overflow
    return game.wirelength < game.best_wirelength


@compiled
def note_best(static: Static, dynamic: Dynamic, m: int) -> None:
    """Notes the present routes if they are the best so far."""
    if not _is_best(dynamic, m):
        return
    game = dynamic.games[m]
    game.best_joined, game.best_overflow = game.joined, game.overflow
    game.best_wirelength = game.wirelength
    for n in range(dynamic.agents.shape[1]):
        row = i64(static.options[Option.BEST] + n)
        copy_row(dynamic.sets, m, row, dynamic.used, m, i64(n))
        joined = dynamic.agents[m, n].joined
        dynamic.numbers[m, static.options[Option.BEST_JOINED] + n] = joined


@compiled
def put_best(static: Static, dynamic: Dynamic, m: int) -> None:
    """Nets take the best routes so far."""
    note_best(static, dynamic, m)
    for n in range(dynamic.agents.shape[1]):
        if dynamic.agents[m, n].status == Status.ABSENT:  # it has no tasks, nor a first pin
            continue
        row = as_index(static.options[Option.BEST] + n)
        joined = dynamic.numbers[m, static.options[Option.BEST_JOINED] + n]
        take_routes(static, dynamic, m, n, row, joined)
    dynamic.games[m].joined = dynamic.games[m].best_joined


@compiled
def take_routes(static: Static, dynamic: Dynamic, m: int, n: int, row: int, joined: int) -> None:
    """A net uses just the edges in a row of ``dynamic.sets``, which join so many of its tasks."""
    changed = False
    for byte in range(dynamic.used.shape[2]):
        bits = byte_of(dynamic.used, m, n, byte)
        if bits != 0:
            taken = byte_of(dynamic.sets, m, row, byte)
            changed |= taken != bits
            use_edges(static, dynamic, m, n, byte, taken)
    for byte in range(dynamic.sets.shape[2]):
        bits = byte_of(dynamic.sets, m, row, byte)
        if bits != 0:
            changed |= byte_of(dynamic.used, m, n, byte) != bits
            use_edges(static, dynamic, m, n, byte, bits)
    dynamic.agents[m, n].joined = joined
    if is_on(static, Option.RELEASE_FAILED):
        clear(static, dynamic, m, Option.TAKEN, n)
    if changed and keeps_tree(static):
        grow_tree(static, dynamic, m, n)
