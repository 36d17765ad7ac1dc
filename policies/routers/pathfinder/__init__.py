"""Negotiated congestion: nets first share edges freely, then compete for them until none overflows.

The router follows PathFinder (McMurchie and Ebeling, "PathFinder: a negotiation-based
performance-driven router for FPGAs", FPGA 1995). To a net, the cost of an edge consists of the
edge's length, a price that records its past overflow (the **history**), and a factor for the
overflow that the net would cause now (the **present**). Nets on overflowed edges are ripped up and
rerouted at rising prices until no edge overflows.

The first pass gives every net a tree of **patterns**, in a microsecond per pin: so there is a whole
solution at once, however large the problem (:mod:`~policies.routers.pathfinder.patterns`). With
more than 5000 nets the first round negotiates from there; with fewer it begins with shortest trees.
With more than 20 000 nets they are planned in batches, by several threads if wanted
(:mod:`~policies.routers.pathfinder.batches`); with fewer they take turns.

The search runs in rounds. A round makes three kinds of passes over the nets, and where rounds bring
nothing better any more, passes of a fourth kind improve the best solution:

* **relax** reroutes every net at the prices left by the earlier rounds. In the first round there
  are no prices yet, so every net takes its shortest route.
* **negotiate** reroutes every net that uses an overflowed edge. Prices rise from pass to pass, in
  later rounds by smaller steps. Optionally a linear program sets the initial prices
  (:mod:`~policies.routers.pathfinder.relaxation`), followed by some relax passes at these prices.
* **squeeze** reroutes every net for least overflow, then for least length. No net gets worse. As
  soon as a pass gains too little, the next round begins.
* **repair** lets a net that overflows or takes a detour displace others, and these yet others, a
  few at a time. They keep their new trees unless these are worse
  (:mod:`~policies.routers.pathfinder.repair`). The fewer nets there are to repair, the shorter is a
  pass.

The result is the best solution after any pass. Which kind of pass follows does not depend on
the time limit, so that more time never gives a worse result. A search without overflow also ends
when it saves too little for its time (the option ``least_gain``).

A net with few pins gets a cheapest tree (:func:`marouting.trees.exact_tree.exact_tree`) inside a
box around its pins and its previous tree, wider where a tree around closed edges may be shorter
outside (:func:`~policies.routers.pathfinder.trees.margin_for`). A larger net grows pin by pin, from
a random first pin, always joining the pin nearest to the tree. Then each path between two branching
points or pins is replaced by a cheapest one. In negotiating passes only the smallest nets get
cheapest trees: many good trees reach further in the same time than few best ones. Of larger nets,
most keep their tree but for the paths that overflow. Searches are kept short by a lower bound of
what a tree costs across each column and row of the box
(:func:`~policies.routers.pathfinder.kernels.set_costs`).

Where to look:

* :mod:`~policies.routers.pathfinder.router`: the router, and the stages of a search. Begin here.
* :mod:`~policies.routers.pathfinder.search`: carries stages out, looks at the clock, and keeps the
  best solution; :mod:`~policies.routers.pathfinder.routed`: what comes back.
* :mod:`~policies.routers.pathfinder.options`: the options, with their meaning and defaults;
  :mod:`~policies.routers.pathfinder.schedule`: those of ``schedule: tuned``.
* :mod:`~policies.routers.pathfinder.relaxation`: prices from a linear program.
* :mod:`~policies.routers.pathfinder.contest`: the cost of ISPD 2024 as what is minimised.
* :mod:`~policies.routers.pathfinder.state`: the arrays that the compiled code works on.

Compiled code, each file on those after it:

* :mod:`~policies.routers.pathfinder.passes`: a pass over the nets, one after another.
* :mod:`~policies.routers.pathfinder.batches`: passes in batches, and their threads.
* :mod:`~policies.routers.pathfinder.patterns`: the first pass.
* :mod:`~policies.routers.pathfinder.repair`: nets that displace each other.
* :mod:`~policies.routers.pathfinder.trees`: gives nets their trees.
* :mod:`~policies.routers.pathfinder.kernels`: finds a tree for one net.
"""

from policies.routers.pathfinder.options import PathfinderOptions
from policies.routers.pathfinder.routed import Routed
from policies.routers.pathfinder.router import PathfinderRouter

__all__ = ["PathfinderOptions", "PathfinderRouter", "Routed"]

COMPILES = "the router", 13
