"""Colours, and writing figures to files."""

import os
import textwrap
import warnings
from pathlib import Path

from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure

from marouting.errors import InputError
from marouting.files import writing

# Paul Tol's "vibrant" scheme: distinct in print and for colour-blind readers.
BLUE, RED, TEAL, ORANGE = "#0077BB", "#CC3311", "#009988", "#EE7733"
MAGENTA, CYAN, INK = "#EE3377", "#33BBEE", "#202020"
LINES = (BLUE, RED, TEAL, ORANGE, MAGENTA, CYAN, INK)
PALE = "#E3E5E8"
BAND = "#FFD24D"
VIA = "#808080"

DPI = 150


def literal(text: str) -> str:
    """A text with names in it, for matplotlib to show as it stands.

    A name may contain dollar signs that do not mean formulas, or half a character, as in the name
    of a file that is not UTF-8. Legends leave out labels that begin with an underscore.
    """
    text = text.replace("$", r"\$").encode(errors="backslashreplace").decode()
    return f"\N{ZERO WIDTH SPACE}{text}" if text.startswith("_") else text


def fitted(text: str, inches: float, points: float = 11) -> str:
    """A text with lines that fit into a width: a panel's title must not run into the next panel.

    Args:
        text: the text, which may have lines already.
        inches: the width.
        points: the size of the letters, which are taken to be 0.58 as wide on average.
    """
    width = max(int(72 * inches / (0.58 * points)), 12)
    lines = [textwrap.wrap(line, width, break_on_hyphens=False) for line in text.split("\n")]
    return "\n".join(line for parts in lines for line in parts)


def is_picture(path: Path) -> bool:
    """Whether :func:`save` can write a file of that suffix."""
    return (path.suffix[1:].lower() or "png") in FigureCanvasBase.get_supported_filetypes()


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Writes a figure at 150 dpi, whole or not at all.

    Args:
        figure: the figure.
        path: the file; its suffix gives the format (``.png`` if there is none).
    """
    target = Path(path)
    if not is_picture(target):
        raise InputError(f"{target}: expected a picture's suffix such as .png, .pdf or .svg")
    kind = target.suffix[1:].lower() or "png"
    with writing(target) as temporary, warnings.catch_warnings():
        # What the font lacks is drawn as a box.
        warnings.filterwarnings("ignore", "Glyph|Matplotlib currently does not", UserWarning)
        figure.savefig(temporary, format=kind, dpi=DPI, bbox_inches="tight", pad_inches=0.1)
