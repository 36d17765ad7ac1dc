"""The two formats of the ISPD'98 benchmarks: told by the header, written back, refused by line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from numpy.typing import NDArray
from strategies import problems
from test_bad_files import refused

from marouting import Adjustment, InputError, Net, Pin, Problem, evaluate, sequential_astar
from marouting.problem.grid import AXES, VIA_AXIS
from marouting.problem.ispd import FORMATS, Format

IBM01 = Path(__file__).resolve().parents[2] / "shared" / "data" / "ispd98" / "ibm01.modified.txt"
needs_ibm01 = pytest.mark.skipif(not IBM01.exists(), reason="needs ibm01 in ../shared/data")

# As the published files are set: doubled spaces, trailing ones, indented pins, a blank last line.
LAYERED = """\
grid 4 3 2
vertical capacity  0 4
horizontal capacity 6 0
minimum width 1 1\x20
minimum width 1 1\x20
via spacing   1 1\x20
0 0 1 1

num net 3
net10130 0 3
  0 2
  3 0
  3 0
local 7 2
  1 1
  1 1
net5 2 1
  3 2

"""
FLAT = """\
grid 4 3
vertical capacity 2
horizontal capacity 3

num net 3
net10130 0 3
  0 2
  3 0
  3 0
local 7 2
  1 1
  1 1
net5 2 1
  3 2

"""
NETS = (
    Net("net10130", 0, (Pin(0, 2, 1), Pin(3, 0, 1), Pin(3, 0, 1))),
    Net("local", 7, (Pin(1, 1, 1), Pin(1, 1, 1))),
    Net("net5", 2, (Pin(3, 2, 1),)),
)
TWO_LAYERS = Problem(
    grid=(4, 3, 2),
    vertical_capacity=(0, 4),
    horizontal_capacity=(6, 0),
    nets=NETS,
    min_width=(1, 1),
    min_spacing=(1, 1),
    via_spacing=(1, 1),
)
ONE_LAYER = Problem(
    grid=(4, 3, 1),
    vertical_capacity=(2,),
    horizontal_capacity=(3,),
    nets=NETS,
    min_width=(1,),
    min_spacing=(0,),
    via_spacing=(0,),
)
TEXTS: dict[Format, tuple[str, Problem]] = {
    "ispd98": (LAYERED, TWO_LAYERS),
    "ispd98-flat": (FLAT, ONE_LAYER),
}


def problem_of(tmp_path: Path, text: str) -> Problem:
    file = tmp_path / "problem.txt"
    file.write_text(text)
    return Problem.read(file)


def said(problem: Problem, format: Format) -> Problem:
    """What is left of a problem in a format: the problem itself where the format holds it."""
    if format == "ispd2008":
        return problem
    nets = tuple(
        replace(net, min_width=1, pins=tuple(pin._replace(layer=1) for pin in net.pins))
        for net in problem.nets
    )
    problem = replace(problem, nets=nets, adjustments=())
    if format == "ispd98":
        return problem
    (x, y), (width, height) = problem.origin, problem.tile
    nets = tuple(
        replace(
            net,
            pins=tuple(Pin((pin.x - x) // width, (pin.y - y) // height, 1) for pin in net.pins),
        )
        for net in nets
    )
    return Problem(
        grid=(*problem.grid[:2], 1),
        vertical_capacity=problem.vertical_capacity[:1],
        horizontal_capacity=problem.horizontal_capacity[:1],
        nets=nets,
        min_width=(1,),
        min_spacing=(0,),
        via_spacing=(0,),
    )


def tracks(problem: Problem) -> NDArray[np.int32]:
    """(X, Y, 2) how many nets have room on the edges along x and y, all layers together."""
    capacity = problem.capacity.reshape(*problem.grid, AXES)[..., :VIA_AXIS]
    return (capacity // problem.net_demand[0, 0]).sum(axis=2)


# --- reading and writing --------------------------------------------------------------------------


@pytest.mark.parametrize(("text", "problem"), TEXTS.values(), ids=TEXTS)
def test_the_header_tells_the_format(tmp_path: Path, text: str, problem: Problem) -> None:
    assert problem_of(tmp_path, text) == problem
    # Case, tabs and blank lines say nothing.
    loud = text.replace("grid", "\n\nGRID").replace("num net", "Num\t NET").replace("  ", "\t")
    assert problem_of(tmp_path, loud.rstrip("\n")) == problem


@pytest.mark.parametrize("format", FORMATS)
def test_a_format_is_written_token_by_token(tmp_path: Path, format: Format) -> None:
    text, problem = TEXTS.get(format, (LAYERED, TWO_LAYERS))
    file = tmp_path / "out"
    problem.write(file, format=format)
    assert Problem.read(file) == problem
    if format in TEXTS:
        assert file.read_text().split() == text.split()
    else:
        assert "minimum spacing 1 1\n" in file.read_text()
        problem.write(tmp_path / "default")
        assert file.read_bytes() == (tmp_path / "default").read_bytes()


def test_one_wrong_word_stands_for_the_spacing(tmp_path: Path) -> None:
    problem = problem_of(tmp_path, LAYERED.replace("width 1 1 \nmin", "width 2 3 \nmin"))
    assert (problem.min_width, problem.min_spacing) == ((2, 3), (1, 1))
    # A net has no width of its own: the layer's counts.
    assert problem.net_demand.tolist() == [[3, 4]] * 3


def test_both_formats_have_room_for_as_many_nets(tmp_path: Path) -> None:
    """24 at width 1 and spacing 1 is 12 tracks; every direction is in one layer of the two."""
    two, one = problem_of(tmp_path, LAYERED), problem_of(tmp_path, FLAT)
    assert one.net_demand.tolist() == [[1]] * 3
    assert tracks(one)[0, 0].tolist() == [3, 2]
    assert np.array_equal(tracks(two), tracks(one))


@pytest.mark.parametrize(("text", "problem"), TEXTS.values(), ids=TEXTS)
def test_a_benchmark_is_routed(tmp_path: Path, text: str, problem: Problem) -> None:
    judged = evaluate(problem, sequential_astar(problem_of(tmp_path, text)))
    # From (0, 2) to (3, 0); with two layers up to the vertical one and back.
    assert judged.connected
    assert (judged.overflow, judged.wirelength - judged.vias) == (0, 5)
    assert judged.vias == (2 if problem.grid[2] == 2 else 0)
    # Three nets over an edge with two tracks.
    pins = (Pin(0, 0, 1), Pin(0, 1, 1))
    nets = tuple(Net(f"n{i}", i, pins) for i in range(3))
    narrow = replace(problem, grid=(1, 2, problem.grid[2]), nets=nets)
    judged = evaluate(narrow, sequential_astar(narrow))
    track = narrow.min_width[0] + narrow.min_spacing[0]
    assert judged.connected
    assert judged.overflow == track


@pytest.mark.parametrize("format", list(TEXTS))
@given(problem=problems())
def test_what_a_format_holds_is_read_as_it_was_written(
    problem: Problem, format: Format, tmp_path_factory: pytest.TempPathFactory
) -> None:
    file = tmp_path_factory.getbasetemp() / "held"
    held = said(problem, format)
    held.write(file, format)
    written = file.read_bytes()
    again = Problem.read(file)
    assert again == held
    again.write(file, format)
    assert file.read_bytes() == written


@pytest.mark.parametrize("format", FORMATS)
@given(problem=problems(max_layers=2, max_nets=2))
def test_a_problem_is_held_whole_or_refused(
    problem: Problem, format: Format, tmp_path_factory: pytest.TempPathFactory
) -> None:
    file = tmp_path_factory.getbasetemp() / "held_or_not"
    file.write_text("before")
    if said(problem, format) == problem:
        problem.write(file, format)
        assert Problem.read(file) == problem
        return
    with pytest.raises(InputError) as caught:
        problem.write(file, format)
    assert str(caught.value).startswith(f"{file}: the format {format} cannot hold it: ")
    assert file.read_text() == "before"


WIDE = replace(NETS[2], min_width=3)
HIGH = replace(NETS[2], pins=(Pin(0, 0, 1), Pin(3, 2, 2)))
FAR = Net("far", 0, (Pin(-3, 5, 1),))
ADJUSTED = (Adjustment(0, 0, 1, 1, 0, 1, 5), Adjustment(1, 0, 1, 2, 0, 1, 5))


@pytest.mark.parametrize(
    ("format", "problem", "what"),
    [
        ("ispd98", replace(TWO_LAYERS, nets=(NETS[0], WIDE)), "net net5: expected minimum width 1"),
        ("ispd98", replace(TWO_LAYERS, nets=(HIGH,)), "pins in layer 1, found (3, 2, 2)"),
        ("ispd98", replace(TWO_LAYERS, adjustments=ADJUSTED), "expected no adjustments, found 2"),
        ("ispd98-flat", TWO_LAYERS, "expected one layer, found 2"),
        ("ispd98-flat", replace(ONE_LAYER, adjustments=ADJUSTED), "no adjustments, found 2"),
        ("ispd98-flat", replace(ONE_LAYER, nets=(WIDE,)), "expected minimum width 1, found 3"),
        ("ispd98-flat", replace(ONE_LAYER, min_width=(2,)), "expected min_width (1,), found (2,)"),
        ("ispd98-flat", replace(ONE_LAYER, min_spacing=(1,)), "min_spacing (0,), found (1,)"),
        ("ispd98-flat", replace(ONE_LAYER, via_spacing=(1,)), "via_spacing (0,), found (1,)"),
        (
            "ispd98-flat",
            replace(ONE_LAYER, origin=(-3, 5), nets=(FAR,)),
            "origin (0, 0), found (-3, 5)",
        ),
        ("ispd98-flat", replace(ONE_LAYER, tile=(5, 5)), "expected tile (1, 1), found (5, 5)"),
    ],
)
def test_what_a_format_cannot_hold_is_named(
    tmp_path: Path, format: Format, problem: Problem, what: str
) -> None:
    file = tmp_path / "out"
    with pytest.raises(InputError) as caught:
        problem.write(file, format)
    assert what in str(caught.value)
    assert not file.exists()
    problem.write(file)
    assert Problem.read(file) == problem


def test_no_such_format(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^format: expected one of .* found 'gr'$") as caught:
        TWO_LAYERS.write(tmp_path / "out", format="gr")  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


# --- files that cannot be used --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "old", "new", "line", "what"),
    [
        (LAYERED, "grid 4 3 2", "grid 4", 1, "columns, rows and layers, or 'grid' and columns"),
        (LAYERED, "grid 4 3 2", "grid 4 3 0", 1, "columns, rows and layers from 1"),
        (LAYERED, "grid 4 3 2", "grid 4 3 3", 2, "expected 3 values, one per layer, found 2"),
        (
            LAYERED,
            "capacity  0 4",
            "capacity 0 4 1",
            2,
            "expected 2 values, one per layer, found 3",
        ),
        (LAYERED, "width 1 1 \nvia", "width 1 \nvia", 5, "min_spacing: expected 2 values"),
        (LAYERED, "width 1 1 \nvia", "widths 1 1\nvia", 5, "or 'minimum width' and a number"),
        # Called by its right name, the spacing makes it a file of the contest, with widths.
        (LAYERED, "width 1 1 \nvia", "spacing 1 1\nvia", 10, "minimum width), found 'net10130 0 3"),
        (LAYERED, "0 0 1 1", "0 0 1", 7, "origin x and y, tile width and height"),
        (LAYERED, "num net 3", "num net", 9, "'num net' and their number, found 'num net'"),
        (LAYERED, "num net 3", "num net 2", 17, "end of the file after 2 nets, found 'net5 2 1'"),
        (LAYERED, "num net 3", "num net 4", 19, "file ends after 3 of 4 nets"),
        (LAYERED, "net10130 0 3", "net10130 0 3 1", 10, "(name, id, number of pins), found"),
        (LAYERED, "net10130 0 3", "net10130 0 4", 14, "pin 4 of 4 of net net10130 (x, y), found"),
        (LAYERED, "net10130 0 3", "net5 0 3", 17, "net net5: expected a name no earlier net has"),
        (LAYERED, "  3 0\n", "  3 0 1\n", 12, "pin 2 of 3 of net net10130 (x, y), found '3 0 1'"),
        (LAYERED, "  3 0\n", "  3 3\n", 12, "expected a point on the 4x3 grid, in layers 1 to 2"),
        (LAYERED, LAYERED, LAYERED + "0\n", 20, "the end of the file after 3 nets, found '0'"),
        (FLAT, "grid 4 3", "grid 4 3 1", 5, "'minimum width' and a number for each layer, found"),
        (FLAT, "grid 4 3", "grid 0 3", 1, "columns, rows and layers from 1"),
        (FLAT, "grid 4 3", "grid 9999 9999", 1, "Gcells in all"),
        (FLAT, "vertical capacity 2", "vertical capacity 2 0", 2, "'vertical capacity' and a nu"),
        (FLAT, "vertical capacity 2\n", "", 2, "'vertical capacity' and a number, found 'hori"),
        (FLAT, "horizontal capacity 3", "horizontal capacity -3", 3, "found -3"),
        (FLAT, "num net 3", "minimum width 1", 5, "'num net' and their number, found 'minimum"),
        (FLAT, "num net 3", "num net 0", 5, "at least one net"),
        (FLAT, "local 7 2", "local 7 2 1", 10, "net 2 of 3 (name, id, number of pins), found"),
        (FLAT, "local 7 2", "local seven 2", 10, "net 2 of 3 (name, id, number of pins), found"),
        (FLAT, "  1 1\n", "  1\n", 11, "pin 1 of 2 of net local (x, y), found '1'"),
        (FLAT, "  3 2", "  4 2", 14, "net net5: expected a point on the 4x3 grid"),
        (FLAT, "  3 2", "  -1 2", 14, "found pin (-1, 2, 1)"),
        (FLAT, "net5 2 1\n  3 2\n\n", "", 12, "file ends after 2 of 3 nets"),
        (FLAT, FLAT, FLAT + "0\n", 16, "the end of the file after 3 nets, found '0'"),
    ],
)
def test_a_spoiled_benchmark(
    tmp_path: Path, text: str, old: str, new: str, line: int, what: str
) -> None:
    assert old in text
    file = tmp_path / "bad.txt"
    file.write_text(text.replace(old, new, 1))
    message = refused(lambda: Problem.read(file), file)
    assert message.startswith(f"{line}: "), message
    assert what in message, message


@pytest.mark.parametrize("text", [LAYERED, FLAT], ids=list(TEXTS))
def test_a_truncated_benchmark(tmp_path: Path, text: str) -> None:
    lines = text.rstrip("\n").splitlines(keepends=True)
    file = tmp_path / "short.txt"
    for keep in range(len(lines)):
        file.write_text("".join(lines[:keep]))
        message = refused(lambda: Problem.read(file), file)
        assert message.startswith(f"{max(1, keep)}: ")
        assert "file ends" in message or "the end of the file" in message


# --- the published file ---------------------------------------------------------------------------


@needs_ibm01
def test_ibm01_is_as_published(tmp_path: Path) -> None:
    problem = Problem.read(IBM01)
    assert problem.grid == (64, 64, 2)
    assert (problem.vertical_capacity, problem.horizontal_capacity) == ((0, 24), (28, 0))
    assert len(problem.nets) == 11_507
    assert sum(len(net.pins) for net in problem.nets) == 44_266
    assert np.all(problem.net_demand == 2)
    problem.write(tmp_path / "out", "ispd98")
    assert Problem.read(tmp_path / "out") == problem
    # Not one token differs; the white space does.
    assert (tmp_path / "out").read_text().split() == IBM01.read_text().split()
    problem.write(tmp_path / "out.gr")
    assert Problem.read(tmp_path / "out.gr") == problem


@needs_ibm01
def test_ibm01_in_the_plane(tmp_path: Path) -> None:
    """The flat file differs in its header alone: half the capacities, in tracks."""
    head, _, nets = IBM01.read_text().partition("num net")
    assert len(head.split()) == 28
    flat = "grid 64 64\nvertical capacity 12\nhorizontal capacity 14\n\nnum net" + nets
    two, one = Problem.read(IBM01), problem_of(tmp_path, flat)
    assert (one.grid, one.nets) == ((64, 64, 1), two.nets)
    one.write(tmp_path / "out", "ispd98-flat")
    assert (tmp_path / "out").read_text().split() == flat.split()
    assert np.array_equal(tracks(two), tracks(one))
