"""Colours, and writing figures to files."""

import os
from pathlib import Path

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


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Writes a figure at 150 dpi, whole or not at all.

    Args:
        figure: the figure.
        path: the file; its suffix gives the format (``.png`` if there is none).

    Raises:
        InputError: the file cannot be written, or matplotlib does not know the format.
    """
    target = Path(path)
    kind = target.suffix[1:].lower() or "png"
    if kind not in figure.canvas.get_supported_filetypes():
        raise InputError(f"{target}: expected a picture's suffix such as .png, .pdf or .svg")
    with writing(target) as temporary:
        figure.savefig(temporary, format=kind, dpi=DPI, bbox_inches="tight", pad_inches=0.1)
