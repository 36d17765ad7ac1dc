"""Routers that learn: networks, memories, algorithms, and the training that runs them."""

COMPILES = "the learners", 12
