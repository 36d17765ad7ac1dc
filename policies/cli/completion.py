"""What a shell completes: keys of configurations, and names of routers and scenarios.

Nothing here raises: where a file cannot be read, the shell completes what is known without it.
"""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from marouting import InputError
from marouting.config import build, plain
from marouting.files import is_dir
from marouting.yaml_files import leaves, read_yaml

Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def _items(names: Iterable[str], incomplete: str) -> list[CompletionItem]:
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def keys_of(command: str) -> Complete:
    """Completes KEY=VALUE by the keys of a command's configurations.

    Args:
        command: ``train``, ``experiment`` or ``benchmark``; their file is the parameter ``config``.
    """

    def complete(ctx: click.Context, _: click.Parameter, incomplete: str) -> list[CompletionItem]:
        from policies.cli.resolved import kind_of, kinds

        given = (ctx.params.get(name) for name in ("resume", "config"))
        file = next((file for file in given if file), None)
        try:
            path = Path(file) / "config.yaml" if file and is_dir(file) else file
            raw = read_yaml(path) if path else {}
            schema = kinds()[kind_of(raw, command)]
            whole = plain(build(schema, raw))
        except InputError:
            # What an experiment is about has no defaults.
            whole = dict.fromkeys(kinds()[command].__dataclass_fields__)
        return _items(_keys(whole), incomplete)

    return complete


def file_or_keys(
    ctx: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Completes CONFIG of a training, or its keys where ``--resume`` names the run."""
    if ctx.params.get("resume") is None:
        return [CompletionItem(incomplete, type="file")]
    return keys_of("train")(ctx, parameter, incomplete)


def options_of_the_router(
    ctx: click.Context, _: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Completes KEY=VALUE by the options of the router that ``--router`` names."""
    from policies.learned.config import config_of, for_learner
    from policies.routers.registry import is_learner, router_component

    name = str(ctx.params.get("router") or "astar")
    try:
        if is_learner(name):
            whole = plain(config_of(for_learner({}, name)))
        else:
            whole = plain(router_component(name, {}))
            del whole["kind"]
    except InputError:
        return []
    return _items(_keys(whole), incomplete)


def _keys(whole: Mapping[str, Any]) -> list[str]:
    return [".".join(keys) + "=" for keys, _ in leaves(whole)]


def complete_router(
    ctx: click.Context, _: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Completes names of routers and learners, and where there may be one the path of a file."""
    from policies.routers.registry import router_names

    found = _items(router_names(), incomplete)
    files = ctx.command.name == "benchmark" and not found
    return [CompletionItem(incomplete, type="file")] if files else found


def scenario_names(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Completes names of scenarios."""
    from marouting import scenarios

    return _items((*scenarios.names(), "all"), incomplete)
