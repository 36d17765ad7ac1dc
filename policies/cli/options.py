"""Options and arguments that commands share."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from policies.cli.completion import Complete

FILE = click.Path(path_type=Path)
"""The path of a file or folder, which shells complete."""

json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object instead of text."
)


def overrides_argument(complete: Complete) -> Callable[[Any], Any]:
    """The argument KEY=VALUE of a command, and what shells complete of it."""
    return click.argument("overrides", nargs=-1, metavar="[KEY=VALUE]...", shell_complete=complete)


def tell(as_json: bool, text: str, **values: Any) -> None:
    """Prints what a command has done: a line of text, or its figures as one JSON object."""
    click.echo(as_text(values) if as_json else text)


def as_text(values: Mapping[str, Any]) -> str:
    """A JSON object in one line, with paths as text."""
    return json.dumps(values, default=str)
