"""The benchmark: routers and learners scored on the problems of :mod:`marouting.scenarios`."""
