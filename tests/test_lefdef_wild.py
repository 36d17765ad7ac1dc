"""LEF/DEF as tools and people write it: what other readers take is read, or the reason is named."""

import tempfile
import warnings
from pathlib import Path

import pytest
from test_lefdef import BLOCKED, DEF, LEF, capacities, design

from marouting import InputError, Problem
from policies.cli.main import status

pytest.importorskip("klayout.db")

VIA = (
    "VIA v DEFAULT LAYER M1 ; RECT -0.05 -0.05 0.05 0.05 ; LAYER V1 ; RECT -0.01 -0.01 0.01 0.01 ; "
)
VIA += "LAYER M2 ; RECT -0.05 -0.05 0.05 0.05 ; END v\n"


def swapped(text: str, *pairs: tuple[str, str]) -> str:
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    return text


SAME = {
    "no END LIBRARY": (DEF, LEF.replace("END LIBRARY\n", "")),
    "joined LEF files": (DEF, LEF.replace("MACRO CELL", "END LIBRARY\nVERSION 5.8 ;\nMACRO CELL")),
    "mixed case": (DEF, swapped(LEF, ("LAYER M1\n", "Layer M1\n"), ("PORT", "Port"))),
    "a via in mixed case": (DEF, LEF.replace("MACRO", VIA.replace("VIA", "Via") + "MACRO")),
    "small letters": (
        swapped(DEF, ("COMPONENTS", "components"), ("PLACED", "placed"), ("NETS", "nets")),
        swapped(LEF, ("ROUTING", "routing"), ("HORIZONTAL", "horizontal"), ("WIDTH", "width")),
    ),
    "glued": (
        swapped(DEF, (" ;", ";"), ("( ", "("), (" )", ")"), (") (", ")(")),
        LEF.replace(" ;", ";"),
    ),
    "a layer again": (DEF, LEF.replace("MACRO", "LAYER M1\n  TYPE ROUTING ;\nEND M1\nMACRO")),
    "a macro again": (DEF, LEF.replace("END LIBRARY", LEF[LEF.index("MACRO") :])),
    "SPACINGTABLE INFLUENCE": (
        DEF,
        LEF.replace(
            "  SPACING 0.04 ;",
            "  SPACING 0.04 ;\n  SPACINGTABLE INFLUENCE WIDTH 0.1 WITHIN 0.2 SPACING 0.3 ;",
        ),
    ),
    "SPACINGTABLE TWOWIDTHS": (
        DEF,
        LEF.replace(
            "  SPACING 0.04 ;",
            "  SPACINGTABLE TWOWIDTHS WIDTH 0 PRL 0 0.04 0.08 WIDTH 0.2 PRL 0.1 0.2 0.3 ;",
        ),
    ),
    "MUSTJOIN": (
        swapped(
            DEF,
            ("NETS 2", "NETS 4"),
            ("END NETS", "- MUSTJOIN ( u1 A ) ( u1 Z ) ;\n- MUSTJOIN ( u1 Z ) ;\nEND NETS"),
        ),
        LEF,
    ),
    "one pin without a place": (
        swapped(
            DEF,
            ("PINS 1 ;\n", "PINS 2 ;\n- q + NET k ;\n"),
            ("END NETS", "- k ( PIN q ) ;\nEND NETS"),
            ("NETS 2", "NETS 3"),
        ),
        LEF,
    ),
    "FILLS": (DEF.replace("NETS 2", BLOCKED.replace("RECT", "+ FILLS RECT") + "NETS 2"), LEF),
    "SLOTS": (DEF.replace("NETS 2", BLOCKED.replace("RECT", "+ SLOTS RECT") + "NETS 2"), LEF),
    "tracks of a cut layer": (DEF.replace("LAYER M1 M2", "LAYER M1 M2 V1"), LEF),
    "a comment without a blank": (
        DEF.replace("DESIGN chip ;", "DESIGN chip ;# a chip"),
        LEF.replace("WIDTH 0.04 ;\n  SPACING", "WIDTH 0.04 ;# of \"wires\" ;\n  SPACING"),
    ),
    "tables of currents": (
        DEF,
        LEF.replace(
            "END M2",
            "ACCURRENTDENSITY RMS FREQUENCY 1E6 4E8 ; WIDTH 0.4 0.8 ; TABLEENTRIES 2E-6 1 1 1 ;\n"
            "DCCURRENTDENSITY AVERAGE WIDTH 2 5 ; TABLEENTRIES 1 2 ;\n"
            "ACCURRENTDENSITY PEAK 5.5 ;\nEND M2",
        ),
    ),
    "tracks without a layer": (
        swapped(DEF, ("STEP 100 LAYER M1 ;\nTRACKS X", "STEP 100 ;\nTRACKS X")),
        LEF,
    ),
    "NOISETABLE": (DEF, LEF.replace("MACRO", "NOISETABLE 1 ; X 2 ;\nEND NOISETABLE\nMACRO")),
    "byte order marks in the middle": (DEF, LEF.replace("MACRO", "\ufeffVERSION 5.8 ;\nMACRO")),
    "a pin of the chip in small letters": (
        swapped(DEF, ("( PIN in ) ( u1 A ) + USE", "(pin in)(u1 A)+USE")),
        LEF,
    ),
    "a die of six corners, in a line": (
        DEF.replace("( 0 0 ) ( 1000", "( 0 0 ) ( 0 500 ) ( 0 1000 ) ( 1000 1000 ) ( 1000 0 ) ; #"),
        LEF,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", SAME)
def test_read_as_if_it_were_written_plainly(tmp_path: Path, case: str) -> None:
    plain = Problem.read(design(tmp_path))
    text, lef = SAME[case]
    assert (text, lef) != (DEF, LEF)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert Problem.read(design(tmp_path, text, lef)) == plain


def test_a_pin_named_as_its_macro(tmp_path: Path) -> None:
    plain = Problem.read(design(tmp_path))
    lef = swapped(LEF, ("PIN A", "PIN CELL"), ("END A", "END CELL"))
    assert Problem.read(design(tmp_path, DEF.replace("( u1 A )", "( u1 CELL )"), lef)) == plain


def test_comments_of_any_bytes(tmp_path: Path) -> None:
    plain = Problem.read(design(tmp_path))
    for file in (tmp_path / "chip.def", tmp_path / "chip.lef"):
        file.write_bytes(b"# pitch in \xb5m \xa9\n" + file.read_bytes())
    assert Problem.read(tmp_path / "chip.def") == plain
    file = design(tmp_path)
    file.write_bytes(file.read_bytes().replace(b"- n1 ", b"- n\xb5 "))
    with pytest.raises(InputError, match=r"chip\.def:17: net .*expected a name of printable"):
        Problem.read(file)
    for name, word in (("chip.def", b"DESIGN chip"), ("chip.lef", b"CLASS CORE")):
        design(tmp_path)
        file = tmp_path / name
        file.write_bytes(file.read_bytes().replace(word, word + b"\xb5"))
        with pytest.raises(InputError, match=rf"{name}:[0-9]+: expected UTF-8 text outside of"):
            Problem.read(tmp_path / "chip.def")


def test_power_stays_where_it_has_vias(tmp_path: Path) -> None:
    """Kinds of shapes in one layer: wires and vias, pins of cells and of the chip."""
    wire = "- VDD + ROUTED M1 100 ( 0 850 ) ( 1000 850 )"
    lef = LEF.replace("MACRO", VIA + "MACRO")
    for via in ("", " NEW M1 0 ( 500 850 ) v"):
        special = f"SPECIALNETS 1 ;\n{wire}{via} ;\nEND SPECIALNETS\nNETS 2"
        problem = Problem.read(design(tmp_path, DEF.replace("NETS 2", special), lef))
        assert capacities(problem, 0, 0) == [[2, 3], [2, 2], [0, 0]]


@pytest.mark.parametrize(
    ("wires", "what"),
    [
        ("+ ROUTED M1 100 ( 0 850 ) ( 1000 * ) v ( * 900 ) + USE POWER", ""),
        ("+ ROUTED M1 100 + SHAPE STRIPE ( 0 850 9 ) MASK 1 ( 9 850 ) v FS DO 2 BY 1 STEP 9 0", ""),
        (
            "+ FIXED M1 100 ( 0 850 ) VIRTUAL ( 9 850 ) RECT ( 0 -50 99 50 ) NEW M2 0 ( 5 5 ) v N",
            "",
        ),
        ("+ RECT M1 ( 0 800 ) ( 99 900 ) + VIA v ( 0 0 ) + USE POWER", ""),
        (
            "+ ROUTED M1 100 ( 0 850 ) ( 1000 * ) v9",
            "net VDD: .*expected a via of VIAS or of the LEF",
        ),
        ("+ ROUTED M1 100 ( 0 850 ) NEW M2 0 ( 5 5 ) v N NEW M2 0 ( 5 5 ) v9", "found v9"),
        ("+ VIA v9 ( 0 0 )", "found v9"),
    ],
)
def test_vias_of_special_nets_are_defined_somewhere(tmp_path: Path, wires: str, what: str) -> None:
    special = f"SPECIALNETS 1 ;\n- VDD ( * VDD ) {wires} ;\nEND SPECIALNETS\nNETS 2"
    file = design(tmp_path, DEF.replace("NETS 2", special), LEF.replace("MACRO", f"{VIA}MACRO"))
    if what:
        with pytest.raises(InputError, match=what):
            Problem.read(file)
    else:
        assert Problem.read(file).nets


def test_a_pin_of_the_chip_in_a_layer_of_cells_pins(tmp_path: Path) -> None:
    text = swapped(DEF, ("LAYER M2 ( -20 0 ) ( 20 100 )", "LAYER M1 ( -20 0 ) ( 20 100 )"))
    problem = Problem.read(design(tmp_path, text))
    assert problem.nets[0].pins == ((1000, 200, 1), (200, 200, 1))


def test_a_pin_that_is_a_via(tmp_path: Path) -> None:
    text = swapped(
        DEF,
        (
            "LAYER M2 ( -20 0 ) ( 20 100 ) + PLACED ( 900 0 ) N",
            "VIA v ( 30 10 ) + FIXED ( 900 50 ) W",
        ),
    )
    problem = Problem.read(design(tmp_path, text, LEF.replace("MACRO", VIA + "MACRO")))
    assert problem.nets[0].pins[0] == (1000, 200, 1)  # 840-940 by 30-130, in both layers alike
    assert capacities(problem, 0, 0)[0] == [2, 1]  # it blocks 50 and 150 of M1


@pytest.mark.parametrize(
    ("rects", "vias"),
    [
        ("RECT -0.03 -0.01 0.07 0.09", "VIA 0.02 0.04 v"),
        (
            "RECT 0.05 0.15 0.15 0.25 ; RECT 0.15 0.15 0.25 0.25",
            "VIA ITERATE 0.1 0.2 v DO 2 BY 1 STEP 0.1 0",
        ),
    ],
)
def test_vias_of_macros_are_shapes_like_others(tmp_path: Path, rects: str, vias: str) -> None:
    """In obstructions and in pins, beside rectangles or alone; undefined ones are refused."""
    defined = LEF.replace("MACRO", VIA + "MACRO")
    shapes = "".join(f"LAYER {layer} ; {rects} ; " for layer in ("M1", "M2"))
    for old in ("    LAYER M2 ;\n      RECT 0.1", "      LAYER M1 ;\n        RECT 0.3"):
        by_rect, by_via = (defined.replace(old, f"{s}{old}") for s in (shapes, f"{vias} ;\n"))
        expected = Problem.read(design(tmp_path, DEF, by_rect))
        assert expected != Problem.read(design(tmp_path, DEF, defined))
        found = Problem.read(design(tmp_path, DEF, by_via))
        assert (found.nets, found.adjustments) == (expected.nets, expected.adjustments)
    port = "      LAYER M1 ;\n        RECT 0.3 0.3 0.36 0.36 ;\n"
    alone = [swapped(defined, (port, text)) for text in (shapes, f"{vias} ;\n")]
    one, other = (Problem.read(design(tmp_path, DEF, lef)) for lef in alone)
    assert one == other
    with pytest.raises(
        InputError, match=r"chip\.lef:[0-9]+: macro CELL: expected a via of the LEF"
    ):
        Problem.read(design(tmp_path, DEF, alone[1].replace(VIA, "")))


def test_names_are_given_once_and_nothing_follows(tmp_path: Path) -> None:
    again = "END PINS", "- in + NET n1 + LAYER M1 ( 0 0 ) ( 9 9 ) + PLACED ( 0 0 ) N ;\nEND PINS"
    with pytest.raises(
        InputError, match=r"chip\.def:15: pin in: expected a name no earlier pin has"
    ):
        Problem.read(design(tmp_path, swapped(DEF, again)))
    file = design(tmp_path, f"{DEF}NETS 1 ;\n")
    with pytest.warns(UserWarning, match=r"chip\.def:21: text after END DESIGN is ignored"):
        Problem.read(file)


def test_pins_in_what_a_die_lacks_are_refused(tmp_path: Path) -> None:
    corner = "( 0 0 ) ( 0 1000 ) ( 1000 1000 ) ( 1000 400 ) ( 600 400 ) ( 600 0 )"
    text = swapped(DEF, ("( 0 0 ) ( 1000 1000 )", corner))
    with pytest.raises(InputError, match="net n1: pin in of PIN lies outside the die"):
        Problem.read(design(tmp_path, text))


def test_a_die_that_is_no_rectangle(tmp_path: Path) -> None:
    corner = "( 0 0 ) ( 0 1000 ) ( 1000 1000 ) ( 1000 400 ) ( 600 400 ) ( 600 0 )"
    text = swapped(DEF, ("( 0 0 ) ( 1000 1000 )", corner), ("( 900 0 )", "( 900 800 )"))
    problem = Problem.read(design(tmp_path, text))
    # What is missing, 600-1000 by 0-400, holds the middle of Gcell (2, 0) and half of (1, 0).
    assert capacities(problem, 0, 0) == [[2, 0], [3, 3], [2, 2]]
    assert capacities(problem, 1, 1) == [[2, 0, 0], [4, 4, 0]]  # pin in as well
    with pytest.raises(InputError, match=r"chip\.def:4: DIEAREA: expected sides along x or y only"):
        Problem.read(design(tmp_path, DEF.replace("( 0 0 ) (", "( 0 0 ) ( 0 500 ) ( 500 700 ) (")))


@pytest.mark.parametrize(
    ("notch", "at", "gcell"),
    [
        # The pin, 40 wide and 100 high, lies half in what the die lacks.
        ("( 0 0 ) ( 0 1000 ) ( 1000 1000 ) ( 1000 400 ) ( 400 400 ) ( 400 0 )", "( 400 200 )", 0),
        ("( 400 0 ) ( 400 400 ) ( 0 400 ) ( 0 1000 ) ( 1000 1000 ) ( 1000 0 )", "( 400 200 )", 1),
        # Only 2 of its 40 are on the die, in another Gcell than the rest.
        ("( 418 0 ) ( 418 400 ) ( 0 400 ) ( 0 1000 ) ( 1000 1000 ) ( 1000 0 )", "( 400 200 )", 1),
    ],
)
def test_a_pin_is_where_the_die_is(tmp_path: Path, notch: str, at: str, gcell: int) -> None:
    swaps = ("( 0 0 ) ( 1000 1000 )", notch), ("( 900 0 )", at), ("( 200 100 )", "( 500 500 )")
    problem = Problem.read(design(tmp_path, swapped(DEF, *swaps)))
    assert problem.nets[0].pins[0] == (200 + 400 * gcell, 200, 2)
    # Beyond the box around the die, beside what the die lacks.
    outside = swaps[0], ("( 900 0 )", "( 0 -90 )" if gcell else "( 1000 0 )"), swaps[2]
    with pytest.raises(InputError, match="pin in of PIN lies outside the die"):
        Problem.read(design(tmp_path, swapped(DEF, *outside)))


def test_no_net_is_left(tmp_path: Path) -> None:
    nets = DEF[DEF.index("NETS 2") :]
    for left in ("- n2 ( u2 Z )", "- n2"):
        text = DEF.replace(nets, f"NETS 1 ;\n{left} ;\nEND NETS\nEND DESIGN\n")
        text = swapped(
            text,
            ("COMPONENTS 1", "COMPONENTS 2"),
            ("( 200 100 ) N ;", "( 200 100 ) N ;\n- u2 CELL ;"),
        )
        with pytest.raises(InputError, match=r"chip\.def.*: expected at least one net with a pin"):
            Problem.read(design(tmp_path, text))


@pytest.mark.parametrize("section", ["COMPONENTS", "PINS", "NETS"])
def test_a_count_that_is_wrong(tmp_path: Path, section: str) -> None:
    plain = Problem.read(design(tmp_path))
    found = 2 if section == "NETS" else 1
    file = design(tmp_path, DEF.replace(f"{section} {found}", f"{section} 9"))
    with pytest.warns(UserWarning, match=f"{section}: expected 9, as line .* says, found {found}"):
        assert Problem.read(file) == plain


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("NEW M1", "NEW M9", "layer M9 of a special net, in .*: expected a layer of the LEF files"),
        ("+ LAYER M2", "+ LAYER M9", "layer M9 of a pin, in .*: expected a layer of the LEF files"),
        (
            "- LAYER M2 RECT",
            "- LAYER M9 RECT",
            "layer M9 of a blockage, in .*: expected a layer of",
        ),
        ("RECT M2", "RECT M9", "layer M9 of a via, in .*: expected a layer of the LEF files"),
    ],
)
def test_a_layer_that_nobody_defines_is_refused(
    tmp_path: Path, old: str, new: str, what: str
) -> None:
    square = "( -50 -50 ) ( 50 50 )"
    parts = (
        f"VIAS 1 ;\n- w + RECT M1 {square} + RECT M2 {square} ;\nEND VIAS\n{BLOCKED}"
        "SPECIALNETS 1 ;\n- VDD + ROUTED M1 100 ( 0 850 ) ( 900 850 ) w\n"
        "NEW M1 100 ( 0 0 ) ( 9 0 ) ;\nEND SPECIALNETS\n"
    )
    text = DEF.replace("COMPONENTS 1", f"{parts}COMPONENTS 1")
    Problem.read(design(tmp_path, text))
    with pytest.raises(InputError, match=what):
        Problem.read(design(tmp_path, swapped(text, (old, new))))


def test_a_macro_in_a_layer_that_nobody_defines_is_refused(tmp_path: Path) -> None:
    lef = LEF.replace("  OBS\n    LAYER M2", "  OBS\n    LAYER M9")
    with pytest.raises(
        InputError,
        match=r"chip.lef:[0-9]+: layer M9 of a macro's obstruction, in CELL: expected a layer of",
    ):
        Problem.read(design(tmp_path, lef=lef))


def test_names_of_files_are_taken_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Relative ones from the working folder, not the DEF's; and none is a formula."""
    plain = Problem.read(design(tmp_path))
    folder = tmp_path / "$HOME $(1+1)" / "designs"
    folder.mkdir(parents=True)
    design(folder)
    monkeypatch.chdir(folder.parent)
    monkeypatch.setattr(tempfile, "tempdir", str(folder.parent))
    (folder / "below").mkdir()
    for path, lef in (
        ("designs/chip.def", []),
        ("designs/chip.def", ["designs/chip.lef"]),
        ("designs/below/../chip.def", []),
        ("../$HOME $(1+1)/designs/chip.def", []),
    ):
        assert Problem.read(path, lef=lef) == plain
    assert status(["route", "designs/chip.def", "--router", "astar"]) == 0
    assert "connected  True" in capsys.readouterr().out


@pytest.mark.parametrize("digits", ["1_0", "\u0661", "\uff11", "0x1", "nan", "inf", "1e"])
def test_numbers_are_those_of_the_format(tmp_path: Path, digits: str) -> None:
    for text, lef in (
        (DEF.replace("STEP 100 LAYER M1 ;", f"STEP {digits} LAYER M1 ;"), LEF),
        (DEF, LEF.replace("PITCH 0.1 ;", f"PITCH {digits} ;")),
    ):
        with pytest.raises(InputError, match="a number"):
            Problem.read(design(tmp_path, text, lef))
