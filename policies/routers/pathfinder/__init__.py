"""Negotiated congestion: nets first share edges freely, then compete for them until none overflows.

The router follows PathFinder (McMurchie and Ebeling, "PathFinder: a negotiation-based
performance-driven router for FPGAs", FPGA 1995). To a net, the cost of an edge consists of the
edge's length, a price that records its past overflow (the **history**), and a factor for the
overflow that the net would cause now (the **present**). Nets on overflowed edges are ripped up and
rerouted at rising prices until they have found other ways.

The search runs in rounds. A round makes three kinds of passes over the nets:

* **relax** reroutes every net at the prices left by the earlier rounds. In the first round there
  are no prices yet, so every net takes its shortest route.
* **negotiate** reroutes every net that uses an overflowed edge. Prices rise from pass to pass.
* **squeeze** reroutes every net for least overflow, then for least length. No net gets worse. As
  soon as a pass gains too little, the next round begins.

The result is the best solution after any pass.

A net with few pins gets a cheapest tree (:func:`marouting.trees.exact_tree.exact_tree`) inside a
box around its pins and its previous tree. A larger net grows pin by pin, from a random first pin,
always joining the pin nearest to the tree. Then each path between two branching points or pins is
replaced by a cheapest one.

Where to look:

* :mod:`~policies.routers.pathfinder.options`: the options, with their meaning and defaults.
* :mod:`~policies.routers.pathfinder.state`: the arrays that the compiled code works on.
* :mod:`~policies.routers.pathfinder.kernels`: compiled code that finds a tree for one net.
* :mod:`~policies.routers.pathfinder.passes`: compiled code for passes and rounds.
* :mod:`~policies.routers.pathfinder.router`: the router, and what it reports.
"""

from policies.routers.pathfinder.options import PathfinderOptions
from policies.routers.pathfinder.router import PathfinderRouter, Routed

__all__ = ["PathfinderOptions", "PathfinderRouter", "Routed"]
