"""The house has two floors: ``marouting`` stands without ``policies`` and without torch."""

import ast
import graphlib
import subprocess
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import pytest

import marouting
import policies

ROOT = Path(marouting.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))
UPSTAIRS = {"policies", "torch"}
OPTIONAL = {"matplotlib"}
"""What a window may import when it opens, and nothing before."""


def imports(tree: ast.AST) -> Iterator[str]:
    """The packages that a piece of source imports, inside functions as well."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield "marouting" if node.level else (node.module or "").split(".")[0]
        elif (
            isinstance(node, ast.Call)
            and ast.unparse(node.func) in ("__import__", "importlib.import_module")
            and node.args
        ):
            name = node.args[0]
            yield str(name.value).split(".")[0] if isinstance(name, ast.Constant) else "?"


def at_import(tree: ast.Module) -> Iterator[str]:
    """The packages that are imported with the module: not in functions, not for types only."""
    waiting: list[ast.AST] = list(tree.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield from imports(node)
        waiting += ast.iter_child_nodes(node)


def test_there_is_something_to_look_at() -> None:
    assert {"engine.py", "problem.py", "make.py"} <= {file.name for file in FILES}
    found = set(imports(ast.parse("def f():\n    import torch.nn\n    from policies import x")))
    assert found == UPSTAIRS


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_nothing_from_upstairs(file: Path) -> None:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    assert not UPSTAIRS & set(imports(tree))
    assert not OPTIONAL & set(at_import(tree))


def test_dependencies_are_the_declared_ones() -> None:
    """Whatever is imported is the standard library, the package itself or in pyproject.toml."""
    declared = {
        "gymnasium",
        "llvmlite",
        "numba",
        "numpy",
        "pettingzoo",
        "pydantic",
        "yaml",
        "scipy",
    }
    allowed = declared | OPTIONAL | {"marouting"} | sys.stdlib_module_names
    for file in FILES:
        named = {"?"} if file == ROOT / "registry.py" else set()  # it imports what users name
        assert set(imports(ast.parse(file.read_text("utf-8")))) <= allowed | named


@pytest.mark.parametrize(
    "use",
    [
        "import marouting",
        "import gymnasium, marouting; gymnasium.make(marouting.ENVIRONMENT_ID).reset()",
        "import marouting; marouting.sequential_astar(marouting.generate(1)[0])",
    ],
)
def test_a_fresh_process_loads_nothing_from_upstairs(use: str) -> None:
    """Transitively: what the imports of the imports bring in."""
    unwanted = sorted(UPSTAIRS | OPTIONAL)
    code = f"{use}; import sys; print([name for name in {unwanted} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.strip() == "[]"


# --- no circles, and rooms that know only those below them ----------------------------------------

POLICIES = Path(policies.__file__).parent
ORDERS = (
    ("routers", "results", "figures", "learned", "experiment", "bench", "cli"),
    ("learned.networks learned.memory", "learned.algorithms learned.compiled", "learned.trainer"),
    ("learned.trainer", "learned.run learned.router"),
)
"""Rooms of ``policies`` from bottom to top; those in one string stand side by side."""


def modules(root: Path) -> dict[str, Path]:
    """The files of a package by the module's name."""
    named = {}
    for file in sorted(root.rglob("*.py")):
        parts = file.relative_to(root.parent).with_suffix("").parts
        named[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return named


def arrows(source: str, known: Collection[str]) -> set[str]:
    """The known modules that a piece of source imports: in functions and for types as well."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "expected imports by the whole name"
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            # A package itself is meant only where something is taken that is no module of it.
            found |= inside & set(known)
            found |= {str(node.module)} if inside - set(known) else set()
    return found & set(known)


def upward(found: Mapping[str, Iterable[str]], order: Sequence[str]) -> list[str]:
    """The imports that go from a room to one above it."""

    def level(module: str) -> int | None:
        rooms = (room.split() for room in order)
        return next(
            (
                number
                for number, names in enumerate(rooms)
                if any(f"{module}.".startswith(f"policies.{name}.") for name in names)
            ),
            None,
        )

    def goes_up(low: int | None, high: int | None) -> bool:
        return low is not None and high is not None and low < high

    return [
        f"{module} imports {other}"
        for module, others in found.items()
        for other in others
        if goes_up(level(module), level(other))
    ]


def graph(root: Path) -> dict[str, set[str]]:
    files = modules(root)
    return {name: arrows(file.read_text("utf-8"), files) for name, file in files.items()}


def test_circles_and_upward_imports_are_seen() -> None:
    known = ["policies.cli", "policies.cli.a", "policies.routers", "policies.routers.b"]
    source = (
        "def f():\n    from policies.routers import b\n"
        "if TYPE_CHECKING:\n    import policies.cli.a\n"
        "from policies.cli import anything"
    )
    assert arrows(source, known) == {"policies.routers.b", "policies.cli.a", "policies.cli"}
    wrong = {"policies.routers.b": {"policies.cli.a"}, "policies.cli.a": {"policies.routers.b"}}
    assert upward(wrong, ORDERS[0]) == ["policies.routers.b imports policies.cli.a"]
    with pytest.raises(graphlib.CycleError):
        graphlib.TopologicalSorter(wrong).prepare()


@pytest.mark.parametrize("root", [ROOT, POLICIES], ids=lambda root: root.name)
def test_no_circles_among_files(root: Path) -> None:
    found = graph(root)
    assert len(found) > 20
    graphlib.TopologicalSorter(found).prepare()  # a CycleError names the files of a circle


@pytest.mark.parametrize("order", ORDERS, ids=["rooms", "learned", "training"])
def test_rooms_import_only_from_below(order: Sequence[str]) -> None:
    assert not upward(graph(POLICIES), order)
    rooms = [name for room in order for name in room.split()]
    assert all(any(f"policies.{room}" == name for name in modules(POLICIES)) for room in rooms)
