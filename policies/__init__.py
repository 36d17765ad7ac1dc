"""What plays and routes on :mod:`marouting`: classical and learned routers, and what runs them.

Importing it registers the names of its routers, learners and networks; their modules are imported
when they are first used.
"""

import policies.learned.algorithms
import policies.learned.networks
import policies.routers  # noqa: F401
