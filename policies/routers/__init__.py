"""Routers: what turns a problem into a solution without learning."""

from marouting.registry import register

register("router", "astar", "policies.routers.astar:AStarRouter")
register("router", "random", "policies.routers.random:RandomRouter")
register("router", "greedy", "policies.routers.greedy:GreedyRouter")
register("router", "local", "policies.routers.local:LocalRouter")
register("router", "pathfinder", "policies.routers.pathfinder:PathfinderRouter")
register("router", "optimal", "policies.routers.optimal:OptimalRouter")
