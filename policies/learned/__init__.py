"""Routers that learn."""
