"""The text formats of the ISPD benchmarks, for problems and for solutions.

Three formats for problems are so much alike that one reader and one writer serve them:

==================== ====================== ===================== ================
..                   ``ispd2008``           ``ispd98``            ``ispd98-flat``
==================== ====================== ===================== ================
grid                 columns, rows, layers  the same              columns, rows
vertical capacity    one number per layer   the same              one number
horizontal capacity  one number per layer   the same              one number
minimum width        one number per layer   the same              none: 1
minimum spacing      one number per layer   as ``minimum width``  none: 0
via spacing          one number per layer   the same              none: 0
origin, tile         four numbers           the same              none: 0 0, 1 1
num net              number of nets         the same              the same
a net                name id pins width     name id pins          name id pins
a pin                x y layer              x y                   x y
adjustments          a count, then rows     none                  none
==================== ====================== ===================== ================

``ispd2008`` is the ``.gr`` file of the ISPD 2008 global routing contest
(http://www.ispd.cc/contests/08/ispd08rc.html). Adjustments give single edges their own capacity:
``x y layer x y layer capacity``, with columns and rows from 0 and layers from 1. The contest does
not forbid several adjustments of one edge; its evaluator (``eval2008.pl``) lets the last one count.
A net whose width differs by layer has the widths of all layers in its line, lowest first: an
extension of this package.

``ispd98`` is the format of ``ibm01.modified.txt`` in BoxRouter 2.0 (Cho et al., 2007): the ISPD'98
benchmarks with two layers. Its header differs from the contest's in one wrong word, by which it is
recognised: the minimum spacing is labelled ``minimum width``, a second time. Pins are in layer 1;
several pins of a net, even all of them, may lie in one Gcell. A wire takes width 1 + spacing 1, so
capacities 24 and 28 are the twelve and fourteen tracks of the flat file.

``ispd98-flat`` holds the same benchmarks in the plane, as Labyrinth (Kastner et al., 2000) and
BoxRouter publish them: one layer with both capacities, in tracks. The values that the file lacks
are those that NTHU-Route 2.0 (Chang et al., 2008) assumes. A grid of two numbers identifies it.

:mod:`~marouting.problem.ispd.ispd2024` reads the problems of the ISPD 2024 and 2025 contests;
:mod:`marouting.problem.lefdef` those of the ISPD 2018 and 2019 contests, LEF/DEF designs. Solutions
are ISPD solution text (:mod:`~marouting.problem.ispd.solution_text`), routing guides, OpenROAD's
route segments, which are ISPD 2025's output, or ISPD 2024's output
(:mod:`~marouting.problem.ispd.routes_text`). Any file may be compressed and have a byte order mark
(:func:`marouting.files.reading`).

Readers return plain records and know neither Problem nor Solution, which read and write through
this package. Files are read line by line and nothing is allocated for what a header merely
promises. Numbers have ASCII digits, tokens are separated by ASCII blanks, blank lines are ignored,
and keywords may be in any case. Anything wrong raises :class:`~marouting.errors.InputError` with
one line that names the file and the line. Written files have one form only, so equal objects give
equal bytes.
"""

from marouting.problem.ispd.ispd2024 import read_contest
from marouting.problem.ispd.problem_text import (
    FORMATS,
    Format,
    ProblemRecord,
    read_problem,
    write_problem,
)
from marouting.problem.ispd.routes_text import RoutesRecord, write_routes
from marouting.problem.ispd.solution_text import SolutionRecord, read_solution, write_solution

__all__ = [
    "FORMATS",
    "Format",
    "ProblemRecord",
    "RoutesRecord",
    "SolutionRecord",
    "read_contest",
    "read_problem",
    "read_solution",
    "write_problem",
    "write_routes",
    "write_solution",
]
