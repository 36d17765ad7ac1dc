"""Moves without learning: A* on the capacity grid, and agents that follow finished routes."""
