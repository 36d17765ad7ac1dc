"""Routers that learn: networks, memories, algorithms, and the training that runs them."""

from marouting.kernels import ANNOUNCED

ANNOUNCED[__name__] = "the learners", 12
