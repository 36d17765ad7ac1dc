"""The options of the router."""

from dataclasses import dataclass
from typing import Literal

from marouting.config import MOST, check

_PASSES = 100_000


@dataclass(frozen=True, kw_only=True)
class PathfinderOptions:
    """Options of negotiated congestion.

    Defaults without a publication were tuned on ibm01 (ISPD'98) with 20 s per trial, and on
    generated problems that cannot be routed without overflow (docs/routers.md).

    Attributes:
        schedule: ``standard``; or ``tuned``: options that have their defaults get other values,
            which were tuned for problems that do not fit and for about the number of passes that
            there is time for (:mod:`policies.routers.pathfinder.schedule`). More time can come with
            other values, so it need not always bring a better solution.
        cost: ``wirelength``: what is least, after overflow; or ``ispd2024``: the cost of the ISPD
            2024 contest is least, for problems from ``.cap`` files, whatever ``via_weight`` and
            ``crowding`` are (:mod:`policies.routers.pathfinder.contest`).
        via_weight: cost of a via, in edges inside a layer. 1 matches the ISPD 2008 evaluator. Use a
            value just above 0 to compare with wirelengths that leave vias out, such as those
            published for ISPD'98. A list has the costs of vias from layer 1 to 2, from 2 to 3, and
            so on.
        crowding: the additional cost of the last track of an edge inside a layer that has many, in
            edges, so that fewer edges are filled. Each track beyond ``crowded_from`` costs more
            than the one before; where there are one or two tracks, they cost a quarter or half of
            it. The router first minimises overflow, then wirelength plus this cost. 0: edges
            cost the same up to their capacity.
        crowded_from: share of an edge's capacity from which on it costs more.
        prefer_layers: the layers that long nets prefer, given as in :class:`marouting.Controls`;
            None: none. Unlike the control ``long_layers`` this forbids nothing: a wire costs more
            in other layers.
        prefer_from: half the perimeter of the pins' bounding box, in Gcells, from which a net is
            long.
        prefer_weight: what each edge of a long net costs more in other layers, in edges. Wirelength
            and this cost together are what is least, after overflow.
        exact_pins: nets with at most this many pins get a cheapest tree, provided that their box is
            small, and in negotiating passes, which are many, smaller still. The paper's problems
            have at most 5 pins per net. Each further pin triples the time.
        margin: Gcells by which a net's box extends beyond its pins and its previous tree on each
            side. Where the box contains no route, it is doubled for that search; where a tree
            around closed edges may be shorter outside, a net's first box is as wide as that needs.
        present_factor: factor by which one net too many raises the cost of an edge when a round
            begins (p in PathFinder).
        present_growth: factor by which ``present_factor`` grows from one negotiating pass to the
            next, as in PathFinder.
        history_increment: amount that an overflowed edge's price rises before each negotiating
            pass, in edges (h in PathFinder).
        history_decay: share of the prices that is kept when the next round begins.
        step_decay: after r rounds, price changes (by ``history_increment``, and by ``1 -
            history_decay``) are divided by ``1 + step_decay r``, as is usual in subgradient methods
            (Held, Wolfe and Crowder, "Validation of subgradient optimization", Mathematical
            Programming 6, 1974). 0: constant.
        stall_passes: a round stops negotiating after this many passes in a row without a decrease
            in overflow.
        min_overflow_drop: share by which the overflow has to fall to count as a decrease.
        min_wirelength_gain: share of the wirelength that a squeezing pass has to save for the round
            to make another one, if it lowers no overflow. Where other rounds have had less
            overflow, shorter nets are of no use.
        reroute_fraction: share of the nets that are rerouted even though their tree is already as
            short as possible, to make room for others.
        lp_after_pass: after this many passes, if all solutions so far overflow and at least three
            quarters of the time are left, prices are set by a linear program over all trees so far,
            and again when a later round begins (:mod:`policies.routers.pathfinder.relaxation`). Not
            with more than 20 000 nets.
        lp_passes: how many relaxing passes follow, each at new prices, before negotiating goes on.
            0: there is no linear program, and prices come from past overflow alone.
        lp_price_scale: what the highest price of the linear program adds to the cost of an edge, in
            edges.
        repair_after: repairing begins after this many rounds in a row without a better solution.
        overflow_stall_weight: for this, a round counts so many times if it ends with more overflow
            than the best solution: one that ends with as little was close to a better solution.
        repair_stall_passes: repairing ends after this many passes in a row without a better
            solution.
        min_repair_fraction: a repairing pass reroutes as many nets as overflow or take a detour, or
            this share of all nets if that is more.
        patience_factor: when repairing ends, the search ends, too, if its passes so far are at
            least this many times the pass that found the best solution (20, if that was earlier).
            Otherwise the next round begins. On the 121 published problems
            of Liao et al., no optimum is missed with any of sixteen seeds.
        passes: the search ends after this many passes at the latest.
        seconds: limit of processor time, so that other work on the machine does not matter; with
            several threads, of the one that works longest; None for no limit. The first pass, of
            patterns, is completed even if that takes longer: after it every net is joined. A
            solution cut off by the limit depends on the machine.
        least_gain: a search whose best solution has no overflow ends when it has lately saved less
            than this share of the wirelength per second of processor time. What counts are the
            latest four seconds, or the latest quarter of the search if that is longer. 0: it goes
            on. Not if ``passes`` is set, or without a limit of ``seconds``: what comes out then
            does not depend on the machine.
        threads: how many threads plan trees, where there are more than 20 000 nets to route. What
            comes out does not depend on it, unless ``seconds`` cuts the search off.
        start: a file of a solution to begin with, such as one that was cut off; None: begin with
            patterns. Nets that it does not join get patterns. What comes out is no worse.
        seed: seed of the random numbers.

    Raises:
        InputError: an option is out of range; the message names it and the range.
    """

    schedule: Literal["standard", "tuned"] = "standard"
    cost: Literal["wirelength", "ispd2024"] = "wirelength"
    via_weight: float | tuple[float, ...] = 1.0
    crowding: float = 0.0
    crowded_from: float = 0.5
    prefer_layers: str | int | None = None
    prefer_from: int | None = None
    prefer_weight: float = 0.5
    exact_pins: int = 5
    margin: int = 2
    present_factor: float = 0.1
    present_growth: float = 1.15
    history_increment: float = 0.3
    history_decay: float = 0.8
    step_decay: float = 0.1
    stall_passes: int = 10
    min_overflow_drop: float = 0.01
    min_wirelength_gain: float = 0.0005
    reroute_fraction: float = 0.1
    lp_after_pass: int = 12
    lp_passes: int = 0
    lp_price_scale: float = 15.0
    repair_after: int = 10
    overflow_stall_weight: int = 2
    repair_stall_passes: int = 60
    min_repair_fraction: float = 0.0
    patience_factor: int = 16
    passes: int = _PASSES
    seconds: float | None = 50.0
    least_gain: float = 0.0003
    threads: int = 1
    start: str | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        for name, (least, most) in _RANGES.items():
            found = getattr(self, name)
            if found is None:
                continue
            fits = all(
                least <= n <= most for n in (found if isinstance(found, tuple) else (found,))
            )
            check(name, fits, f"a number from {least} to {most}")
        check("crowded_from", self.crowded_from < 1, "a number from 0, below 1")
        usual = self.crowded_from == PathfinderOptions.crowded_from
        check("crowded_from", self.crowding > 0 or usual, "crowding beside it")
        check("present_factor", self.present_factor > 0, "a number above 0, up to 1000")
        layers, least = self.prefer_layers is not None, self.prefer_from is not None
        check("prefer_layers", least or not layers, "prefer_from beside it, from what length")
        usual = self.prefer_weight == PathfinderOptions.prefer_weight
        check("prefer_weight", layers or usual, "prefer_layers and prefer_from beside it")
        check("prefer_from", layers or not least, "prefer_layers beside it, a range of layers")
        check("prefer_layers", not layers or self.cost == "wirelength", "none with cost: ispd2024")
        check("seconds", self.seconds is None or self.seconds >= 0, "a number from 0, or null")

    @property
    def by_the_clock(self) -> bool:
        """Whether the time that the search takes may decide when it ends, within ``seconds``."""
        return self.least_gain > 0 and self.seconds is not None and self.passes == _PASSES


_RANGES = {
    "via_weight": (0, 1000),
    "crowding": (0, 1000),
    "crowded_from": (0, 1),
    "prefer_from": (0, MOST),
    "prefer_weight": (0.01, 16),  # with much more, overflow would cost less
    "exact_pins": (2, 9),
    "margin": (0, MOST),
    "present_factor": (0, 1000),
    "present_growth": (1, 1000),
    "history_increment": (0, 1000),
    "history_decay": (0, 1),
    "step_decay": (0, 1000),
    "stall_passes": (1, MOST),
    "min_overflow_drop": (0, 1),
    "min_wirelength_gain": (0, 1),
    "reroute_fraction": (0, 1),
    "lp_after_pass": (1, MOST),
    "lp_passes": (0, MOST),
    "lp_price_scale": (0, 1000),
    "repair_after": (1, MOST),
    "overflow_stall_weight": (1, MOST),
    "repair_stall_passes": (1, MOST),
    "min_repair_fraction": (0, 1),
    "patience_factor": (1, MOST),
    "passes": (1, MOST),
    "least_gain": (0, 1),
    "threads": (1, 1024),
    "seed": (0, MOST),
}
