"""Imports: ``marouting`` needs neither ``policies`` nor torch; a layer knows only those below it;
no files import each other in a circle."""

import ast
import graphlib
import subprocess
import sys
import textwrap
from collections.abc import Collection, Iterator
from pathlib import Path

import pytest

import marouting
import policies
from marouting import registry

ROOT = Path(marouting.__file__).parent
START = "__main__"
"""The command's first step, which no other module knows: it hands over to ``policies``."""

FILES = sorted(file for file in ROOT.rglob("*.py") if file.stem != START)
FORBIDDEN = {"policies", "torch"}
OPTIONAL = {"cuda", "klayout", "matplotlib"}
"""What games on a device, a design that is read or a window that opens may import."""

LAYERS = {
    "marouting": (
        (
            "_version",
            "first",
            "errors",
            "checks",
            "files",
            "memory",
            "kernels",
            "compiling",
            "registry",
            "old_names",
            "config",
            "yaml_files",
        ),
        ("problem",),
        ("trees",),
        ("rules",),
        ("game",),
        ("columns",),
        ("observations", "rewards"),
        ("batch",),
        ("search",),
        ("generator",),
        ("scenarios",),
        ("options", "source"),
        ("player",),
        ("render",),
        ("env",),
        ("vector", "gym_vector", "global_routing_v0", "configured"),
        ("cuda", "evaluation"),
        ("",),  # the package's own __init__.py
        (START,),
    ),
    "policies": (
        ("command", "integrations", "interrupts"),
        ("engines",),
        ("routers",),
        ("results",),
        ("figures",),
        ("generalist.outlook", "generalist.regrets", "generalist.cheapest_tree"),
        ("learned.per_network", "learned.counter_rng", "learned.machine", "learned.checkpoint"),
        ("learned.networks", "learned.memory", "learned.exploration"),
        ("learned.compiled",),
        ("generalist.walk",),
        ("learned.greedy",),
        ("learned.learner",),
        ("learned.algorithms", "generalist.imitation"),
        ("learned.burn_in", "learned.config", "learned.policy"),
        ("generalist",),
        ("learned.on_device",),
        ("learned.saved", "learned.trainer", "learned.device_trainer"),
        ("learned.logs", "learned.router", "learned.run"),
        ("learned",),
        ("experiment",),
        ("cli",),
        ("bench",),
        ("",),
    ),
}
"""For each package its layers, bottom to top, and the folders or files in each. A file may import
from its own layer and from those below."""


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


def modules(package: str) -> dict[str, Path]:
    """The files of a package by the dotted names of their modules."""
    root = ROOT.parent / package
    found = {}
    for file in sorted(root.rglob("*.py")):
        parts = file.relative_to(root.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


def imported_modules(source: str, module: str, known: Collection[str]) -> set[str]:
    """The known modules that a module imports: in functions and for types only as well.

    The packages on the way to a module are not counted, although Python imports them too.

    Args:
        source: the module's text.
        module: its dotted name, with ``.__init__`` if it is a package.
        known: dotted names of modules.
    """
    names = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = module.split(".")[: -node.level] if node.level else []
            origin = ".".join(base + ([node.module] if node.module else []))
            inside = [f"{origin}.{alias.name}" for alias in node.names]
            names += [name if name in known else origin for name in inside]
        elif (
            isinstance(node, ast.Call)
            and ast.unparse(node.func) in ("__import__", "importlib.import_module", "import_module")
            and node.args
            and isinstance(node.args[0], ast.Constant)
        ):
            names.append(str(node.args[0].value))
    return set(names) & set(known)


def import_graph(package: str) -> dict[str, set[str]]:
    """For each module of a package the modules of the same package that it imports."""
    known = modules(package)
    return {
        name: imported_modules(
            file.read_text(encoding="utf-8"),
            f"{name}.__init__" if file.name == "__init__.py" else name,
            known,
        )
        for name, file in known.items()
    }


def layer_of(module: str) -> int | None:
    """The layer of a module, counted from the bottom; None for one that has none."""
    package, _, name = module.partition(".")
    found = None
    for i, layer in enumerate(LAYERS[package]):
        for known in layer:
            inside = name == known or (known and name.startswith(f"{known}."))
            if inside and (found is None or len(known) > len(found[1])):
                found = i, known
    return found and found[0]


def test_nothing_needs_the_integrations() -> None:
    """Each imports a library of its own."""
    for module, others in import_graph("policies").items():
        known = module.startswith("policies.integrations")
        assert known or not any(o.startswith("policies.integrations") for o in others), module


def test_there_is_something_to_look_at() -> None:
    assert {"engine.py", "problem.py", "configured.py"} <= {file.name for file in FILES}
    found = set(imports(ast.parse("def f():\n    import torch.nn\n    from policies import x")))
    assert found == FORBIDDEN


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_neither_torch_nor_policies(file: Path) -> None:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    assert not FORBIDDEN & set(imports(tree))
    assert not OPTIONAL & set(at_import(tree))


def test_no_import_is_overlooked() -> None:
    known = {"p", "p.a", "p.b", "p.b.c", "p.b.d"}
    source = """
        import numpy, p.a
        if TYPE_CHECKING:
            from p.b import c, Name
        def late():
            from .d import Name
            import_module("p")
    """
    found = imported_modules(textwrap.dedent(source), "p.b.c", known)
    assert found == {"p.a", "p.b.c", "p.b", "p.b.d", "p"}
    assert imported_modules("from . import d", "p.b.__init__", known) == {"p.b.d"}
    graph = import_graph("marouting")
    assert "marouting.search.astar" in graph["marouting.search.guides"]
    assert "marouting.vector" in graph["marouting"]


@pytest.mark.parametrize("package", LAYERS)
def test_no_files_import_each_other_in_a_circle(package: str) -> None:
    try:
        graphlib.TopologicalSorter(import_graph(package)).prepare()
    except graphlib.CycleError as error:
        pytest.fail("a circle, each imported by the next: " + ", ".join(error.args[1]))


@pytest.mark.parametrize("package", LAYERS)
def test_layers_import_only_from_layers_below(package: str) -> None:
    graph = import_graph(package)
    layers = {module: layer_of(module) for module in graph}
    assert [module for module, layer in layers.items() if layer is None] == []
    upwards = [
        f"{module} imports {other}"
        for module, others in graph.items()
        for other in others
        if layers[other] > layers[module]  # type: ignore[operator]
    ]
    assert upwards == []


@pytest.mark.parametrize("folder", ["routers", "results", "figures", "experiment", "cli"])
def test_no_learner_is_named_outside_its_folder(folder: str) -> None:
    learners = set(registry.names("learner"))
    assert "dqn" in learners
    for file in (Path(policies.__file__).parent / folder).rglob("*.py"):
        nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        constants = {node.value for node in nodes if isinstance(node, ast.Constant)}
        assert not learners & constants, file


def test_dependencies_are_the_declared_ones() -> None:
    """Whatever is imported is the standard library, the package itself or in pyproject.toml."""
    declared = {
        "gymnasium",
        "llvmlite",
        "numba",
        "numpy",
        "pettingzoo",
        "yaml",
    }
    allowed = declared | OPTIONAL | {"marouting"} | sys.stdlib_module_names
    for file in FILES:
        # What users name, and the package's own modules when they are first used.
        named = {"?"} if file in (ROOT / "registry.py", ROOT / "__init__.py") else set()
        assert set(imports(ast.parse(file.read_text("utf-8")))) <= allowed | named


def test_every_public_name_is_there() -> None:
    """Names are imported when first used, so that a wrong module would show only then."""
    code = (
        "import marouting; print([getattr(marouting, name) is None for name in marouting.__all__])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.count("False") == len(marouting.__all__)
    assert set(marouting._HOMES) <= set(marouting.__all__) <= set(dir(marouting))
    with pytest.raises(AttributeError, match="module 'marouting' has no attribute 'missing'"):
        marouting.missing  # noqa: B018


def test_the_command_imports_what_it_needs(tmp_path: Path) -> None:
    """Routing needs no environment and no SciPy; judging routes without loops no compiler."""
    problem, routes = tmp_path / "p.gr", tmp_path / "p.solution"
    marouting.generate(1)[0].write(problem)
    route = ["route", str(problem), "--router", "pathfinder", "--out", str(routes)]
    for command, heavy in (
        (route, ("gymnasium", "pettingzoo", "scipy.linalg", "torch")),
        (["evaluate", str(problem), str(routes)], ("gymnasium", "pettingzoo", "scipy", "numba")),
    ):
        done = subprocess.run(
            [sys.executable, "-X", "importtime", "-m", "marouting", *command],
            capture_output=True, text=True, check=True, timeout=300,
        )  # fmt: skip
        imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
        assert "marouting.problem.problem" in imported
        assert imported.isdisjoint(heavy)


def test_the_plain_environments_need_no_compiler() -> None:
    """Importing, making, resetting and a first step, in every interface and with options."""
    code = """
        import sys, time
        import gymnasium, marouting
        from marouting import global_routing_v0 as game
        env = game.env()
        env.reset(seed=0)
        env.last()
        env.step(4)
        spent = time.process_time()
        problem = {"nets": 5, "max_pins": 3, "seed": 1, "reduced_edges": 0}
        options = {"rip_up": {"rounds": 1}, "target": "tree", "overflow": "allowed", "max_steps": 9}
        env = game.parallel_env(problem, reward={"kind": "team", "open": 2}, **options)
        env.reset()
        while env.agents:
            env.step(dict.fromkeys(env.agents, 0))
        env.state(), env.solution()
        gymnasium.make(marouting.ENVIRONMENT_ID, problem=problem).reset()
        print([name for name in ("numba", "torch") if name in sys.modules], spent)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    loaded, _, spent = done.stdout.strip().rpartition(" ")
    assert loaded == "[]"
    assert float(spent) < 2  # seconds of processor time; a compiler takes tens of them


@pytest.mark.parametrize(
    "use",
    [
        "import marouting",
        "import gymnasium, marouting; gymnasium.make(marouting.ENVIRONMENT_ID).reset()",
        "import marouting; marouting.sequential_astar(marouting.generate(1)[0])",
    ],
)
def test_a_fresh_process_loads_neither_torch_nor_policies(use: str) -> None:
    """Transitively: what the imports of the imports bring in."""
    unwanted = sorted(FORBIDDEN | OPTIONAL)
    code = f"{use}; import sys; print([name for name in {unwanted} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.strip() == "[]"
