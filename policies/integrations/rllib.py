"""RLlib: scores a policy that was trained on ``marouting.global_routing_v0.parallel_env``.

::

    from policies.integrations.rllib import save

    algorithm = PPOConfig()….build_algo()  # one policy for all nets, of any name
    algorithm.train()
    save(algorithm, "nets", options, "folder")

``marouting benchmark --router 'policies.integrations.rllib:Policy folder=folder'`` scores it, or in
Python :func:`marouting.evaluate_policy`. To load one runs the code that it holds.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module import RLModule

from marouting.config import build_json, check
from marouting.errors import InputError
from marouting.files import is_dir, read_text, write_text
from marouting.options import game_options
from policies.integrations.saved import Training, another

_MODULE, _OPTIONS = "module", "routing.json"
_MOST_BYTES = 2**20


def save(
    algorithm: Algorithm, policy: str, options: Mapping[str, Any], folder: str | os.PathLike[str]
) -> None:
    """Saves the module of a policy, with the options of its environment.

    Args:
        algorithm: what trained it.
        policy: its name.
        options: the arguments of ``parallel_env``.
        folder: where to; what it holds of this kind is overwritten.
    """
    place = Path(folder).resolve()
    module = algorithm.get_module(policy)
    assert module is not None  # the algorithm has a policy of that name
    module.save_to_path(place / _MODULE)
    write_text(place / _OPTIONS, json.dumps(Training(options).options, indent=1) + "\n")


class Policy:
    """A policy that :func:`save` has saved, without exploration.

    Args:
        folder: where it is.
        agent_steps, processor_seconds: what its training took; None: not known. With
            ``agents_persist`` RLlib's own numbers count agents that are done, too.
        teacher: whether it learned from something with sight of the whole problem; None: not known.

    Attributes:
        options, training, parameters: see :mod:`policies.experiment.played`.

    Raises:
        InputError: the files cannot be read.
    """

    def __init__(
        self,
        folder: str,
        agent_steps: int | None = None,
        processor_seconds: float | None = None,
        teacher: bool | None = None,
    ) -> None:
        file = Path(folder) / _OPTIONS
        self.options = build_json(dict[str, Any], read_text(file, _MOST_BYTES), str(file))
        try:
            self._mask = game_options(self.options).mask
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
        place = Path(folder) / _MODULE
        what = "the folder of a module that RLlib has saved"
        check(str(place), is_dir(place), what)
        try:
            module = RLModule.from_checkpoint(str(place.resolve()))
        except Exception as error:  # in RLlib's reader, the unpickler or later
            raise another(place, what, error) from None
        self._module = cast(Any, module)  # of torch
        took = {"agent_steps": agent_steps, "processor_seconds": processor_seconds}
        self.training = {**took, "teacher": teacher}
        self.parameters = sum(one.numel() for one in self._module.parameters())

    def moves(self, observations: NDArray[np.float32], masks: NDArray[np.int8]) -> Any:
        """(B,) moves for observations (B, *S) and masks (B, A)."""
        seen: Any = torch.from_numpy(observations)
        if self._mask.in_observation:
            free = torch.from_numpy(masks).float()
            seen = {self._mask.observation_key: seen, self._mask.mask_key: free}
        with torch.no_grad():
            outputs = self._module.forward_inference({Columns.OBS: seen})
        return outputs[Columns.ACTION_DIST_INPUTS].argmax(-1).numpy()
