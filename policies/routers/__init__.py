"""Routers: what turns a problem into a solution."""
