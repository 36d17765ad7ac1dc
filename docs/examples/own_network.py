"""An own network, an ordinary module of torch, by its name in a training.

A network is any ``torch.nn.Module`` that maps observations (B, *obs_shape) to (B, outputs). Its
constructor takes ``obs_shape`` and ``outputs``, then options as keywords. In a training's YAML::

    learner:
      kind: dqn
      network: {kind: "own_network:Residual", width: 64, blocks: 1}
"""

import torch
from torch import nn

import marouting
from marouting.config import build
from policies.cli.tables import show
from policies.learned.config import Config
from policies.learned.run import Run


class Residual(nn.Module):
    """Residual blocks with layer normalisation.

    Args:
        obs_shape: of one observation.
        outputs: how many numbers the network gives.
        width: units of every layer.
        blocks: residual blocks.
    """

    def __init__(
        self, obs_shape: tuple[int, ...], outputs: int, *, width: int = 32, blocks: int = 1
    ) -> None:
        super().__init__()
        self.first = nn.Linear(obs_shape[0], width)
        self.blocks = nn.ModuleList(
            nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.ReLU())
            for _ in range(blocks)
        )
        self.last = nn.Linear(width, outputs)

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        """(B, outputs) for observations (B, 12)."""
        x = torch.relu(self.first(obs))
        for block in self.blocks:
            x = x + block(x)
        return self.last(x)


if __name__ == "__main__":
    marouting.register("network", "residual", Residual)  # or "own_network:Residual" as its name
    config = build(
        Config,
        {
            "out": "own_network",
            "env": {"problem": {"grid": [6, 6, 2], "nets": 6, "seed": 1, "reduced_edges": 0}},
            "learner": {
                "kind": "dqn",
                "network": {"kind": "residual", "blocks": 1},
                "learning_rate": 1e-3,
                "target_period": 200,
                "burn_in_size": 1000,
                "masking": True,
            },
            "train": {"episodes": 50, "figures": False, "tensorboard": False},
        },
    )
    run = Run(config)
    print("learner:", run.trainer.learner.backend)
    print("network:", run.trainer.learner.networks.module)
    show(run.execute(), "own_network")
