"""How commands that are not part of ``marouting`` end bad input: one line, exit status 2."""

from typing import Any

import click

from marouting import InputError


class Command(click.Command):
    """A command of click's to which :class:`marouting.InputError` is an error of the user."""

    def invoke(self, ctx: click.Context) -> Any:
        """Runs the command."""
        try:
            return super().invoke(ctx)
        except InputError as error:
            raise _Refused(str(error)) from None


class _Refused(click.ClickException):
    exit_code = 2
