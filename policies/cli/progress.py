"""The progress bar of work that takes minutes or hours."""

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


def progress_bar(unit: str, *, shown: bool = True) -> Progress:
    """A bar on standard error: what is done of how many, and the time.

    Args:
        unit: what is counted, in the plural.
        shown: whether it shows; otherwise it takes its updates and prints nothing.
    """
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=not shown,
    )
