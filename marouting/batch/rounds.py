"""Rip-up and reroute: after all nets have routed, some are routed again around the others.

Options: :class:`marouting.rules.RipUp`. Rules in plain Python: :mod:`marouting.game`, "Rip-up and
reroute".

Where nets negotiate (:class:`marouting.batch.prices.Negotiation`) the first walk and some rounds
are **priced**. In such a round every net is rerouted alone, in random order or that of
``choose: history``. It keeps its new routes if they join as many tasks and cost the net no more
than the old ones, even if the whole problem gets worse. **Plain** rounds ignore prices; patience
counts consecutive plain rounds.

* After the first walk or a priced round, the next round is priced if there is overflow, unless ten
  consecutive priced rounds have not lowered the least overflow since the last plain round by one
  per cent. Otherwise it is plain. If earlier routes joined more tasks or had less overflow, the
  best of them are restored first.
* After a plain round the next one is plain, unless two in a row have gained nothing: no task, not
  one per cent of the overflow, not 1/2000 of the wirelength. Otherwise it is priced.
* After the last round, the best routes after any round are restored.

Restoring routes makes no move and pays no reward.
"""

from marouting import game as rules
from marouting.batch.bits import byte_of, empty, next_in, put, set_byte
from marouting.batch.edges import use_edges
from marouting.batch.places import grid_of
from marouting.batch.prices import begin_priced_or_plain, is_priced, net_cost, put_best, take_routes
from marouting.batch.state import Choice, Dynamic, Option, Static
from marouting.batch.tasks import begin_net, begin_task, clear_move, is_on, next_task
from marouting.game import NOBODY, Crossing, Ending, Status
from marouting.kernels import as_index, compiled, i64
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.trees.heap import pop, push

_SHIFT = 24
_OPEN = 1 << _SHIFT  # the weight of an open task: more than that of all edges
_MOST_OPEN = 4096  # so that the weight, shifted once more, fits into 64 bits
_LAST = (1 << _SHIFT) - 1


@compiled
def is_full(static: Static, dynamic: Dynamic, m: int, edge: int) -> bool:
    """Whether an edge inside a layer has capacity, and all of it is taken."""
    inside = edge % AXES != VIA_AXIS
    return inside and dynamic.remaining[m, edge] <= 0 < static.capacity[m, edge]


@compiled
def _conflicts(static: Static, dynamic: Dynamic, m: int, n: int, now: bool) -> int:
    """A net's open tasks and full edges: those full now, or each by the rounds it was full in."""
    conflicts = i64(0)
    edge = next_in(dynamic.used, m, n, i64(0))
    while edge != NOBODY:
        if not now:
            conflicts += dynamic.numbers[m, static.options[Option.HISTORY] + edge]
        elif is_full(static, dynamic, m, edge):
            conflicts += 1
        edge = next_in(dynamic.used, m, n, edge + 1)
    tasks = static.first[m, n + 1] - static.first[m, n]
    missing = min(i64(tasks - dynamic.agents[m, n].joined), _MOST_OPEN)
    return min(conflicts, _OPEN - 1) + _OPEN * missing


lot = compiled(rules.lot)


@compiled
def _begin_round(static: Static, dynamic: Dynamic, m: int) -> None:
    """Counts full edges, and lines up the nets."""
    game = dynamic.games[m]
    begin_priced_or_plain(static, dynamic, m)
    game.round += 1
    game.place = game.reroutes = 0
    game.began_joined, game.began_overflow = game.joined, game.overflow
    game.began_wirelength = game.wirelength
    history, first = as_index(static.options[Option.HISTORY]), as_index(static.options[Option.LINE])
    for edge in range(static.capacity.shape[1]):
        if is_full(static, dynamic, m, edge):
            dynamic.numbers[m, history + edge] += 1
    line, size = dynamic.numbers[m, first : first + static.order.shape[1]], i64(0)
    while size < len(line) and static.order[m, size] != NOBODY:
        price = i64(0)
        if static.options[Option.RIP_UP] == Choice.HISTORY:
            price = _conflicts(static, dynamic, m, i64(static.order[m, size]), False)
        elif is_priced(static, dynamic, m):
            price = lot(i64(game.round), i64(static.order[m, size]), i64(NOBODY))
        push(line, size, price << _SHIFT | (_LAST - size))
        size += 1
    # The smallest key goes to the end, to the place that the heap no longer needs.
    for rest in range(size, 0, -1):
        line[rest - 1] = _LAST - (pop(line, rest) & _LAST)
    line[size:] = NOBODY


@compiled
def _is_chosen(static: Static, dynamic: Dynamic, m: int, n: int) -> bool:
    """Whether a net is ripped up now that it is considered."""
    rip_up = static.options[Option.RIP_UP]
    if rip_up == Choice.CONFLICTS or rip_up == Choice.HISTORY:
        return _conflicts(static, dynamic, m, n, rip_up == Choice.CONFLICTS) > 0
    return True


@compiled
def _box(static: Static, m: int, n: int, joined: int) -> tuple[int, int, int, int]:
    """First and last column and row of the box around a net's pins, within the grid."""
    first, end = i64(static.first[m, n]), i64(static.first[m, n + 1])
    start = as_index(static.tasks[first, 0])
    left, low = i64(static.position[start, 0]), i64(static.position[start, 1])
    right, high = left, low
    for task in range(first, end):
        pin = as_index(static.tasks[task, 1])
        x, y = i64(static.position[pin, 0]), i64(static.position[pin, 1])
        left, right, low, high = min(left, x), max(right, x), min(low, y), max(high, y)
    beyond = i64(joined < end - first)
    columns, rows, _ = grid_of(static)
    left, low = max(left - beyond, 0), max(low - beyond, 0)
    return left, min(right + beyond, columns - 1), low, min(high + beyond, rows - 1)


@compiled
def _in_the_way(static: Static, dynamic: Dynamic, m: int, n: int) -> int:
    """Lists a net and those in its way in ``Option.RIPPED``; returns how many they are."""
    o, most = static.options, static.options[Option.RIPPED_MOST]
    if o[Option.PATIENCE] > 0:
        most = min(most, 1 + (i64(dynamic.games[m].plain) - 1) // o[Option.PATIENCE])
    if is_priced(static, dynamic, m):
        most = i64(1)
    ripped = dynamic.numbers[m, o[Option.RIPPED] : o[Option.RIPPED] + most]
    counts = dynamic.numbers[m, o[Option.QUEUE] : o[Option.QUEUE] + most]
    blocking = as_index(o[Option.KEPT])
    ripped[0], size = n, i64(1)
    if len(ripped) == 1:
        return size
    # Such edges lie close to each other: all other bytes of the nets need not be looked at.
    begin, stop = i64(static.capacity.shape[1]), i64(0)
    empty(dynamic.sets, m, blocking)
    for byte in range(dynamic.used.shape[2]):
        bits = byte_of(dynamic.used, m, n, byte)
        for bit in range(8):
            if bits >> bit & 1 and is_full(static, dynamic, m, 8 * byte + bit):
                put(dynamic.sets, m, blocking, 8 * byte + bit, i64(1))
                begin, stop = min(begin, byte), max(stop, byte + 1)
    left, right, low, high = _box(static, m, n, dynamic.agents[m, n].joined)
    _, rows, layers = grid_of(static)
    for x in range(left, right + 1):
        for y in range(low, high + 1):
            first = AXES * layers * (x * rows + y)
            for edge in range(first, first + AXES * layers):
                if is_full(static, dynamic, m, edge):
                    put(dynamic.sets, m, blocking, i64(edge), i64(1))
                    begin, stop = min(begin, i64(edge >> 3)), max(stop, i64(edge >> 3) + 1)
    for other in range(dynamic.agents.shape[1]):
        count = i64(0)
        for byte in range(begin, stop):
            bits = byte_of(dynamic.used, m, other, byte)
            if bits != 0:
                bits &= byte_of(dynamic.sets, m, blocking, byte)
            while bits != 0:
                bits &= bits - 1
                count += 1
        if other == n or count == 0:
            continue
        count *= lot(i64(dynamic.games[m].round), n, i64(other))
        # Insert it among the others, the largest first.
        at = size
        while at > 1 and counts[at - 1] < count:
            at -= 1
        if at == len(ripped):
            continue
        size = min(size + 1, i64(len(ripped)))
        for k in range(size - 1, at, -1):
            ripped[k], counts[k] = ripped[k - 1], counts[k - 1]
        ripped[at], counts[at] = other, count
    return size


@compiled
def rip_up(static: Static, dynamic: Dynamic, m: int, n: int) -> None:
    """Rips up a net and those in its way; all begin their first tasks again."""
    game = dynamic.games[m]
    game.kept_joined, game.kept_overflow = game.joined, game.overflow
    game.kept_wirelength = game.wirelength
    game.ripped = game.active = _in_the_way(static, dynamic, m, n)
    game.reroutes += 1
    game.just_ripped = 1
    if not static.sequential:
        game.turn = static.order.shape[1] - 1  # the turn passes to the first of them
    o = static.options
    for k in range(o[Option.RIPPED_MOST]):
        if k >= game.ripped:
            dynamic.numbers[m, o[Option.RIPPED] + k] = NOBODY
            continue
        member = as_index(dynamic.numbers[m, o[Option.RIPPED] + k])
        agent = dynamic.agents[m, member]
        dynamic.numbers[m, o[Option.KEPT_JOINED] + k] = agent.joined
        kept = as_index(o[Option.KEPT] + k)
        empty(dynamic.sets, m, kept)
        for byte in range(dynamic.used.shape[2]):
            bits = byte_of(dynamic.used, m, member, byte)
            if bits != 0:
                set_byte(dynamic.sets, m, kept, byte, bits)
                use_edges(static, dynamic, m, member, byte, i64(0))
        if is_priced(static, dynamic, m):
            game.kept_cost = net_cost(static, dynamic, m, member, dynamic.sets, kept, i64(0))
        agent.status = Status.ACTIVE
        clear_move(dynamic, m, member)
        begin_net(static, dynamic, m, member)


@compiled
def all_rerouted(static: Static, dynamic: Dynamic, m: int) -> bool:
    """Whether all nets that are rerouted have ended their last tasks."""
    for k in range(dynamic.games[m].ripped):
        member = i64(dynamic.numbers[m, static.options[Option.RIPPED] + k])
        agent = dynamic.agents[m, member]
        # An agent that has ended a task either stands where it arrived, or at its next start.
        if agent.status != Status.ACTIVE:
            continue
        if agent.ending == Ending.NONE or agent.steps == 0:
            return False
        if next_task(static, dynamic, m, member) != NOBODY:
            return False
    return True


@compiled
def judge(static: Static, dynamic: Dynamic, m: int) -> None:
    """Once nets are rerouted: if that made the problem worse, they get their old routes back."""
    game = dynamic.games[m]
    before = -game.kept_joined, game.kept_overflow, game.kept_wirelength
    worse = (-game.joined, game.overflow, game.wirelength) > before
    if game.joined == game.kept_joined and is_priced(static, dynamic, m):
        n = as_index(dynamic.numbers[m, static.options[Option.RIPPED]])
        worse = net_cost(static, dynamic, m, n, dynamic.used, n, i64(1)) > game.kept_cost
    o = static.options
    for k in range(game.ripped):
        member = as_index(dynamic.numbers[m, o[Option.RIPPED] + k])
        if worse:
            kept, joined = (
                as_index(o[Option.KEPT] + k),
                dynamic.numbers[m, o[Option.KEPT_JOINED] + k],
            )
            take_routes(static, dynamic, m, member, kept, joined)
        dynamic.numbers[m, o[Option.RIPPED] + k] = NOBODY
    if worse:
        game.joined = game.kept_joined
    game.ripped = 0


@compiled
def final_status(static: Static, dynamic: Dynamic, m: int, n: int) -> int:
    """The status of an agent that has no more tasks: TERMINATED or TRUNCATED."""
    tasks = static.first[m, n + 1] - static.first[m, n]
    return Status.TERMINATED if dynamic.agents[m, n].joined == tasks else Status.TRUNCATED


@compiled
def rip_up_next(static: Static, dynamic: Dynamic, m: int) -> None:
    """When no agent is active: the next net is ripped up or asked, or the episode is over."""
    game = dynamic.games[m]
    agents, line = static.order.shape[1], as_index(static.options[Option.LINE])
    while True:
        over = game.round == 0 or game.place == agents
        if over or dynamic.numbers[m, line + game.place] == NOBODY:
            last = game.round == static.options[Option.ROUNDS]
            if last or (game.round > 0 and game.reroutes == 0):
                break
            _begin_round(static, dynamic, m)
            continue
        turn = as_index(dynamic.numbers[m, line + game.place])
        n = i64(static.order[m, turn])
        game.place += 1
        if not _is_chosen(static, dynamic, m, n):
            continue
        game.turn = turn
        if static.options[Option.RIP_UP] == Choice.AGENTS:
            game.asked = game.active = 1
            dynamic.agents[m, n].status = Status.ACTIVE
            begin_task(static, dynamic, m, n, i64(static.first[m, n]))
        else:
            rip_up(static, dynamic, m, n)
        return
    if is_on(static, Option.PRICES):
        put_best(static, dynamic, m)
    for n in range(agents):
        if dynamic.agents[m, n].status == Status.WAITING:
            dynamic.agents[m, n].status = final_status(static, dynamic, m, n)


@compiled
def answer(static: Static, dynamic: Dynamic, m: int, n: int, rips_up: bool) -> None:
    """An agent that was asked answers whether to rip up its net."""
    agent, game = dynamic.agents[m, n], dynamic.games[m]
    game.asked = 0
    game.steps += 1
    if rips_up:
        rip_up(static, dynamic, m, n)
        game.just_ripped = 0  # by this move, unlike in other rounds
    agent.added_overflow = 0
    agent.crossing = Crossing.ANSWERED
    agent.ending = Ending.NONE if rips_up else Ending.JOINED
