"""Files that cannot be used: one line that names file and line, fast, and never another error."""

import os
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from marouting import Adjustment, InputError, Net, Pin, Problem, Solution
from marouting.files import LONGEST_LINE
from marouting.yaml_files import parse_yaml, read_yaml
from policies.results import rows, run_folder
from policies.results.rows import read_rows
from policies.results.run_folder import read_rewards

GR = """\
grid 3 2 2
vertical capacity 0 4
horizontal capacity 6 0
minimum width 1 1
minimum spacing 0 0
via spacing 0 0
0 0 10 10
num net 2
A 1 2 1
5 5 1
25 15 1
B 2 1 1
15 5 1
2
1 0 1 2 0 1 3
0 0 2 0 1 2 0
"""
SOLUTION = """\
A 1 2
(5,5,1)-(25,5,1)
(25,5,1)-(25,5,2)
!
B 2 0
!
"""
HUGE = "9" * 5000


def refused(read: Callable[[], object], file: Path) -> str:
    """The message of the InputError, less the file's name."""
    with pytest.raises(InputError) as caught:
        read()
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < len(str(file)) + 300
    assert message.startswith(f"{file}:")
    return message.removeprefix(f"{file}:")


def refused_problem(tmp_path: Path, content: str | bytes) -> str:
    file = tmp_path / "bad.gr"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return refused(lambda: Problem.read(file), file)


def refused_solution(tmp_path: Path, content: str | bytes) -> str:
    problem_file, file = tmp_path / "good.gr", tmp_path / "bad.solution"
    problem_file.write_text(GR)
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    problem = Problem.read(problem_file)
    return refused(lambda: Solution.read(file, problem), file)


def test_the_files_are_good_before_they_are_spoiled(tmp_path: Path) -> None:
    (tmp_path / "good.gr").write_text(GR)
    (tmp_path / "good.solution").write_text(SOLUTION)
    problem = Problem.read(tmp_path / "good.gr")
    assert Solution.read(tmp_path / "good.solution", problem).edges[0].size == 3


@pytest.mark.parametrize("kind", [Problem.read, None])
def test_a_missing_file_or_a_folder(tmp_path: Path, kind: Callable[[Path], object] | None) -> None:
    (tmp_path / "good.gr").write_text(GR)
    problem = Problem.read(tmp_path / "good.gr")
    read = kind or (lambda path: Solution.read(path, problem))
    missing = tmp_path / "missing"
    assert "No such file" in refused(lambda: read(missing), missing)
    assert "Is a directory" in refused(lambda: read(tmp_path), tmp_path)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="there are no devices in files")
@pytest.mark.parametrize("device", ["/dev/zero", "/dev/urandom", "/dev/null"])
def test_devices_are_no_files(tmp_path: Path, device: str) -> None:
    (tmp_path / "good.gr").write_text(GR)
    problem = Problem.read(tmp_path / "good.gr")
    reads: list[Callable[[Path], object]] = [Problem.read, read_yaml, read_rows, read_rewards]
    for read in (*reads, lambda path: Solution.read(path, problem)):
        assert refused(lambda read=read: read(Path(device)), Path(device)) == (
            " expected a file, found a device"
        )


def test_a_line_without_an_end(tmp_path: Path) -> None:
    message = "expected lines of at most 1048576 bytes"
    assert refused_problem(tmp_path, b"x" * (LONGEST_LINE + 1)) == f"1: {message}"
    assert refused_problem(tmp_path, GR.encode() + b"\0" * 2**21) == f"17: {message}"
    assert refused_solution(tmp_path, b"A 1\n" + b" " * 2**21) == f"2: {message}"
    # White space is ignored, up to that.
    (tmp_path / "wide.gr").write_text(GR.replace("\n", " " * 1000 + "\n"))
    assert len(Problem.read(tmp_path / "wide.gr").nets) == 2
    endless = tmp_path / "endless.gr"
    with endless.open("wb") as file:
        file.truncate(2**33)  # takes no room on most disks
    tracemalloc.start()
    try:
        assert refused(lambda: Problem.read(endless), endless) == f"1: {message}"
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4e6


def test_files_of_configurations_and_results_have_a_largest_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "large"
    file.write_bytes(b"#" * (2**24 + 1))
    assert refused(lambda: read_yaml(file), file) == " expected at most 16 MiB"
    file.write_bytes(b"#" * 2**20)
    assert read_yaml(file) == {}
    assert rows.MOST_BYTES == 2**30
    for module in (rows, run_folder):
        monkeypatch.setattr(module, "MOST_BYTES", 2**19)
    assert refused(lambda: read_rows(file), file) == " expected at most 0.5 MiB"
    assert refused(lambda: read_rewards(file), file) == " expected at most 0.5 MiB"


@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="pipes have no names here")
def test_pipes_are_read(tmp_path: Path) -> None:
    """As in ``marouting evaluate <(zcat problem.gr.gz) /dev/stdin``."""
    (tmp_path / "good.gr").write_text(GR)
    problem = Problem.read(tmp_path / "good.gr")
    reads: list[tuple[str, Callable[[str], object]]] = [
        (GR, Problem.read),
        (SOLUTION, lambda path: Solution.read(path, problem)),
    ]
    for text, read in reads:
        end, start = os.pipe()
        os.write(start, text.encode())
        os.close(start)
        assert read(f"/dev/fd/{end}") is not None
        os.close(end)


def test_writing_over_a_folder(tmp_path: Path) -> None:
    (tmp_path / "good.gr").write_text(GR)
    problem = Problem.read(tmp_path / "good.gr")
    assert "folder" in refused(lambda: problem.write(tmp_path), tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "line", "what"),
    [
        ("grid 3 2 2", "grid 3", 1, "columns and rows, found 'grid 3'"),
        # Two numbers are those of a flat grid, and its capacities one number each.
        ("grid 3 2 2", "grid 3 2", 2, "'vertical capacity' and a number, found"),
        ("grid 3 2 2", "\n\nnet 3 2 2", 3, "'grid'"),
        ("grid 3 2 2", "grid 3 2 x", 1, "'grid'"),
        ("grid 3 2 2", "grid 3 0 2", 1, "from 1"),
        ("grid 3 2 2", "grid 99999 99999 2", 1, "Gcells in all"),
        ("grid 3 2 2", f"grid 3 2 {HUGE}", 1, "found 'grid 3 2 9999"),
        ("capacity 6 0", "capacity 6 0 0", 3, "expected 2 values, one per layer, found 3"),
        ("capacity 0 4", "capacity -1 4", 2, "found -1"),
        ("capacity 0 4", "capacity 0 1.5", 2, "'vertical capacity' and a number"),
        ("capacity 0 4", "capacity 0 1_0", 2, "'vertical capacity' and a number"),
        ("capacity 0 4", "capacity 0 ４", 2, "'vertical capacity' and a number"),
        ("capacity 0 4", "capacity", 2, "'vertical capacity' and a number"),
        ("minimum spacing", "maximum spacing", 5, "'minimum spacing' and a number for each layer"),
        # The wrong word tells the ISPD'98 format, whose nets have no width.
        ("minimum spacing", "minimum width", 9, "(name, id, number of pins), found 'A 1 2 1'"),
        ("0 0 10 10", "0 0 10 0", 7, "a width and a height from 1"),
        ("0 0 10 10", "0 0 10", 7, "tile width and height"),
        ("0 0 10 10", "0 9999999999 10 10", 7, "origin"),
        ("num net 2", "num net 0", 8, "at least one net"),
        ("num net 2", "num net -2", 8, "at least one net"),
        ("num net 2", "num nets 2", 8, "'num net'"),
        ("num net 2", "num net 1", 12, "number of adjusted capacities, found 'B 2 1 1'"),
        ("num net 2", "num net 3", 14, "net 3 of 3 (name, id, number of pins, minimum width)"),
        ("A 1 2 1", "A 1 2", 9, "net 1 of 2"),
        ("A 1 2 1", "A 1 3 1", 12, "pin 3 of 3 of net A (x, y, layer), found 'B 2 1 1'"),
        ("A 1 2 1", "A 1 1 1", 11, "net 2 of 2"),
        ("A 1 2 1", "A\x07 1 2 1", 9, "printable"),
        ("A 1 2 1", "A -1 2 1", 9, "found -1"),
        ("A 1 2 1", "A 1 2 9999999999", 9, "found 9999999999"),
        ("B 2 1 1", "A 2 1 1", 12, "net A: expected a name no earlier net has"),
        ("B 2 1 1\n15 5 1", "B 2 0 1", 12, "net B: expected at least one pin"),
        ("5 5 1", "5 5 0", 10, "net A: expected a point on the 3x2 grid, in layers 1 to 2"),
        ("25 15 1", "25 20 1", 11, "found pin (25, 20, 1)"),
        ("25 15 1", "25 -1 1", 11, "found pin (25, -1, 1)"),
        ("15 5 1", "999999999999999999 5 1", 13, "net B: expected a point on the 3x2 grid"),
        ("\n2\n1 0", "\n1\n1 0", 16, "the end of the file after 1 adjustments"),
        ("\n2\n1 0", "\n3\n1 0", 16, "file ends after 2 of 3 adjustments"),
        ("\n2\n1 0", "\n-1\n1 0", 14, "number of adjusted capacities"),
        ("\n2\n1 0", "\n2 2\n1 0", 14, "number of adjusted capacities"),
        ("1 0 1 2 0 1 3", "1 0 1 2 0 1", 15, "adjustment 1 of 2"),
        ("1 0 1 2 0 1 3", "1 0 1 2 0 1 -3", 15, "a capacity from 0"),
        ("1 0 1 2 0 1 3", "1 0 1 1 0 2 3", 15, "two neighbouring Gcells of one layer"),
        ("1 0 1 2 0 1 3", "0 0 1 2 0 1 3", 15, "two neighbouring Gcells of one layer"),
        ("1 0 1 2 0 1 3", "2 0 1 3 0 1 3", 15, "two neighbouring Gcells of one layer"),
        (GR, GR + "\n\nx", 19, "the end of the file after 2 adjustments, found 'x'"),
    ],
)
def test_a_spoiled_problem(tmp_path: Path, old: str, new: str, line: int, what: str) -> None:
    assert old in GR
    message = refused_problem(tmp_path, GR.replace(old, new, 1))
    assert message.startswith(f"{line}: ")
    assert what in message


@pytest.mark.parametrize(
    ("old", "new", "line", "what"),
    [
        ("A 1 2", "C 1 2", 1, "found 'C 1 2'"),
        ("A 1 2", "A", 2, "'(' after the name of net A"),  # as in a guide
        ("A 1 2", "A 1 x", 1, "a net's name, id"),
        ("A 1 2", f"A {HUGE}", 1, "a net's name, id"),
        ("B 2 0", "A 1 0", 5, "found 'A 1 0'"),
        ("(25,5,1)\n", "(25,15,1)\n", 2, "expected a segment along one axis"),
        ("(5,5,1)-", "(5,5,3)-", 2, "found (5, 5, 3)"),
        ("(5,5,1)-", "(-1,5,1)-", 2, "found (-1, 5, 1)"),
        ("-(25,5,2)", "-(30,5,2)", 3, "expected a point on the 3x2 grid, in layers 1 to 2"),
        ("-(25,5,2)", "(25,5,2)", 3, "a segment '(x,y,layer)-(x,y,layer)' or '!'"),
        ("-(25,5,2)", f"-({HUGE},5,2)", 3, "a segment"),
        ("-(25,5,2)", "-(2 5,5,2)", 3, "a segment"),
        ("!\nB", "B", 4, "a segment"),
        ("B 2 0\n!\n", "B 2 0\n", 5, "file ends inside net B"),
        (SOLUTION, SOLUTION + "!\n", 7, "a net's name, id"),
    ],
)
def test_a_spoiled_solution(tmp_path: Path, old: str, new: str, line: int, what: str) -> None:
    assert old in SOLUTION
    message = refused_solution(tmp_path, SOLUTION.replace(old, new, 1))
    assert message.startswith(f"{line}: ")
    assert what in message


# What Python takes for a blank (str.split), and its int() and float() for a number.
BLANKS = "\x1c\x1d\x1e\x1f\x85\xa0\u1680\u2003\u2028\u202f\u3000"
NUMBERS = ("1_0", "١", "１", "߁", "1\u2009", "+_1", "²")


@pytest.mark.parametrize("blank", BLANKS)
def test_only_ascii_blanks_part_words(tmp_path: Path, blank: str) -> None:
    assert refused_problem(tmp_path, GR.replace("num net 2", f"num{blank}net 2"))
    assert refused_problem(tmp_path, GR.replace("5 5 1", f"5 5{blank}1", 1))
    assert refused_problem(tmp_path, GR.replace("\n15 5 1", f"\n15 5 1\n{blank}", 1))
    assert refused_solution(tmp_path, SOLUTION.replace("A 1", f"A{blank}1"))
    assert refused_solution(tmp_path, SOLUTION.replace(")-(", f"){blank}-("))
    assert refused_solution(tmp_path, SOLUTION.replace("A 1 2\n", f"A\n(\n5 5 0{blank}25 5 0\n)\n"))


@pytest.mark.parametrize("number", NUMBERS)
def test_only_ascii_digits_are_numbers(tmp_path: Path, number: str) -> None:
    for line in GR.splitlines():
        *words, last = line.split()
        if last != "2" or words:  # the number of adjustments, at which the nets end
            assert refused_problem(tmp_path, GR.replace(line, " ".join((*words, number)), 1))
    assert refused_problem(tmp_path, GR.replace("\n2\n1 0", f"\n{number}\n1 0"))
    assert refused_solution(tmp_path, SOLUTION.replace("A 1 2", f"A 1 {number}"))
    assert refused_solution(tmp_path, SOLUTION.replace("A 1", f"A {number}"))
    assert refused_solution(tmp_path, SOLUTION.replace("(5,", f"({number},"))


def test_no_text_at_all(tmp_path: Path) -> None:
    assert refused_problem(tmp_path, b"").startswith("1: expected 'grid'")
    assert refused_problem(tmp_path, b"grid 3 2 2\n\xff\xfe\x00").startswith("2: expected UTF-8")
    assert refused_solution(tmp_path, b"\x80\x81") == "1: expected UTF-8 text"


@pytest.mark.parametrize("keep", range(13))
def test_a_truncated_problem(tmp_path: Path, keep: int) -> None:
    # From line 13 on all nets are there, and the adjustments may be missing.
    message = refused_problem(tmp_path, "".join(GR.splitlines(keepends=True)[:keep]))
    assert message.startswith(f"{max(1, keep)}: ")
    assert "file ends" in message or "the end of the file" in message


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("num net 2", "num net 1000000000", "net 3 of 1000000000"),
        ("B 2 1 1\n15 5 1\n2\n1 0 1 2 0 1 3\n0 0 2 0 1 2 0\n", "", "after 1 of 1000000000 nets"),
        ("A 1 2 1", "A 1 1000000000 1", "pin 3 of 1000000000 of net A"),
        ("\n2\n1 0", "\n1000000000\n1 0", "file ends after 2 of 1000000000 adjustments"),
        ("grid 3 2 2", "grid 1000000000 1000000000 1000000000", "Gcells in all"),
        ("grid 3 2 2", "grid 2 2 1000000000", "Gcells in all"),
        ("grid 3 2 2", "grid 1 1 16777216", "expected 16777216 values, one per layer, found 2"),
        # As large as may be: not refused for its size, and yet costs nothing.
        ("grid 3 2 2", "grid 2048 4096 2", "a capacity from 0"),
    ],
)
def test_a_promise_costs_nothing(tmp_path: Path, old: str, new: str, what: str) -> None:
    assert old in GR
    text = GR.replace(old, new, 1)
    if what.startswith("after 1 of"):
        text = text.replace("num net 2", "num net 1000000000")
    if what == "a capacity from 0":
        text = text.replace("0 0 2 0 1 2 0", "0 0 2 0 1 2 -1")
    start = time.perf_counter()
    tracemalloc.start()
    try:
        message = refused_problem(tmp_path, text)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert what in message
    assert peak < 2e6
    assert time.perf_counter() - start < 2


def test_a_large_grid_costs_nothing_until_its_tables_are_needed(tmp_path: Path) -> None:
    file = tmp_path / "large.gr"
    file.write_text(GR)
    assert Problem.read(file).pin_gcells  # what numba takes when it is first used is no matter
    file.write_text(GR.replace("grid 3 2 2", "grid 2048 4096 2"))
    tracemalloc.start()
    try:
        problem = Problem.read(file)
        solution = Solution(problem, (problem.pin_gcells[0][:0], problem.pin_gcells[0][:0]))
        solution.write(tmp_path / "large.solution")
        assert Solution.read(tmp_path / "large.solution", problem) == solution
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 2e6


@pytest.mark.parametrize(
    "change",
    [
        lambda p: replace(p, nets=()),
        lambda p: replace(p, origin=(0, 2**70)),
        lambda p: replace(p, nets=(Net("A", 0, (Pin(2**70, 0, 1),)),)),
        lambda p: replace(p, nets=(Net("A", 0, (Pin(2**63 - 1, 0, 1),)),)),
        lambda p: replace(p, nets=(Net("a b", 0, (Pin(0, 0, 1),)),)),
        lambda p: replace(p, nets=(Net("\ud800", 0, (Pin(0, 0, 1),)),)),
        lambda p: replace(p, adjustments=(Adjustment(0, 0, 1, 2**62, 0, 1, 0),)),
    ],
)
def test_problems_made_in_memory_are_judged_the_same(
    tmp_path: Path, change: Callable[[Problem], Problem]
) -> None:
    (tmp_path / "good.gr").write_text(GR)
    with pytest.raises(InputError) as caught:
        change(Problem.read(tmp_path / "good.gr"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("message", "shown"),
    [
        ("a.yaml: k\ney", "a.yaml: k ey"),
        ("\x1b[2J\ud800\u2028é", r"\x1b[2J\ud800\u2028é"),
        ("x" * 500, "x" * 500),
        ("x" * 501 + "y", "x" * 397 + " … " + "x" * 99 + "y"),
    ],
)
def test_a_message_is_one_printable_line(message: str, shown: str) -> None:
    assert str(InputError(message)) == shown


# --- YAML -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("10", 10),
        ("010", 10),
        ("-010", -10),
        ("0o17", 15),
        ("0x1f", 31),
        ("1e-4", 1e-4),
        (".5", 0.5),
        ("-.inf", float("-inf")),
        ("1:30", "1:30"),
        ("1:30.5", "1:30.5"),
        ("1_000", "1_000"),
        ("2026-11-22", "2026-11-22"),
        ("true", True),
        ("~", None),
    ],
)
def test_scalars_of_yaml(text: str, value: object) -> None:
    found = parse_yaml(text, "a.yaml")
    assert (type(found), found) == (type(value), value)


def aliases(levels: int, each: int) -> str:
    """Lists of lists, each of them ``each`` times the one before."""
    lines = [f"a0: &a0 [{', '.join(['x'] * each)}]"]
    for level in range(1, levels):
        again = ", ".join([f"*a{level - 1}"] * each)
        lines.append(f"a{level}: &a{level} [{again}]")
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (aliases(9, 9), "6: expected YAML: there are more than 100000 values"),
        (aliases(25, 2), "16: expected YAML: there are more than 100000 values"),
        ("a: 1\nb: &b {c: [*b]}", "2: expected YAML: a value contains itself"),
        ("a: 1\nb: " + "[" * 900, "2: expected YAML: values are nested more than 50 deep"),
        ('a: 1\nb: "c\\0"', "2: expected YAML: a text contains the character NUL"),
    ],
    ids=["nine times nine", "doubled", "itself", "deep", "NUL"],
)
def test_yaml_has_bounds(text: str, line: str) -> None:
    tracemalloc.start()
    with pytest.raises(InputError) as caught:
        parse_yaml(text, "a.yaml")
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert str(caught.value) == f"a.yaml:{line}"
    assert most < 20_000_000


@given(st.text(st.sampled_from("&*ab:{}[],-#!|>?%@'\"\\0 19.e_x\n\t<~"), max_size=40))
def test_any_yaml_is_data_or_refused(text: str) -> None:
    said = "a.yaml"
    try:
        parse_yaml(text, "a.yaml")
    except InputError as error:
        said = str(error)
    assert said.startswith("a.yaml")
    assert "\n" not in said
