"""Options and arguments that commands share."""

import contextlib
import functools
import io
import json
import os
import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_origin

import click

from marouting.config import attributes, hints_of
from marouting.files import exists
from marouting.registry import allowing_code
from policies.cli.completion import Complete
from policies.results.run_folder import policy_file


class _File(click.Path):
    """A path; an empty one, as of a variable that is not set, is refused."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path."""
        if not os.fspath(value):
            self.fail("expected a path, found an empty one", param, ctx)
        return super().convert(value, param, ctx)


FILE = _File(path_type=Path)
"""The path of a file or folder, which shells complete."""


class _Trained(_File):
    """A trained policy: its file, also where the folder of its training is given."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The file of the policy, or the path as it is if it leads to none."""
        path = super().convert(value, param, ctx)
        return policy_file(Path(os.fsdecode(path))) or path


TRAINED = _Trained(path_type=Path)
"""The path of a trained policy or of its training's folder."""


def options_of(schema: Any, without: Collection[str] = ()) -> Callable[[Any], Any]:
    """Gives a command an option for every field of a dataclass, as the dataclass describes it."""
    about, hints = attributes(schema), hints_of(schema)

    def add(command: Any) -> Any:
        for own in reversed(fields(schema)):
            if own.name not in without:
                text = about[own.name].replace("`", "")
                if own.default is None:
                    text = text.replace(". None: ", ". Without it, ")
                    text = text.replace("None: ", "without it, ")
                command = click.option(
                    f"--{own.name.replace('_', '-')}",
                    type=_type_of(hints[own.name]),
                    default=own.default,
                    show_default=own.default is not None,
                    help=text.partition("; None:")[0],
                )(command)
        return command

    return add


def _type_of(hint: Any) -> Any:
    """What click reads for a type."""
    inner = get_args(hint)
    if get_origin(hint) is Literal:
        return click.Choice(inner)
    if get_origin(hint) is tuple:
        return click.Tuple([_type_of(one) for one in inner])
    kind = next((one for one in inner if one is not NoneType), hint)
    return {int: click.INT, float: click.FLOAT}[kind]


def keep_stdout_for_results() -> None:
    """Leaves standard output to results: what solvers print by themselves is an error message.

    HiGHS of SciPy 1.17 has a message that no option turns off.
    """
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout is sys.__stdout__:
        with contextlib.suppress(OSError):  # closed
            own = os.dup(1)
            os.dup2(2, 1)
            how = sys.stdout.encoding, sys.stdout.errors
            sys.stdout = os.fdopen(own, "w", -1, *how)


json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object instead of text."
)


def allow_code_option(command: Callable[..., None]) -> Callable[..., None]:
    """Adds the option ``--allow-code`` to a command whose files may name classes."""

    @click.option(
        "--allow-code",
        is_flag=True,
        help="Let files name observations, rewards, routers, networks and learners as "
        "module:Class, which imports and runs that code.",
    )
    @functools.wraps(command)
    def allowing(allow_code: bool, **rest: Any) -> None:
        with allowing_code(allow_code):
            command(**rest)

    return allowing


def overrides_argument(complete: Complete) -> Callable[[Any], Any]:
    """The argument KEY=VALUE of a command, and what shells complete of it."""
    return click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...", shell_complete=complete)


def split_config(
    config: Path | None, overrides: tuple[str, ...]
) -> tuple[Path | None, tuple[str, ...]]:
    """A file and its keys, where the file may have been left out and a key stands in its place."""
    if config is not None and "=" in str(config) and not exists(config):
        return None, (str(config), *overrides)
    return config, overrides


def print_result(as_json: bool, text: str, **values: Any) -> None:
    """Prints what a command has done: a line of text, or its figures as one JSON object."""
    click.echo(json_text(values) if as_json else text)


def json_text(values: Mapping[str, Any]) -> str:
    """A JSON object in one line, with paths as text."""
    return json.dumps(values, default=lambda v: v.tolist() if hasattr(v, "tolist") else str(v))
