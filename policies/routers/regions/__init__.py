"""A chip cut into regions, each of which another process routes, perhaps on another machine.

1. One pass of patterns gives every net of the whole chip a tree: in microseconds per pin, so that
   it is quick on any chip that one machine can hold
   (:mod:`policies.routers.pathfinder.patterns`).
2. Lines across the chip divide it into **regions**. A net belongs to the region that contains the
   centre of its pins, and only this region reroutes it. A region extends a little beyond its lines.
   A net that extends farther is cut: the Gcell where it crosses becomes a pin of the part inside,
   and the part outside stays as it is.
3. Near a line, regions share the **tracks** of every edge: each gets those that its nets use, and
   a share of the free ones that is larger the nearer the region is; overflow is divided in
   proportion. So regions are routed independently, and their results fit together.
4. Every region is a problem of its own and makes a few passes of **negotiation**
   (:mod:`policies.routers.pathfinder`). That is a step.
5. The next step has other lines, and continues from the routes, the prices and the congestion
   factor of the previous one. **Calm** and **even** lines alternate. Calm lines cross as few
   nets on full edges as possible, so that wires can spread out of hot spots. Even lines give all
   regions the same amount of work. Steps grow longer when they gain little; the last one has
   calm lines.

No step makes a solution worse, so there is a complete solution at any time.

* :mod:`~policies.routers.regions.cutting`: from a solution to the problems of its regions, and
  back.
* :mod:`~policies.routers.regions.router`: the router, its options and what it reports.
"""

from policies.routers.regions.router import RegionsOptions, RegionsRouter

__all__ = ["RegionsOptions", "RegionsRouter"]
