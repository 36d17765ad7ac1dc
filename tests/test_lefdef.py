"""LEF/DEF designs as problems: capacities and pins worked by hand; files that cannot be used."""

import json
import re
import sys
import time
import tracemalloc
import warnings
from pathlib import Path

import pytest

from marouting import (
    Controls,
    InputError,
    Problem,
    ProblemFile,
    Solution,
    adjusted,
    evaluate,
)
from marouting.search.astar import sequential_astar
from policies.cli.main import status

pytest.importorskip("klayout.db")

ISPD18 = Path(__file__).resolve().parents[2] / "shared" / "data" / "ispd18"
needs_ispd18 = pytest.mark.skipif(not ISPD18.exists(), reason="needs the design in ../shared/data")

LEF = """\
VERSION 5.8 ;
UNITS
  DATABASE MICRONS 1000 ;
END UNITS
LAYER M1
  TYPE ROUTING ;
  DIRECTION HORIZONTAL ;
  PITCH 0.1 ;
  WIDTH 0.04 ;
  SPACINGTABLE
    PARALLELRUNLENGTH 0
    WIDTH 0 0.04
    WIDTH 0.1 0.08 ;
  PROPERTY LEF58_TYPE "TYPE ;
    x ;" ;
END M1
LAYER V1
  TYPE CUT ;
END V1
LAYER M2
  TYPE ROUTING ;
  DIRECTION VERTICAL ;
  PITCH 0.1 0.1 ;
  WIDTH 0.04 ;
  SPACING 0.04 ;
END M2
MACRO CELL
  CLASS CORE ;
  FOREIGN CELL 0 0 ;
  ORIGIN 0 0 ;
  SIZE 0.4 BY 0.4 ;
  PIN A
    DIRECTION INPUT ;
    PORT
      LAYER M1 ;
        RECT 0.02 0.02 0.08 0.08 ;
    END
  END A
  PIN Z
    PORT
      LAYER M1 ;
        RECT 0.3 0.3 0.36 0.36 ;
    END
  END Z
  OBS
    LAYER M2 ;
      RECT 0.1 0.1 0.3 0.3 ;
  END
END CELL
END LIBRARY
"""
DEF = """\
VERSION 5.8 ; # a comment
DESIGN chip ;
UNITS DISTANCE MICRONS 1000 ;
DIEAREA ( 0 0 ) ( 1000 1000 ) ;
TRACKS Y 50 DO 10 STEP 100 LAYER M1 ;
TRACKS X 50 DO 10 STEP 100 LAYER M1 M2 ;
GCELLGRID X 0 DO 3 STEP 400 ;
GCELLGRID Y 0 DO 3 STEP 400 ;
COMPONENTS 1 ;
- u1 CELL + PLACED ( 200 100 ) N ;
END COMPONENTS
PINS 1 ;
- in + NET n1 + DIRECTION INPUT + USE SIGNAL
  + LAYER M2 ( -20 0 ) ( 20 100 ) + PLACED ( 900 0 ) N ;
END PINS
NETS 2 ;
- n1 ( PIN in ) ( u1 A ) + USE SIGNAL ;
- n2 ( u1 Z ) ;
END NETS
END DESIGN
"""
SPECIAL = """\
SPECIALNETS 1 ;
- VDD ( * VDD ) + ROUTED M1 100 + SHAPE STRIPE ( 0 850 ) ( 1000 850 ) ;
END SPECIALNETS
"""
BLOCKED = """\
BLOCKAGES 1 ;
- LAYER M2 RECT ( 800 0 ) ( 1000 1000 ) ;
END BLOCKAGES
"""


def design(folder: Path, text: str = DEF, lef: str = LEF) -> Path:
    """The path of a DEF file, with its LEF file beside it."""
    (folder / "chip.lef").write_text(lef)
    (folder / "chip.def").write_text(text)
    return folder / "chip.def"


def capacities(problem: Problem, layer: int, axis: int) -> list[list[int]]:
    """By row, lowest first, the capacities of a layer's edges from each Gcell."""
    columns, rows, _ = problem.grid
    table = problem.capacity.reshape(*problem.grid, 3)[..., layer, axis]
    return table[: columns - (axis == 0), : rows - (axis == 1)].T.tolist()


def test_what_a_design_says(tmp_path: Path) -> None:
    problem = Problem.read(design(tmp_path))
    # The die cuts the last Gcells short: lines at 0 400 800 1000, middles at 200 600 900.
    assert problem.grid == (3, 3, 2)
    assert (problem.origin, problem.tile) == ((0, 0), (400, 400))
    assert problem.chip is not None
    assert problem.chip.layers == ("M1", "M2")
    assert problem.chip.x.tolist() == problem.chip.y.tolist() == [0, 400, 800, 1000]
    # Wires keep 0.02 + 0.04 from shapes. Pin A, 220-280 by 120-180, blocks track 150 between
    # columns 0 and 1; pin Z, 500-560 by 400-460, blocks 350 and 450 between all.
    assert capacities(problem, 0, 0) == [[2, 3], [3, 3], [2, 2]]
    # The obstruction, 300-500 by 200-400, blocks 250 350 450 550 between rows 0 and 1. Pin in,
    # 880-920 by 0-100, is nowhere near the middle of row 0.
    assert capacities(problem, 1, 1) == [[2, 2, 2], [4, 4, 2]]
    assert capacities(problem, 0, 1) == [[0] * 3] * 2
    assert capacities(problem, 1, 0) == [[0] * 2] * 3
    # Pins stand in the middle of their Gcells.
    assert [net.name for net in problem.nets] == ["n1", "n2"]
    assert problem.nets[0].pins == ((1000, 200, 2), (200, 200, 1))
    assert problem.nets[1].pins == ((600, 600, 1),)


def test_special_nets_and_blockages(tmp_path: Path) -> None:
    text = DEF.replace("NETS 2", f"{SPECIAL}{BLOCKED}NETS 2")
    problem = Problem.read(design(tmp_path, text))
    # The stripe, 800-900 high, blocks 750 850 950 of M1; the blockage 750 850 950 of M2.
    assert capacities(problem, 0, 0) == [[2, 3], [2, 2], [0, 0]]
    assert capacities(problem, 1, 1) == [[2, 1, 0], [4, 3, 0]]


@pytest.mark.parametrize(("array", "left"), [("", [2, 0, 2]), (" DO 2 BY 1 STEP 100 0", [2, 0, 1])])
def test_vias_of_special_nets(tmp_path: Path, array: str, left: list[int]) -> None:
    square = "( -50 -50 ) ( 50 50 )"
    vias = f"VIAS 1 ;\n- v + RECT M1 {square} + RECT V1 {square} + RECT M2 {square} ;\nEND VIAS\n"
    special = SPECIAL.replace("( 0 850 ) ( 1000 850 )", f"( 700 700 ) v{array}")
    special = special.replace("M1 100", "M1 0")
    text = DEF.replace("COMPONENTS 1", f"{vias}COMPONENTS 1").replace("NETS 2", f"{special}NETS 2")
    problem = Problem.read(design(tmp_path, text))
    for routing in ("TYPE Routing", "type routing", "TYPE\nrouting"):  # wires know both layers
        wire = text.replace("( 700 700 ) v", "( 700 300 ) v ( * 700 ) v")
        same = Problem.read(design(tmp_path, wire)).capacity
        again = Problem.read(design(tmp_path, wire, LEF.replace("TYPE ROUTING", routing)))
        assert (again.capacity == same).all()
    # 650-750 wide and high: it blocks 650 and 750 of both layers; the second one, 750-850, 850.
    assert capacities(problem, 0, 0) == [[2, 3], [1, 1], [2, 2]]
    assert capacities(problem, 1, 1)[0] == left


@pytest.mark.parametrize("name", ["a/u1[0]", r"a/u1\[0\]", "u1<3>", r"u\/1"])
def test_names_with_brackets(tmp_path: Path, name: str) -> None:
    plain = Problem.read(design(tmp_path))
    text, lef = DEF.replace("u1", name), LEF
    assert Problem.read(design(tmp_path, text, lef)) == plain
    for old, new in (("u1 A", "u1 A[1]"), ("u1 A", r"u1 A\[1\]")):
        pin = new.removeprefix("u1 ")
        lef = LEF.replace("PIN A", f"PIN {pin}").replace("END A", f"END {pin}")
        assert Problem.read(design(tmp_path, DEF.replace(old, new), lef)) == plain


def test_a_polygon_blocks_what_it_covers(tmp_path: Path) -> None:
    corner = "POLYGON 0.1 0.1 0.3 0.1 0.3 0.12 0.12 0.12 0.12 0.3 0.1 0.3 ;"
    lef = LEF.replace("RECT 0.1 0.1 0.3 0.3 ;", corner)
    problem = Problem.read(design(tmp_path, lef=lef))
    # Its foot, 300-500 by 200-220, blocks as much as before; its stem alone, higher up, 350 only.
    assert capacities(problem, 1, 1) == [[2, 2, 2], [4, 4, 2]]
    shifted = DEF.replace("( 200 100 ) N", "( 200 -100 ) N")
    # Now the foot, 0-20 high and 60 around it, lies below the middle of row 0, and the stem,
    # 300-320 by 20-200, reaches above it: tracks 250 and 350.
    problem = Problem.read(design(tmp_path, shifted.replace("( u1 A )", "( u1 Z )"), lef))
    assert capacities(problem, 1, 1) == [[2, 4, 2], [4, 4, 2]]


@pytest.mark.parametrize(
    ("orient", "place"),
    {
        "N": (50, 50),
        "S": (350, 350),
        "W": (350, 50),
        "E": (50, 350),
        "FN": (350, 50),
        "FS": (50, 350),
        "FW": (50, 50),
        "FE": (350, 350),
    }.items(),
)
def test_orientations(tmp_path: Path, orient: str, place: tuple[int, int]) -> None:
    """The middle of pin A is at 50, 50 of a macro of 400 by 400."""
    problem = Problem.read(
        design(tmp_path, DEF.replace("( 200 100 ) N", f"( 200 100 ) {orient}")), tile=(50, 50)
    )
    x, y = 200 + place[0], 100 + place[1]
    assert problem.chip is not None
    assert problem.chip.places is not None
    first, gcell = problem.chip.places.first, problem.chip.places.gcell
    found = {(g // 2 // 20, g // 2 % 20) for g in gcell[first[1] : first[2]].tolist()}
    # Pin A is 60 wide: it reaches 5 into the Gcells around those of 50.
    assert {(i, j) for i, j in found} == {
        (i, j)
        for i in range((x - 30) // 50, -(-(x + 30) // 50))
        for j in range((y - 30) // 50, -(-(y + 30) // 50))
    }


def test_macros_with_an_origin(tmp_path: Path) -> None:
    """What stands at ORIGIN's opposite in the LEF file is at the place of the component."""

    def moved(match: re.Match[str]) -> str:
        left, low, right, high = (float(number) for number in match.groups())
        return f"RECT {left - 0.1:.3f} {low - 0.2:.3f} {right - 0.1:.3f} {high - 0.2:.3f} ;"

    lef = re.sub(r"RECT (\S+) (\S+) (\S+) (\S+) ;", moved, LEF)
    lef = lef.replace("ORIGIN 0 0", "ORIGIN 0.1 0.2")
    for orient in ("N", "FS", "E"):
        text = DEF.replace("( 200 100 ) N", f"( 200 100 ) {orient}")
        assert Problem.read(design(tmp_path, text, lef)) == Problem.read(design(tmp_path, text))


def test_gcells_by_tile_and_by_tracks(tmp_path: Path) -> None:
    problem = Problem.read(design(tmp_path), tile=(300, 500))
    assert problem.chip is not None
    assert problem.chip.x.tolist() == [0, 300, 600, 1000]  # the last one takes what is left
    assert problem.chip.y.tolist() == [0, 500, 1000]
    text = "\n".join(line for line in DEF.split("\n") if not line.startswith("GCELLGRID"))
    many = text.replace("1000 1000", "3100 4600")
    problem = Problem.read(design(tmp_path, many))
    assert problem.chip is not None
    assert problem.chip.x.tolist() == [0, 1500, 3100]
    assert problem.chip.y.tolist() == [0, 1500, 3000, 4600]
    # Without tracks, by the pitch: the first half a pitch from the border.
    bare = "\n".join(line for line in many.split("\n") if not line.startswith("TRACKS"))
    assert Problem.read(design(tmp_path, bare)).chip.x.tolist() == [0, 1500, 3100]  # type: ignore[union-attr]
    bare = "\n".join(line for line in DEF.split("\n") if not line.startswith("TRACKS"))
    assert Problem.read(design(tmp_path, bare)) == Problem.read(design(tmp_path))


def test_lef_files_elsewhere(tmp_path: Path) -> None:
    whole = Problem.read(design(tmp_path))
    head, macro = LEF.split("MACRO")
    (tmp_path / "tech.lef").write_text(f"{head}END LIBRARY\n")
    (tmp_path / "cells.lef").write_text(f"MACRO{macro}")
    (tmp_path / "chip.lef").unlink()
    lef = [tmp_path / "tech.lef", tmp_path / "cells.lef"]
    assert Problem.read(tmp_path / "chip.def", lef=lef) == whole
    with pytest.raises(InputError, match=r"chip\.def: expected .*chip\.lef beside it"):
        Problem.read(tmp_path / "chip.def")


def test_routes_of_another_grid_are_told(tmp_path: Path) -> None:
    file = design(tmp_path)
    smaller = Problem.read(file, tile=(250, 250))
    sequential_astar(smaller).write(tmp_path / "own.solution")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Solution.read(tmp_path / "own.solution", smaller)
    with pytest.warns(UserWarning, match="100% of the ends of segments are no centers of Gcells"):
        Solution.read(tmp_path / "own.solution", Problem.read(file))


def test_a_guide_by_hand(tmp_path: Path) -> None:
    problem = Problem.read(design(tmp_path))
    n = problem.topology.number
    # Net n1 from pin in, (2, 0) in M2, down to M1, along row 0 to pin A.
    solution = Solution(
        problem,
        [[3 * n(2, 0, 0) + 2, 3 * n(0, 0, 0), 3 * n(1, 0, 0)], []],  # type: ignore[list-item]
    )
    solution.write(tmp_path / "chip.guide")
    assert (tmp_path / "chip.guide").read_text() == (
        "n1\n(\n0 0 1000 400 M1\n0 0 400 400 M2\n800 0 1000 400 M2\n)\n"
        "n2\n(\n400 400 800 800 M1\n400 400 800 800 M2\n)\n"
    )
    assert Solution.read(tmp_path / "chip.guide", problem) == solution


def test_boxes_that_only_touch(tmp_path: Path) -> None:
    """As in the contest's guides: boxes side by side are joined, with capacity if there is some."""
    problem = Problem.read(design(tmp_path))
    file = tmp_path / "chip.guide"
    # M1 in three boxes; M2 has no wires from one column to the next.
    file.write_text(
        "n1\n(\n0 0 400 400 M1\n400 0 800 400 M1\n800 0 1000 400 M1\n0 0 1000 400 M2\n)\n"
    )
    found = Solution.read(file, problem)
    judged = evaluate(problem, found)
    assert (judged.wirelength, judged.vias, judged.overflow) == (3, 1, 0)
    file.write_text("n1\n(\n0 0 400 400 M1\n0 0 400 400 M2\n400 0 1000 400 M2\n)\n")
    judged = evaluate(problem, Solution.read(file, problem))
    assert (judged.wirelength, judged.vias, judged.overflow) == (3, 1, 2)  # against the direction
    assert judged.connected


def test_a_pin_is_reached_where_any_part_of_it_lies(tmp_path: Path) -> None:
    lef = LEF.replace("RECT 0.3 0.3 0.36 0.36", "RECT 0.15 0.3 0.36 0.36")
    text = DEF.replace("( PIN in ) ( u1 A )", "( u1 A ) ( u1 Z )").replace("- n2 ( u1 Z )", "- n2")
    problem = Problem.read(design(tmp_path, text, lef))
    assert [net.name for net in problem.nets] == ["n1"]  # a net without pins is left out
    # Z, 350-560 by 400-460, is mostly in column 1 and also in column 0, above pin A.
    assert problem.nets[0].pins == ((200, 200, 1), (600, 600, 1))
    guide = tmp_path / "chip.guide"
    guide.write_text("n1\n(\n0 0 400 400 M1\n0 400 400 800 M1\n0 0 400 800 M2\n)\n")
    solution = Solution.read(guide, problem)
    assert evaluate(problem, solution).connected
    judged = solution.at_reached_pins()
    assert evaluate(judged.problem, judged).connected
    assert judged.problem.nets[0].pins == ((200, 200, 1), (200, 600, 1))
    assert (judged.uses[1] == solution.uses[1]).all()
    assert judged.at_reached_pins() == judged
    # Both Gcells of Z are in a guide of ours.
    solution.write(guide)
    assert "0 400 400 800 M1" in guide.read_text()
    assert "400 400 800 800 M1" in guide.read_text()


def test_further_ports_of_a_pin_in_older_files(tmp_path: Path) -> None:
    port = "+ LAYER M2 ( -20 0 ) ( 20 100 ) + PLACED"
    text = DEF.replace("PINS 1", "PINS 2").replace(
        "END PINS", f"- in.extra1 + NET n1 {port} ( 500 500 ) N ;\nEND PINS"
    )
    for connections in ("( PIN in )", "( PIN in ) ( PIN in.extra1 )"):
        problem = Problem.read(design(tmp_path, text.replace("( PIN in )", connections)))
        assert len(problem.nets[0].pins) == 2
        assert problem.chip is not None
        assert problem.chip.places is not None
        first, places = problem.chip.places.first, problem.chip.places.gcell
        # The pin's own port is in column 2, row 0, and the other one in column 1, row 1.
        assert set(places[first[0] : first[1]].tolist()) == {2 * 6 + 1, 1 * 6 + 1 * 2 + 1}
    swapped = text.replace("- in.extra1 +", "- x +").replace("- in +", "- in.extra1 +")
    assert Problem.read(design(tmp_path, swapped.replace("- x +", "- in +"))) == problem
    for change, what in (
        (("- in.extra1 + NET n1", "- in.extra1 + NET n2"), "expected the net of in, found n2"),
        (("- in.extra1", "- in"), "pin in: expected a name no earlier pin has"),
    ):
        with pytest.raises(InputError, match=what):
            Problem.read(design(tmp_path, text.replace(*change)))


def test_a_design_with_the_name_of_a_macro(tmp_path: Path) -> None:
    problem = Problem.read(design(tmp_path))
    assert Problem.read(design(tmp_path, DEF.replace("DESIGN chip", "DESIGN CELL"))) == problem


# --- the command line -----------------------------------------------------------------------------


def test_commands_take_designs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    design(tmp_path)
    (tmp_path / "chip.lef").rename(tmp_path / "other.lef")
    given = ["chip.def", "--lef", "other.lef", "--tile", "250", "250"]
    assert status(["convert", *given, "chip.gr"]) == 0
    assert "4x4x2, 2 nets" in capsys.readouterr().out
    problem = Problem.read("chip.def", lef=["other.lef"], tile=(250, 250))
    assert Problem.read("chip.gr") == problem
    assert status(["route", *given, "--router", "pathfinder", "--out", "r.guide", "--json"]) == 0
    routed = json.loads(capsys.readouterr().out)
    assert routed["open_nets"] == []
    assert status(["evaluate", *given, "r.guide", "--json"]) == 0
    judged = json.loads(capsys.readouterr().out)
    keys = ("overflow", "wirelength", "vias", "open_nets")
    assert [judged[key] for key in keys] == [routed[key] for key in keys]
    # Solutions go through convert both ways, to ISPD text, which .gr files have as well.
    assert status(["convert", *given, "r.solution", "--solution", "r.guide"]) == 0
    assert status(["convert", "chip.gr", "r.PR_output", "--solution", "r.solution"]) == 0
    again = ["convert", *given, "again.guide", "--solution", "r.PR_output"]
    assert status(again) == 0
    assert Path("again.guide").read_text() == Path("r.guide").read_text()
    assert status(["evaluate", *given, "r.guide", "--report"]) == 0
    assert "overflow 0 on 0 edges" in capsys.readouterr().out
    assert status(["convert", *given, "x.gr", "--format", "guide"]) == 2
    assert "--format: expected ispd2008" in capsys.readouterr().err
    assert status(["convert", "chip.gr", "x.gr", "--tile", "5", "5"]) == 2
    assert "expected no tile: only .def files take it" in capsys.readouterr().err


def test_without_the_extra_it_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("klayout", "klayout.db"):
        monkeypatch.setitem(sys.modules, name, None)
    file = design(tmp_path)
    assert status(["convert", str(file), str(tmp_path / "chip.gr")]) == 2
    assert capsys.readouterr().err == (
        f"marouting: {file}: designs need more packages: pip install 'marouting[lefdef]'\n"
    )


# --- real designs ---------------------------------------------------------------------------------


@needs_ispd18
def test_the_contests_own_guide_joins_all_its_nets() -> None:
    design = ISPD18 / "ispd18_test1.input.def"
    squares = Problem.read(design)
    assert (squares.grid, squares.tile) == ((68, 67, 9), (5700, 5700))  # 15 tracks of Metal3
    assert squares.layer_capacity[:, :2].max(axis=1).tolist()[:2] == [0, 14]
    problem = Problem.read(design, tile=(6000, 5700), pin_layer_wires=True)
    assert problem.grid == (65, 67, 9)  # as in the guide
    assert problem.chip is not None
    assert (problem.chip.x[-2:].tolist(), problem.chip.y[-2:].tolist()) == (
        [384000, 390800],
        [376200, 383040],
    )
    assert len(problem.nets) == 3153
    guide = Solution.read(ISPD18 / "ispd18_test1.input.guide", problem).at_reached_pins()
    judged = evaluate(guide.problem, guide)
    assert judged.connected
    assert judged.tasks > 10_000
    # Most of its wires are where there are tracks.
    assert 0 < judged.overflow < 0.03 * judged.wirelength


# --- files that cannot be used --------------------------------------------------------------------

BAD_DEF = [
    ("END DESIGN\n", "", 19, "expected 'END DESIGN', found the end of the file"),
    ("END NETS\nEND DESIGN\n", "", 18, "file ends inside NETS, which begins in line 16, after 2"),
    ("- n2 ( u1 Z ) ;", "- n2 ( u1 Z )", 20, "file ends inside a statement, expected ';'"),
    ("NETS 2 ;", "NETS -2 ;", 16, "the number of NETS, a whole number from 0"),
    ("NETS 2 ;", "NETS ;", 16, "'NETS' and their number"),
    ("COMPONENTS 1", "COMPONENTS 9999999999", 9, "a number from"),
    ("- u1 CELL", "- u1 CELLO", 10, "component u1: did you mean CELL? expected a macro"),
    ("+ PLACED ( 200 100 ) N", "+ UNPLACED", 17, "net n1: component u1 is not placed"),
    ("( 200 100 ) N", "( 200 x ) N", 10, "the place of component u1, a number"),
    ("( 200 100 ) N", "( 200 100 ) R90", 10, "'( x y ) orientation' of component u1"),
    ("( 200 100 ) N", "( 20000 100 ) N", 17, "net n1: pin A of u1 lies outside the die"),
    ("( u1 A )", "( u2 A )", 17, "net n1: expected a component, found u2"),
    ("( u1 A )", "( u1 B )", 17, "net n1: expected a pin of u1's macro CELL, found B"),
    ("( u1 A )", "( PIN out )", 17, "net n1: expected a pin of PINS, found out"),
    ("( u1 A )", "( u1", 17, "'( component pin )' of net n1"),
    ("( u1 A ) + USE SIGNAL", "( u1 )", 17, "'( component pin )' of net n1"),
    ("- n2 (", "- n1 (", 18, "net n1: expected a name no earlier net has"),
    ("LAYER M2 ( -20", "LAYER V1 ( -20", 17, "pin in of PIN has no shape in a routing layer"),
    ("+ LAYER M2 ( -20 0 ) ( 20 100 ) ", "", 17, "pin in of PIN has no shape: expected LAYER"),
    ("+ PLACED ( 900 0 ) N", "", 17, "net n1: pin in of PIN is not placed"),
    ("+ LAYER M2 ( -20 0 ) ( 20 100 )", "+ VIA v ( 0 0 )", 14, "pin in: expected a via of"),
    (
        "NETS 2 ;",
        "SPECIALNETS 1 ;\n- VDD + ROUTED M2 100 ( 0 0 ) v9 ;\nEND SPECIALNETS\nNETS 2 ;",
        17,
        "net VDD: expected a via of VIAS or of the LEF files, found v9",
    ),
    (
        "NETS 2 ;",
        "SPECIALNETS 1 ;\n- VDD + ROUTED M2 100 ( 0 0 ) + VIA ;\nEND SPECIALNETS\nNETS 2 ;",
        17,
        "expected 'VIA name' of net VDD, found '+ VIA'",
    ),
    (
        "LAYER M1 ;\nTRACKS X",
        "LAYER M3 ;\nTRACKS X",
        5,
        "layer M3: expected a routing layer of the LEF files",
    ),
    ("DO 10 STEP 100 LAYER M1 ;", "DO 10 STEP -100 LAYER M1 ;", 5, "a step, a whole number"),
    ("DO 10 STEP 100 LAYER M1 ;", "DO -10 STEP 100 LAYER M1 ;", 5, "a count, a whole number"),
    ("DO 10 STEP 100 LAYER M1 ;", "LAYER M1 ;", 5, "'TRACKS X|Y first DO count STEP step'"),
    ("( 1000 1000 )", "( 0 1000 )", 4, "'DIEAREA' and two corners or more"),
    ("( 1000 1000 )", "( 1e30 1000 )", 4, "a corner of the die, a number from"),
    ("MICRONS 1000", "MICRONS 0", 3, "units, a whole number from 1"),
    ("UNITS DISTANCE MICRONS 1000 ;\n", "", 19, "expected UNITS DISTANCE MICRONS before the end"),
    ("DIEAREA ( 0 0 ) ( 1000 1000 ) ;\n", "", 19, "expected a DIEAREA before the end"),
    ("- n1 ( PIN in ) ( u1 A ) + USE SIGNAL ;\n- n2 ( u1 Z ) ;\n", "- n1 ;\n- n2 ;\n", 20, "net"),
    ("VERSION 5.8", "\x00 5.8", 1, "a statement of DEF"),
    ("VERSION 5.8", '"a', 1, "file ends inside a text in quotes, which begins in line 1"),
    ("PINS 1 ;", "BEGINEXT x", 20, "file ends, expected 'ENDEXT' for what begins in line 12"),
]


@pytest.mark.parametrize(("old", "new", "line", "what"), BAD_DEF)
def test_a_spoiled_design(tmp_path: Path, old: str, new: str, line: int, what: str) -> None:
    assert old in DEF
    file = design(tmp_path, DEF.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        Problem.read(file)
    message = str(caught.value)
    assert what in message
    if not message.startswith(f"{file}:{line}: "):
        assert "inside a text in quotes" in what or "statement, expected" in what, message


@pytest.mark.parametrize(
    ("old", "new", "line", "what"),
    [
        ("END LIBRARY\n", "END LIB\n", 50, "'END LIBRARY', found 'END LIB'"),
        ("END CELL\n", "", 50, "'CELL', found 'LIBRARY'"),
        ("END CELL\nEND LIBRARY\n", "", 48, "file ends inside macro CELL, which begins in line 27"),
        ("  WIDTH 0.04 ;\n  SPACING 0.04 ;\n", "", 20, "layer M2: expected a WIDTH"),
        ("WIDTH 0.04 ;\n  SPACING ", "WIDTH -1 ;\n  SPACING ", 24, "the width of layer M2, above"),
        ("PITCH 0.1 0.1", "PITCH 0", 23, "the pitch of layer M2, above 0"),
        ("PITCH 0.1 0.1", "PITCH x", 23, "the pitch of layer M2, a number"),
        ("SIZE 0.4 BY 0.4", "SIZE -0.4 BY 0.4", 31, "the size of macro CELL, above 0"),
        ("  DIRECTION VERTICAL ;\n", "", 20, "layer M2: expected DIRECTION HORIZONTAL or"),
        ("LAYER M2\n", "LAYER M1\n", 26, "'M1', found 'M2'"),
        ("END M2", "END M3", 26, "'M2', found 'M3'"),
    ],
)
def test_a_spoiled_library(tmp_path: Path, old: str, new: str, line: int, what: str) -> None:
    assert old in LEF
    file = design(tmp_path, lef=LEF.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        Problem.read(file)
    message = str(caught.value)
    assert what in message
    assert message.startswith(f"{file.with_suffix('.lef')}:")
    assert abs(int(message.removeprefix(f"{file.with_suffix('.lef')}:").split(":")[0]) - line) <= 1


def test_a_design_cut_anywhere(tmp_path: Path) -> None:
    lines = DEF.splitlines(keepends=True)
    for keep in range(len(lines)):
        file = design(tmp_path, "".join(lines[:keep]))
        with pytest.raises(InputError) as caught:
            Problem.read(file)
        assert str(caught.value).startswith(f"{file}:{max(1, keep)}: ")


def test_a_library_cut_anywhere(tmp_path: Path) -> None:
    """Only END LIBRARY may be missing; what is missing of the rest, the design asks for."""
    lines = LEF.splitlines(keepends=True)
    for keep in range(len(lines) - 1):
        file = design(tmp_path, lef="".join(lines[:keep]))
        with pytest.raises(InputError) as caught:
            Problem.read(file)
        message = str(caught.value)
        assert re.match(
            rf".*chip\.lef:{keep}: |.*chip\.lef: expected at least one routing layer|"
            r".*chip\.lef:[0-9]+: layer M[12]: expected|"
            r".*chip\.def:[0-9]+: (layer M2: expected a routing layer|component u1)",
            message,
        ), message
    design(tmp_path, lef="".join(lines[:-1]))
    assert Problem.read(tmp_path / "chip.def").grid == (3, 3, 2)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("DO 3 STEP 400", "DO 999999999 STEP 1", ""),  # a thousand of them are on the die
        ("( 1000 1000 )", "( 999999999 999999999 )", ""),
        ("DO 10 STEP 100 LAYER M1 ;", "DO 999999999 STEP 1 LAYER M1 ;", ""),
        (
            "( 1000 1000 ) ;\nTRACKS Y 50 DO 10 STEP 100",
            "( 9999999 9999999 ) ;\nTRACKS Y 50 DO 999999999 STEP 1",
            ":5: expected at most 1048576 tracks or lines on the die, found 9999949",
        ),
        (
            "NETS 2 ;",
            "VIAS 1 ;\n- v + VIARULE r + ROWCOL 99999 99999 ;\nEND VIAS\nNETS 2 ;",
            ":17: expected at most 1000000 in an array",
        ),
        (
            "NETS 2 ;",
            "SPECIALNETS 1 ;\n- v + ROUTED M1 0 ( 0 0 ) v1 DO 9999 BY 9999 STEP 1 1 ;\n"
            "END SPECIALNETS\nNETS 2 ;",
            ":17: expected at most 1000000 in an array",
        ),
    ],
)
def test_a_promise_costs_little(tmp_path: Path, old: str, new: str, what: str) -> None:
    assert old in DEF
    Problem.read(design(tmp_path))
    file = design(tmp_path, DEF.replace(old, new, 1))
    start = time.perf_counter()
    tracemalloc.start()
    try:
        if what:
            with pytest.raises(InputError, match=what):
                Problem.read(file)
        else:
            Problem.read(file)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 5e7
    assert time.perf_counter() - start < 10


def test_what_klayout_refuses_is_one_line(tmp_path: Path) -> None:
    file = design(tmp_path, DEF.replace("+ LAYER M2 ( -20 0 )", "+ LAYER M2 ( -20 )"))
    with pytest.raises(InputError) as caught:
        Problem.read(file)
    assert str(caught.value).startswith(f"{file}:13: klayout: ")
    assert "\n" not in str(caught.value)
    file = design(tmp_path, lef=LEF.replace("RECT 0.02 0.02", "RECT x 0.02"))
    with pytest.raises(InputError) as caught:
        Problem.read(file)
    assert str(caught.value).startswith(f"{file.with_suffix('.lef')}:36: klayout: ")


# --- nondefault rules, clocks, pin layers, square Gcells ------------------------------------------

RULES = {
    "lef": """\
NONDEFAULTRULE wide
  LAYER M1
    WIDTH 0.08 ;
    SPACING 0.12 ;
    WIREEXTENSION 0.1 ;
  END M1
  VIA v1 DEFAULT
    LAYER M1 ; RECT -0.1 -0.1 0.1 0.1 ;
  END v1
  SPACING
    LAYER M1 CUT 0.1 ;
  END SPACING
  USEVIA v2 ;
END wide
""",
    "def": """\
NONDEFAULTRULES 1 ;
- wide + HARDSPACING + LAYER M1 WIDTH 80 SPACING 120 WIREEXT 100 + VIA v1 ;
END NONDEFAULTRULES
""",
}


@pytest.mark.parametrize("place", RULES)
def test_nets_with_a_nondefault_rule_take_more_tracks(tmp_path: Path, place: str) -> None:
    lef = LEF.replace("END LIBRARY", RULES["lef"] + "END LIBRARY") if place == "lef" else LEF
    text = DEF.replace("NETS 2", f"{RULES['def']}NETS 2") if place == "def" else DEF
    text = text.replace("( u1 A ) + USE", "( u1 A ) + NONDEFAULTRULE wide + USE")
    problem = Problem.read(design(tmp_path, text, lef))
    # 80 wide and 120 apart, where tracks are 100 apart; M2 is as usual.
    assert [net.min_width for net in problem.nets] == [(2, 1), 1]
    assert problem.net_demand.tolist() == [[2, 1], [1, 1]]
    wide = text.replace("wide + USE", "wider + USE")
    with pytest.raises(InputError, match=r"chip.def:[0-9]+: net n1: did you mean wide"):
        Problem.read(design(tmp_path, wide, lef))


def test_tracks_in_several_statements_are_as_far_apart_as_they_lie(tmp_path: Path) -> None:
    """As OpenROAD writes the layers of asap7: each statement has every second track, or fewer."""
    ruled = DEF.replace("NETS 2", f"{RULES['def']}NETS 2")
    ruled = ruled.replace("( u1 A ) + USE", "( u1 A ) + NONDEFAULTRULE wide + USE")
    both = "TRACKS Y 50 DO 5 STEP 200 LAYER M1 ;\nTRACKS Y 150 DO 5 STEP 200 LAYER M1 ;"
    parted = ruled.replace("TRACKS Y 50 DO 10 STEP 100 LAYER M1 ;", both)
    assert Problem.read(design(tmp_path, parted)) == Problem.read(design(tmp_path, ruled))
    # Gcells without a GCELLGRID: 15 tracks of M2, also with a track beside the others.
    bare = "\n".join(line for line in ruled.split("\n") if not line.startswith("GCELLGRID"))
    more = bare.replace("TRACKS X", "TRACKS X 999 DO 1 STEP 0 LAYER M2 ;\nTRACKS X")
    big = "( 0 0 ) ( 4000 4000 )"
    grids = [
        Problem.read(design(tmp_path, text.replace("( 0 0 ) ( 1000 1000 )", big))).grid
        for text in (bare, more)
    ]
    assert grids[0] == grids[1] == (2, 2, 2)


def test_tracks_by_a_pitch_with_any_offset(tmp_path: Path) -> None:
    bare = "\n".join(line for line in DEF.split("\n") if not line.startswith("TRACKS"))
    read = [
        Problem.read(design(tmp_path, bare, LEF.replace("PITCH 0.1 ;", f"PITCH 0.1 ;\n{offset}")))
        for offset in ("  OFFSET 0.05 ;", "  OFFSET -0.95 ;", "  OFFSET 0.35 ;")
    ]
    assert read[0] == read[1] == read[2]


@pytest.mark.parametrize("place", RULES)
def test_nondefault_rules_with_unknown_layers_or_negative_sizes(tmp_path: Path, place: str) -> None:
    unknown = RULES[place].replace("LAYER M1", "LAYER M9", 1).replace("END M1", "END M9", 1)
    negative = RULES[place].replace("WIDTH ", "WIDTH -", 1)
    for rules, error in (
        (unknown, "layer M9: .*expected a routing layer of the LEF files"),
        (negative, "expected a size of layer M1 in rule wide, .*found '-"),
    ):
        lef, text = LEF, DEF
        if place == "lef":
            lef = lef.replace("END LIBRARY", f"{rules}END LIBRARY")
        else:
            text = text.replace("NETS 2", f"{rules}NETS 2")
        with pytest.raises(InputError, match=rf"chip.{place}:[0-9]+: {error}"):
            Problem.read(design(tmp_path, text, lef))


def test_clock_nets_of_a_design(tmp_path: Path) -> None:
    problem = Problem.read(design(tmp_path, DEF.replace("USE SIGNAL ;", "USE CLOCK ;")))
    assert problem.chip is not None
    assert problem.chip.clock is not None
    assert problem.chip.clock.tolist() == [True, False]
    ranged = adjusted(problem, Controls(clock_layers="1..2", layers="1..2"))
    assert ranged.nets == problem.nets
    without = Problem.read(design(tmp_path)).chip
    assert without is not None
    assert without.clock is None


THIRD = """\
LAYER M3
  TYPE ROUTING ;
  DIRECTION HORIZONTAL ;
  PITCH 0.05 ;
  WIDTH 0.02 ;
END M3
"""


def test_the_layer_of_pins_has_no_wires_where_others_do(tmp_path: Path) -> None:
    lef = LEF.replace("MACRO", f"{THIRD}MACRO", 1)
    file = design(tmp_path, DEF, lef)
    assert Problem.read(file).horizontal_capacity[0] == 0
    assert Problem.read(file).horizontal_capacity[2] > 0
    asked = Problem.read(file, pin_layer_wires=True)
    ranged = ProblemFile(path=str(file), layers="1..3").read()
    assert ranged.capacity.tolist() == asked.capacity.tolist()
    assert capacities(asked, 0, 0) == capacities(Problem.read(design(tmp_path)), 0, 0)
    # The lowest layer has wires if it holds fewer pins, or no other has wires along its axis.
    upper = lef.replace("LAYER M1 ;\n        RECT", "LAYER M2 ;\n        RECT")
    assert upper != lef
    assert Problem.read(design(tmp_path, DEF, upper)).capacity[::3].reshape(3, 3, 3)[..., 0].any()


def test_gcells_without_a_grid_are_squares(tmp_path: Path) -> None:
    text = "\n".join(line for line in DEF.split("\n") if not line.startswith("GCELLGRID"))
    text = text.replace("( 1000 1000 )", "( 3000 2000 )")
    lef = LEF.replace("MACRO", f"{THIRD}MACRO", 1)
    problem = Problem.read(design(tmp_path, text, lef))
    assert (problem.tile, problem.grid) == ((750, 750), (4, 2, 3))  # 15 tracks of M3
    assert problem.chip is not None
    assert problem.chip.y.tolist() == [0, 750, 2000]
