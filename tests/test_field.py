"""Fields: walls and gates where they were drawn, and nothing else."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from marouting import Field, InputError, Pin, Problem
from marouting.problem.grid import AXES


def tracks(problem: Problem, x: int, y: int, axis: int, layer: int = 1) -> int:
    """The capacity of the edge from a Gcell along x (axis 0) or y (axis 1)."""
    gcell = problem.topology.number(x, y, layer - 1)
    return int(problem.capacity[AXES * gcell + axis])


def field(columns: int = 5, rows: int = 4, layers: int = 1) -> Field:
    return Field(columns, rows, layers, capacity=3).net((0, 0), (columns - 1, rows - 1))


def test_an_empty_field_has_tracks_everywhere() -> None:
    problem = field().problem()
    assert problem.grid == (5, 4, 1)
    assert (problem.horizontal_capacity, problem.vertical_capacity) == ((3,), (3,))
    assert problem.adjustments == ()
    two = field(layers=3).problem()
    assert (two.horizontal_capacity, two.vertical_capacity) == ((3, 0, 3), (0, 3, 0))


def test_a_wall_between_columns_closes_what_crosses_it() -> None:
    problem = field().wall(right_of=2).problem()
    closed = {(x, y) for x in range(4) for y in range(4) if tracks(problem, x, y, 0) == 0}
    assert closed == {(2, y) for y in range(4)}
    assert all(tracks(problem, x, y, 1) == 3 for x in range(5) for y in range(3))
    part = field().wall(right_of=2, rows=(1, 2)).problem()
    assert [tracks(part, 2, y, 0) for y in range(4)] == [3, 0, 0, 3]


def test_a_wall_between_rows_closes_what_crosses_it() -> None:
    problem = field().wall(above=1, columns=(3, 4)).problem()
    assert [tracks(problem, x, 1, 1) for x in range(5)] == [3, 3, 3, 0, 0]
    assert all(tracks(problem, x, y, 0) == 3 for x in range(4) for y in range(4))


def test_what_is_drawn_later_counts() -> None:
    drawn = field().wall(right_of=0).gate(right_of=0, row=2, tracks=1).gate(right_of=0, row=3)
    assert [tracks(drawn.problem(), 0, y, 0) for y in range(4)] == [0, 0, 1, 3]
    assert tracks(drawn.wall(right_of=0).problem(), 0, 2, 0) == 0
    across = field().wall(above=0).gate(above=0, column=4, tracks=2).problem()
    assert [tracks(across, x, 0, 1) for x in range(5)] == [0, 0, 0, 0, 2]


def test_an_area_is_closed_at_its_border_too() -> None:
    problem = field().area(columns=(1, 2), rows=(2, 3)).problem()
    closed = {(x, y, 0) for x in (0, 1, 2) for y in (2, 3)} | {
        (x, y, 1) for x in (1, 2) for y in (1, 2)
    }
    for x in range(5):
        for y in range(4):
            for axis in (0, 1):
                on_grid = (x < 4) if axis == 0 else (y < 3)
                expected = 0 if (x, y, axis) in closed or not on_grid else 3
                assert tracks(problem, x, y, axis) == expected


def test_layers_share_walls_in_their_direction() -> None:
    problem = field(layers=3).wall(right_of=1).wall(above=2).problem()
    assert [tracks(problem, 1, 0, 0, layer) for layer in (1, 2, 3)] == [0, 0, 0]
    assert [tracks(problem, 0, 0, 0, layer) for layer in (1, 2, 3)] == [3, 0, 3]
    assert [tracks(problem, 0, 2, 1, layer) for layer in (1, 2, 3)] == [0, 0, 0]
    assert {(a.layer1, a.x1 == a.x2) for a in problem.adjustments} == {
        (1, False), (3, False), (2, True),
    }  # fmt: skip


def test_nets() -> None:
    drawn = Field(4, 4, 2).net((0, 1), (3, 2, 2)).net((1, 1), (2, 2), (3, 3), name="clock")
    first, second = drawn.problem().nets
    assert (first.name, first.pins) == ("n0", (Pin(0, 1, 1), Pin(3, 2, 2)))
    assert (second.name, second.id, len(second.pins)) == ("clock", 1, 3)


@given(st.booleans(), st.booleans(), st.data())
def test_mirrored_twice_is_as_before(columns: bool, rows: bool, data: st.DataObject) -> None:
    right_of, above = data.draw(st.integers(0, 3)), data.draw(st.integers(0, 2))
    drawn = (
        field(layers=2).wall(right_of=right_of, rows=(1, 3)).gate(above=above, column=0, tracks=9)
    )
    once = drawn.mirrored(columns=columns, rows=rows)
    twice = once.mirrored(columns=columns, rows=rows).problem()
    assert np.array_equal(twice.capacity, drawn.problem().capacity)
    assert twice.nets == drawn.problem().nets
    seen = once.problem()
    x, y = 3 - right_of if columns else right_of, 2 if not rows else 1
    assert tracks(seen, x, y, 0) == 0
    assert tracks(seen, 4 if columns else 0, 2 - above if rows else above, 1, layer=2) == 9
    assert seen.nets[0].pins[0] == Pin(4 * columns, 3 * rows, 1)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda f: f.wall(), "wall or gate: expected right_of, a column, or above, a row"),
        (lambda f: f.wall(right_of=1, above=1), "wall or gate: expected right_of"),
        (lambda f: f.wall(right_of=4), "right_of: expected 0 to 3, found 4"),
        (lambda f: f.wall(above=-1), "above: expected 0 to 2, found -1"),
        (
            lambda f: f.wall(above=1, rows=(0, 1)),
            "wall: expected columns, where it begins and ends",
        ),
        (
            lambda f: f.wall(right_of=1, rows=(2, 4)),
            r"rows: expected numbers from 0 to 3, found \(2",
        ),
        (lambda f: f.gate(right_of=1), "gate: expected a row beside where it lies"),
        (
            lambda f: f.gate(above=1, column=0, row=0),
            "gate: expected a column beside where it lies",
        ),
        (lambda f: f.area(columns=(0, 5), rows=(0, 0)), "columns: expected numbers from 0 to 4"),
        (lambda f: f.net((1,)), r"pin: expected \(column, row\) or \(column, row, layer\), found"),
        (lambda f: f.net((5, 0), (0, 0)).problem(), "net n1: expected a point on the 5x4 grid"),
        (lambda f: f.gate(right_of=0, row=0, tracks=-1), "tracks: expected a whole number from 0"),
        (lambda f: f.gate(right_of=0, row=0, tracks=1.5), "tracks: expected a whole number from 0"),
        (lambda f: f.gate(right_of=1, row=1.5), "row: expected numbers from 0 to 3"),
        (lambda f: f.wall(right_of="1"), "right_of: expected 0 to 3, found '1'"),
        (lambda _: Field(1, 5).wall(right_of=0), "right_of: expected a grid of at least two col"),
        (lambda f: f.mirrored(rows="no"), "rows: expected true or false, found 'no'"),
        (lambda f: f.wall(right_of=1, rows="23"), "rows: expected numbers from 0 to 3, found '23'"),
        (lambda f: f.wall(right_of=1.5), "right_of: expected 0 to 3, found 1.5"),
        (lambda f: f.wall(right_of=1, rows=3), "rows: expected numbers from 0 to 3, found 3"),
        (lambda f: f.net((0.7, 0), (3.9, 3)), r"pin: expected \(column, row\)"),
        (lambda f: f.net((0, "a"), (1, 1)), r"pin: expected \(column, row\)"),
        (lambda f: f.net(None), r"pin: expected \(column, row\)"),
        (lambda _: Field(float("nan"), 5), "columns, rows, layers and capacity: expected a whole"),
        (
            lambda _: Field(True, 5),
            "columns, rows, layers and capacity: expected a whole number from 0",
        ),
        (lambda _: Field(3, 3, capacity=None), "columns, rows, layers and capacity: expected"),
        (lambda _: Field(3, 3).problem(), "nets: expected at least one net"),
        (lambda _: Field(0, 3), "grid"),
    ],
)
def test_what_fields_refuse(call: object, said: str) -> None:
    assert callable(call)
    with pytest.raises(InputError, match=f"^{said}"):
        call(field())
