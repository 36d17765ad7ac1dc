"""A small convolutional network, for observations that are pictures of the grid."""

from torch import Tensor, nn

from marouting.errors import InputError
from policies.learned.networks.mlp import Affine, duel


class Conv(nn.Module):
    """3×3 convolutions that keep the picture's size, then fully connected layers, with ReLUs.

    Args:
        obs_shape: (channels, height, width) of one observation.
        outputs: how many numbers the network gives.
        channels: of each convolution.
        hidden: units of the fully connected hidden layers.
        dueling: see :class:`policies.learned.networks.mlp.MLP`.

    Raises:
        InputError: the observation is no picture.
    """

    def __init__(
        self,
        obs_shape: tuple[int, ...],
        outputs: int,
        *,
        channels: tuple[int, ...] = (16, 32),
        hidden: tuple[int, ...] = (64,),
        dueling: bool = False,
    ) -> None:
        super().__init__()
        if len(obs_shape) != 3:
            raise InputError(
                f"network: conv: expected observations (channels, height, width), found {obs_shape}"
            )
        planes, height, width = obs_shape
        layers: list[nn.Module] = []
        for more in channels:
            layers += [nn.Conv2d(planes, more, 3, padding=1), nn.ReLU()]
            planes = more
        layers.append(nn.Flatten())
        units = planes * height * width
        for more in hidden:
            layers += [Affine(units, more), nn.ReLU()]
            units = more
        self.layers = nn.Sequential(*layers, Affine(units, outputs + dueling))
        self.dueling = dueling

    def forward(self, obs: Tensor) -> Tensor:
        """(B, outputs) for observations (B, channels, height, width)."""
        x: Tensor = self.layers(obs)
        return duel(x) if self.dueling else x
