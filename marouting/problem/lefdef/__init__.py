"""LEF/DEF designs, as of the ISPD 2018 and 2019 contests, as global routing problems.

A DEF file places the macros that LEF files describe, and says which of their pins each net joins.
Capacity comes from the tracks, less those that shapes block:

* A **Gcell** is a field of the DEF's GCELLGRID, or of a tile that is given, or of 15 tracks; with
  tiles, the last Gcell of a row takes what is left. Fields may differ in size; the problem has them
  all alike, with pins in their middle, and :class:`marouting.problem.chip.Chip` keeps the lines.
* A layer's wires go along its preferred direction only, on the tracks of the DEF, or by the LEF's
  pitch where it has none. A net takes one track, or more by its
  nondefault rule.
* An edge's **capacity** is the number of tracks in its row of Gcells on which a wire can go from
  the middle of one Gcell to the middle of the next and keep its distance from all pins,
  obstructions, special nets and blockages: half the layer's width and its spacing.
* A **pin** is in the Gcell and layer that hold most of its area.

Where to look:

* :mod:`~marouting.problem.lefdef.statements`: files as statements, with their lines.
* :mod:`~marouting.problem.lefdef.lef_text`: layers' rules, and the names of vias, macros and pins.
* :mod:`~marouting.problem.lefdef.def_text`: tracks, Gcells, components, pins and nets, which
  klayout does not provide.
* :mod:`~marouting.problem.lefdef.shapes`: shapes of macros, pins, wires and blockages, read by
  klayout (the extra ``lefdef``).
* :mod:`~marouting.problem.lefdef.tracks`: tracks and their capacity.
* :mod:`~marouting.problem.lefdef.design`: the steps from there to a problem.
"""

from marouting.problem.lefdef.design import read_design

__all__ = ["read_design"]
