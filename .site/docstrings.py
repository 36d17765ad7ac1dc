"""Docstrings as the site shows them: Sphinx's roles become links or code, ``::`` a colon.

A griffe extension (mkdocstrings reads docstrings by griffe), and :func:`markdown`, which
``environment.py`` uses without it.
"""

import re
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[1]
REFERENCE: dict[str, dict[str, Any]] = yaml.safe_load(
    (Path(__file__).parent / "reference.yml").read_text(encoding="utf-8")
)
DOCUMENTED = frozenset(name for page in REFERENCE.values() for name in page["names"])
"""The names that have a place in the reference."""

_ROLE = re.compile(r":(?:mod|class|func|meth|data|attr):`~?([^`]+)`", re.DOTALL)
_TABLE = re.compile(r"^={3,} [= ]+$.*?^={3,} [= ]+$", re.MULTILINE | re.DOTALL)
"""A table of reStructuredText, shown as it is."""

_ENDS = {name.rsplit(".", 1)[-1]: name for name in DOCUMENTED}


def markdown(text: str, links: bool) -> str:
    """A docstring without Sphinx's roles and marks.

    Args:
        text: the docstring.
        links: whether names that the reference has become links to it, and not only code.
    """

    def shown(match: re.Match[str]) -> str:
        name = re.sub(r"\s", "", match[1])
        place = name if name in DOCUMENTED else _ENDS.get(name.rsplit(".", 1)[-1])
        short = name.lstrip(".")
        return f"[`{short}`][{place}]" if links and place else f"`{short}`"

    text = re.sub(r"::$", ":", _ROLE.sub(shown, text), flags=re.MULTILINE)
    return _TABLE.sub(lambda table: f"```text\n{table[0]}\n```", text)


try:
    from griffe import Extension
except ImportError:  # the environment page needs no griffe
    pass
else:

    class Docstrings(Extension):
        """Puts every docstring into the form that the site shows."""

        def on_instance(self, *, obj: Any, **_: Any) -> None:
            """Called for every module, class, function and attribute."""
            if obj.docstring is not None:
                obj.docstring.value = markdown(obj.docstring.value, links=True)
