"""A chip cut into regions, each of which another process routes, perhaps on another machine.

1. One pass of patterns gives every net of the whole chip a tree: in microseconds per pin, so that
   it is quick on any chip that one machine can hold
   (:mod:`policies.routers.pathfinder.patterns`).
2. Lines across the chip part it into **regions**. A net belongs to the region that has the middle
   of its pins, and no other moves it. A region reaches a little beyond its lines. Where a net leads
   farther, it is cut: where a wire crosses, the Gcell is a pin of what is inside, and what is
   outside stays.
3. Near a line regions share the **tracks** of every edge: each has those that its nets use, and of
   what is free the more the nearer it is; of what is too much each has to give up as large a share.
   So the regions need not know of each other, and what all of them find fits together.
4. Every region is a problem of its own and makes a few passes of **negotiation**
   (:mod:`policies.routers.pathfinder`). That is a step.
5. The next step has other lines, and goes on from the routes, the prices and the factor of
   congestion that the one before has come to. **Calm** and **even** lines take turns. At calm lines
   the fewest nets on full edges cross, so that wires can spread out of hot spots. Even lines part
   the work, where it is, so that all regions have as much. Steps grow longer when they bring
   little; the last one has calm lines.

No step makes a solution worse, so there is a whole solution at any time.

* :mod:`~policies.routers.regions.cutting`: from a solution to the problems of its regions, and
  back.
* :mod:`~policies.routers.regions.router`: the router, its options and what it reports.
"""

from policies.routers.regions.router import RegionsOptions, RegionsRouter

__all__ = ["RegionsOptions", "RegionsRouter"]
