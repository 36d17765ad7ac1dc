"""Networks: ordinary modules of torch, and the stack that runs many of them at once.

A network is a class with the constructor ``Network(obs_shape, outputs, *, own options)``. It maps
observations (B, *obs_shape) float32 to (B, outputs) numbers: the values of the moves, or the
scores of a policy.
"""

from marouting.registry import register

register("network", "mlp", "policies.learned.networks.mlp:MLP")
register("network", "conv", "policies.learned.networks.conv:Conv")
