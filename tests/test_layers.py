"""The house has two floors: ``marouting`` stands without ``policies`` and without torch."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import marouting

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
    found = {name for file in FILES for name in imports(ast.parse(file.read_text("utf-8")))}
    # The registry imports what users name.
    assert found <= allowed | {"?"}


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
