"""The proven optimum: least overflow, then least wirelength, with a proof.

To route a problem is to choose a tree for every net. The router narrows the gap between the best
solution found and a lower bound in three steps:

1. **Prices.** A linear program may mix several trees of a net. Its dual values are prices for
   capacity. At given prices, each net's cheapest tree can be found independently
   (:mod:`~policies.routers.optimal.priced_tree`). No solution can cost less than these trees
   together minus the price of all capacity: this is the bound of Lagrangian relaxation (Geoffrion,
   "Lagrangean relaxation for integer programming", Mathematical Programming Study 2, 1974). The
   new trees join the linear program, which finds better prices, until the two agree. This is
   column generation (Dantzig and Wolfe, "Decomposition principle for linear programs", Operations
   Research 8, 1960). Prices are rounded to whole numbers and the bound is computed from these
   exactly, so it holds whatever the solver's tolerances. It equals the bound of the linear
   relaxation of step 3.
2. **Choice.** An integer program chooses one of the trees found for each net. On most problems the
   result meets the bound and is therefore optimal.
3. **Flows.** Otherwise the router finds the edges that matter: an edge is useless to a net if every
   solution in which the net uses it is provably too long. The cheapest trees through the useful
   edges join the choice. If that is not enough, an integer program over these edges decides, with
   a flow from each net's first pin to each of its other pins (Wong, "A dual ascent approach for
   Steiner tree problems on a directed graph", Mathematical Programming 28, 1984). Only here does a
   proof rely on the solver's own bound, which is lowered by SLIP for safety.

Overflow is minimised first, by the same steps. The solver is HiGHS, as shipped with scipy.

The first trees come from sequential A* and from negotiated congestion
(:mod:`policies.routers.pathfinder`). The latter is usually at or near the optimum. If it has no
overflow, no bound on overflow is needed, and its trees fit together, which helps the linear
program.

Where to look:

* :mod:`~policies.routers.optimal.router`: the router and its options, and how the steps follow
  one another.
* :mod:`~policies.routers.optimal.candidates`: the trees to choose from and the best solution.
* :mod:`~policies.routers.optimal.priced_tree`: the cheapest tree of a net at given prices.
* :mod:`~policies.routers.optimal.programs`: linear and integer programs as scipy takes them, and
  step 2.
* :mod:`~policies.routers.optimal.prices`: step 1.
* :mod:`~policies.routers.optimal.flows`: step 3.
"""

from policies.routers.optimal.router import OptimalRouter, Optimum

__all__ = ["OptimalRouter", "Optimum"]
