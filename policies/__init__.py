"""What plays and routes on :mod:`marouting`: classical and learned routers, and what runs them.

Importing it registers the names of its routers, learners and networks; their modules are imported
when they are first used.
"""

import policies.learned.algorithms
import policies.learned.networks
import policies.routers  # noqa: F401
from marouting.registry import register

DISTRIBUTION = "marouting"
"""Whose package this is: its name is a common one."""

# Here, because routers that do not learn come first.
register("router", "generalist", "policies.generalist.router:GeneralistRouter")
