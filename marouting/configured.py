"""From a configuration to an environment."""

import os
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, get_args

from marouting.config import check
from marouting.env.single import GlobalRoutingSingle
from marouting.errors import InputError
from marouting.old_names import unknown_key
from marouting.options import Agents, EnvOptions, with_suggestions
from marouting.registry import allowing_code
from marouting.yaml_files import read_yaml

OPTIONS = tuple(field.name for field in fields(EnvOptions))
"""The keys of ``env``."""

KEYS = ("seed", "out", "env", "learner", "train")
"""The keys of a configuration; all but ``env`` belong to :mod:`policies.learned.config`."""


def make(
    config: str | os.PathLike[str] | Mapping[str, Any] | Any,
    *,
    parallel: bool = False,
    allow_code: bool = False,
) -> Any:
    """Makes the environment that the ``env:`` part of a configuration describes.

    The key ``agents`` decides between two environments: ``single`` gives the Gymnasium environment
    in which one player moves all nets, ``multi`` the PettingZoo environment in which every net is
    an agent.

    Args:
        config: the path of a YAML file; a mapping with a key ``env``, whose ``problem`` may also be
            a :class:`marouting.Problem` or a list of them; an
            :class:`marouting.options.EnvOptions`; or an object with one as its attribute ``env``.
            The other keys of a configuration (:data:`KEYS`) belong to trainings: their values are
            not looked at.
        parallel: for ``multi``, whether all nets move in each step (PettingZoo's Parallel
            environment) or one after another (AEC).
        allow_code: whether a file may name observations and rewards as ``module:Class``, which is
            code that is imported. A mapping always may.

    Returns:
        A ``gymnasium.Env``, ``pettingzoo.AECEnv`` or ``pettingzoo.ParallelEnv``.

    Raises:
        InputError: the configuration cannot be used; the message names the file or key and what was
            expected.
    """
    from marouting.global_routing_v0 import env, parallel_env

    where = "config"
    if isinstance(config, str | os.PathLike):
        where = os.fspath(config)
        with allowing_code(allow_code):
            config = read_yaml(config)
    if isinstance(config, Mapping):
        for key in config:
            if key not in KEYS:
                raise InputError(f"{where}: {unknown_key(str(key), KEYS)}")
        part = {} if config.get("env") is None else config["env"]
        if not isinstance(part, Mapping):
            raise InputError(f"{where}: env: expected a mapping, found {part!r}")
    else:
        options = getattr(config, "env", config)
        if not isinstance(options, EnvOptions):
            raise InputError(f"config: expected a path, a mapping or a Config, found {config!r}")
        part = {name: getattr(options, name) for name in OPTIONS}
    for key in part:
        if key not in OPTIONS:
            raise InputError(f"{where}: env: {unknown_key(str(key), OPTIONS)}")
    part = {"agents": "single", **with_suggestions(part)}
    known, found = get_args(Agents), part["agents"]
    check(f"{where}: env: agents", found in known, f"one of {', '.join(known)}, found {found!r}")
    check(f"{where}: env: agents", found == "multi" or not parallel, "multi, for parallel=True")
    make_multi = parallel_env if parallel else env
    try:
        return make_multi(**part) if found == "multi" else GlobalRoutingSingle(**part)
    except InputError as error:
        raise InputError(f"{where}: env: {error}") from None
