"""Where the command ``marouting`` starts, also as ``python -m marouting``.

The command line is in ``policies``. This file makes sure that it is the one of this project.

Another package of this name may lie earlier on Python's path, or have been installed over ours.
"""

import sys


def main() -> None:
    """Runs the command line and exits with its status."""
    try:
        import policies
    except ImportError as error:
        sys.exit(_complain(f"{error.name} is missing: pip install 'marouting[learn]'"))
    if getattr(policies, "DISTRIBUTION", None) != "marouting":
        where = next(iter(getattr(policies, "__path__", [])), policies.__file__)
        what = "expected the package `policies` of marouting, found another of this name"
        sys.exit(_complain(f"{where}: {what}: take it from Python's path, or install both apart"))
    from policies.cli.main import main as command_line

    command_line()


def _complain(message: str) -> int:
    print(f"marouting: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    main()
