"""The paper's figures: edge utilisation, routed solutions, reward curves, comparisons of routers.

Every function returns a new :class:`matplotlib.figure.Figure` and touches no global state of
matplotlib, so figures can be drawn without a display and in threads. :func:`save` writes one.
Gcell (0, 0) lies at the lower left, and layers count from 1 as in the problem files.
"""

from policies.figures.charts import (
    by_problem,
    decrease_histogram,
    gaps_by_router,
    reward_curves,
)
from policies.figures.congestion import congestion_map
from policies.figures.routes import (
    comparison,
    edges_before_after,
    heat_maps,
    solution_2d,
    solution_3d,
    utilisation_histogram,
)
from policies.figures.style import save

__all__ = [
    "by_problem",
    "comparison",
    "congestion_map",
    "decrease_histogram",
    "edges_before_after",
    "gaps_by_router",
    "heat_maps",
    "reward_curves",
    "save",
    "solution_2d",
    "solution_3d",
    "utilisation_histogram",
]
