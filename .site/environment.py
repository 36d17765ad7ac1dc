"""Writes docs/environment.md from the docstring of marouting/global_routing_v0.py.

    python .site/environment.py

The docstring is the page, as PettingZoo does it. The table of arguments, at the line
``## Arguments``, is made of the docstrings and defaults of the options.
"""

import inspect
from collections.abc import Iterator
from dataclasses import fields, is_dataclass

from docstrings import ROOT, markdown

from marouting import global_routing_v0
from marouting.config import attributes
from marouting.options import GameOptions
from marouting.rules import Mask, Nets, RipUp, Rules

PAGE = ROOT / "docs" / "environment.md"
NOTE = (
    "<!-- Written by `python .site/environment.py` from the docstring of "
    "marouting/global_routing_v0.py: change it there. -->\n"
)


def page() -> str:
    """The text of docs/environment.md."""
    text = inspect.getdoc(global_routing_v0)
    assert text is not None
    title, text = text.split("\n", 1)
    before, heading, after = text.partition("\n## Arguments\n")
    assert heading, "the docstring has no ## Arguments"
    text, rows = after.split("\n## ", 1)
    table = "\n".join(["| argument | default | |", "|---|---|---|", *_arguments()])
    whole = f"{title.rstrip('.')}\n{before}{heading}{text.rstrip()}\n\n{table}\n\n## {rows}"
    return NOTE + markdown(whole, links=False).rstrip() + "\n"


def _arguments() -> Iterator[str]:
    """A row for every option: what its docstring says of it, and its default."""
    inner = ((Nets, "nets."), (Mask, "mask."), (RipUp, "rip_up."))
    for cls, prefix in ((GameOptions, ""), (Rules, ""), *inner):
        defaults = {field.name: field for field in fields(cls if prefix else GameOptions)}
        for name, about in attributes(cls).items():
            field = defaults[name]
            default = field.metadata.get("name", field.default)  # of a piece, or another value
            nested = is_dataclass(default)  # its fields have rows of their own
            shown = f"{type(default).__name__}()" if nested else repr(default)
            yield f"| `{prefix}{name}` | `{shown}` | {about} |"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE.relative_to(ROOT))
