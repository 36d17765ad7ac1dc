"""A chip cut into regions, each of which another process routes, perhaps on another machine.

1. One pass of patterns gives every net of the whole chip a tree: in microseconds per pin, so that
   it is quick on any chip that one machine can hold
   (:mod:`policies.routers.pathfinder.patterns`).
2. Lines across the chip part it into **regions** with about as much work each, where few wires
   cross; nets on full edges are more work than others. A net that crosses a line is cut into parts
   there: where a wire crosses, each of its two Gcells is a pin of a part. What joins the pins of
   all its parts joins the net.
3. Every region is a problem of its own, with all its parts of nets, and **negotiated** alone
   (:mod:`policies.routers.pathfinder`). No edge belongs to two regions, so they need not know of
   each other.
4. The boundary is negotiated in the same way: a **strip** along every line is a problem of its own,
   whose parts may cross the line anywhere; where they leave the strip they stay.
5. Regions and strips take turns, and each goes on from the routes, the prices and the factor of
   congestion that the one before has come to.

What comes back replaces what was there unless it is worse, by overflow and then wirelength. So
there is a whole solution at any time.

* :mod:`~policies.routers.regions.cutting`: from a solution to the problems of its regions, and
  back.
* :mod:`~policies.routers.regions.router`: the router, its options and what it reports.
"""

from policies.routers.regions.router import RegionsOptions, RegionsRouter

__all__ = ["RegionsOptions", "RegionsRouter"]
