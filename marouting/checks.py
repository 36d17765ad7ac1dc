"""Options that check themselves, also when they are made without a configuration."""

import math
from typing import Any

from marouting.config import check, hints_of, of_key


def check_fields(options: Any, kind: Any = None, **bounds: tuple[float, float]) -> None:
    """Checks the fields of a dataclass by their types and bounds; makes nested ones of mappings.

    Args:
        options: the dataclass.
        kind: the class whose fields are checked; None: its own.
        **bounds: the least and the greatest value of a field.

    Raises:
        InputError: a value is not valid for its field; the message names the field, what was
            expected and what was found.
    """
    schema: Any = kind or type(options)
    for name, hint in hints_of(schema).items():
        value = of_key(name, getattr(options, name), hint)
        object.__setattr__(options, name, value)
        if name in bounds and value is not None:
            least, most = bounds[name]
            text = f"{least:g} to {most:.10g}" if most < math.inf else f"a number from {least:g}"
            check(name, least <= value <= most, f"{text}, found {value!r}")
