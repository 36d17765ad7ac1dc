"""Routers that search."""
