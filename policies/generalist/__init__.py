"""The generalist: one network for all nets and problems; see README.md beside this file."""

from pathlib import Path

COMPILES = "the generalist", 30

SHIPPED = Path(__file__).with_name("generalist.pt")
"""The weights that are shipped."""
