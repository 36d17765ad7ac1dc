"""Writes the table of arguments in docs/environment.md; run: python .site/environment.py.

It is made of the docstrings and defaults of the options.
"""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass

from docstrings import ROOT, markdown

from marouting.config import attributes
from marouting.options import GameOptions
from marouting.rules import Mask, Nets, RipUp, Rules

PAGE = ROOT / "docs" / "environment.md"
HEAD = "| argument | default | |\n|---|---|---|\n"


def page() -> str:
    """The text of docs/environment.md with the table as it is to be."""
    before, head, rest = PAGE.read_text(encoding="utf-8").partition(HEAD)
    assert head, f"{PAGE.name} has no table of arguments"
    _, end, after = rest.partition("\n\n")
    table = markdown("\n".join(_arguments()), links=False).strip()
    return f"{before}{head}{table}{end}{after}"


def _arguments() -> Iterator[str]:
    """A row for every option: what its docstring says of it, and its default."""
    inner = ((Nets, "nets."), (Mask, "mask."), (RipUp, "rip_up."))
    for cls, prefix in ((GameOptions, ""), (Rules, ""), *inner):
        defaults = {field.name: field for field in fields(cls if prefix else GameOptions)}
        for name, about in attributes(cls).items():
            field = defaults[name]
            default = field.metadata.get("name", field.default)  # of a component, or another value
            nested = is_dataclass(default)  # its fields have rows of their own
            shown = f"{type(default).__name__}()" if nested else repr(default)
            yield f"| `{prefix}{name}` | `{shown}` | {about} |"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE.relative_to(ROOT))
