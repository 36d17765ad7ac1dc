"""The options of the router."""

from dataclasses import dataclass

from marouting.config import MOST, check


@dataclass(frozen=True, kw_only=True)
class PathfinderOptions:
    """Options of negotiated congestion.

    Defaults without a publication were tuned on ibm01 (ISPD'98) with 20 s per trial, and on
    generated problems that cannot be routed without overflow (docs/negotiation.md).

    Attributes:
        via_weight: cost of a via, in edges inside a layer. 1 matches the ISPD 2008 evaluator. Use
            a value just above 0 to compare with wirelengths that leave vias out, such as those
            published for ISPD'98.
        exact_pins: nets with at most this many pins get a cheapest tree, provided that their box
            is small, and in negotiating passes, which are many, smaller still. The paper's problems
            have at most 5 pins per net. Each further pin triples the time.
        margin: Gcells by which a net's box extends beyond its pins and its previous tree on each
            side. Where the box contains no route, it is doubled for that search.
        present: factor by which one net too many raises the cost of an edge when a round begins
            (p in PathFinder).
        growth: factor by which ``present`` grows from one negotiating pass to the next, as in
            PathFinder.
        history: amount that an overflowed edge's price rises before each negotiating pass, in
            edges (h in PathFinder).
        decay: share of the prices that is kept when the next round begins.
        calm: how soon prices come to rest. After r rounds they rise by ``history / (1 + calm r)``,
            and lose ``(1 - decay) / (1 + calm r)`` when the next one begins: such steps are usual
            in subgradient methods (Held, Wolfe and Crowder, "Validation of subgradient
            optimization", Mathematical Programming 6, 1974). 0: all rounds are alike.
        stuck: a round stops negotiating after this many passes in a row without a decrease in
            overflow.
        least_fall: share by which the overflow has to fall to count as a decrease.
        least_gain: share of the wirelength that a squeezing pass has to save for the round to
            make another one, if it lowers no overflow. Where other rounds have had less overflow,
            shorter nets are of no use.
        again: share of the nets that are rerouted even though their tree is already as short as
            possible, to make room for others.
        probe: after this many passes, if all solutions so far overflow, prices are set by a linear
            program over all trees so far, and again when a later round begins
            (:mod:`policies.routers.pathfinder.relaxation`). Not with more than 20 000 nets.
        priced: how many relaxing passes follow, each at new prices, before negotiating goes on. 0:
            there is no linear program, and prices come from past overflow alone.
        worth: what the highest price of the linear program adds to the cost of an edge, in edges.
        patience: repairing begins after this many rounds in a row without a better solution.
        worse: for this, a round counts so many times if it ends with more overflow than the best
            solution: one that ends with as little was close to a better solution.
        repairs: repairing ends after this many passes in a row without a better solution.
        least_repaired: a repairing pass reroutes as many nets as overflow or take a detour, or this
            share of all nets if that is more.
        persistence: when repairing ends, the search ends, too, if it has made this many times as
            many passes as up to its best solution, which counts as found in the twentieth pass if
            it was found before. Otherwise the next round begins. On the 121 published problems of
            Liao et al., no optimum is missed with any of sixteen seeds.
        passes: the search ends after this many passes at the latest.
        seconds: limit of processor time, so that other work on the machine does not matter; with
            several threads, of the one that works longest; None for no limit. The first pass, of
            patterns, is completed even if that takes longer: after it every net is joined. A
            solution cut off by the limit depends on the machine.
        threads: how many threads plan trees, where there are more than 20 000 nets to route. What
            comes out does not depend on it, unless ``seconds`` cuts the search off.
        start: a file of a solution to begin with, such as one that was cut off; None: begin with
            patterns. Nets that it does not join get patterns. What comes out is no worse.
        seed: seed of the random numbers.

    Raises:
        InputError: an option is out of range; the message names it and the range.
    """

    via_weight: float = 1.0
    exact_pins: int = 5
    margin: int = 2
    present: float = 0.1
    growth: float = 1.15
    history: float = 0.3
    decay: float = 0.8
    calm: float = 0.1
    stuck: int = 10
    least_fall: float = 0.01
    least_gain: float = 0.0005
    again: float = 0.1
    probe: int = 12
    priced: int = 0
    worth: float = 15.0
    patience: int = 10
    worse: int = 2
    repairs: int = 60
    least_repaired: float = 0.0
    persistence: int = 16
    passes: int = 100_000
    seconds: float | None = 50.0
    threads: int = 1
    start: str | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check("via_weight", 0 <= self.via_weight <= 1000, "a number from 0 to 1000")
        check("exact_pins", 2 <= self.exact_pins <= 9, "a number from 2 to 9")
        check("margin", 0 <= self.margin <= MOST, f"a number from 0 to {MOST}")
        check("present", 0 < self.present <= 1000, "a number above 0, up to 1000")
        check("growth", 1 <= self.growth <= 1000, "a number from 1 to 1000")
        check("history", 0 <= self.history <= 1000, "a number from 0 to 1000")
        check("decay", 0 <= self.decay <= 1, "a number from 0 to 1")
        check("calm", 0 <= self.calm <= 1000, "a number from 0 to 1000")
        check("stuck", 1 <= self.stuck <= MOST, f"a number from 1 to {MOST}")
        check("least_gain", 0 <= self.least_gain <= 1, "a number from 0 to 1")
        check("again", 0 <= self.again <= 1, "a number from 0 to 1")
        check("least_fall", 0 <= self.least_fall <= 1, "a number from 0 to 1")
        check("repairs", 1 <= self.repairs <= MOST, f"a number from 1 to {MOST}")
        check("persistence", 1 <= self.persistence <= MOST, f"a number from 1 to {MOST}")
        check("probe", 1 <= self.probe <= MOST, f"a number from 1 to {MOST}")
        check("priced", 0 <= self.priced <= MOST, f"a number from 0 to {MOST}")
        check("worth", 0 <= self.worth <= 1000, "a number from 0 to 1000")
        check("patience", 1 <= self.patience <= MOST, f"a number from 1 to {MOST}")
        check("worse", 1 <= self.worse <= MOST, f"a number from 1 to {MOST}")
        check("least_repaired", 0 <= self.least_repaired <= 1, "a number from 0 to 1")
        check("passes", 1 <= self.passes <= MOST, f"a number from 1 to {MOST}")
        check("seconds", self.seconds is None or self.seconds >= 0, "a number from 0, or null")
        check("threads", 1 <= self.threads <= 1024, "a number from 1 to 1024")
        check("seed", 0 <= self.seed <= MOST, f"a number from 0 to {MOST}")
