"""Routers that learn: networks, memories, algorithms, and the training that runs them."""

from marouting.registry import register

register("router", "learned", "policies.learned.generalist:GeneralistRouter")
