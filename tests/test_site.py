"""The documentation site: it builds without a warning, and a page needs nothing from elsewhere."""

import importlib
import os
import re
import shutil
import subprocess
import sys
from dataclasses import fields
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType

import pytest
import yaml

import marouting
from marouting.options import GameOptions

ROOT = Path(__file__).resolve().parents[1]
SITE = ROOT / ".site"
LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "video": "src"}
LINKS_THAT_LOAD = {"stylesheet", "icon", "preload", "preconnect", "dns-prefetch", "manifest"}


class Loads(HTMLParser):
    """What a browser fetches to show a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.urls: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        if tag in LOADED:
            self.urls.append(given.get(LOADED[tag], ""))
        if tag == "link" and LINKS_THAT_LOAD & set(given.get("rel", "").split()):
            self.urls.append(given["href"])


@pytest.fixture
def environment(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(SITE))
    return importlib.import_module("environment")


def test_the_environment_page_has_every_option(environment: ModuleType) -> None:
    page = environment.PAGE.read_text(encoding="utf-8")
    assert page == environment.page(), "run: python .site/environment.py"
    described = re.findall(r"^\| `(\w+)` \| `.*?` \| .", page, re.MULTILINE)
    assert sorted(described) == sorted(field.name for field in fields(GameOptions))


def test_the_reference_has_every_public_name() -> None:
    pages = yaml.safe_load((SITE / "reference.yml").read_text(encoding="utf-8")).values()
    listed = {name for page in pages for name in page["names"]}
    spread = {"global_routing_v0": ("env", "raw_env", "parallel_env"), "vector": ("BatchEnv",)}
    for name in marouting.__all__:
        expected = [f"{name}.{part}" for part in spread.get(name, ())] or [name]
        assert {f"marouting.{part}" for part in expected} <= listed, name


def build(root: Path, out: Path) -> list[str]:
    """Builds the site of a checkout as CONTRIBUTING.md says; returns the warnings.

    A name of the reference that is not there is one.
    """
    for module in ("mkdocs", "material", "mkdocstrings_handlers.python"):
        pytest.importorskip(module)
    done = subprocess.run(
        [
            *(sys.executable, "-m", "mkdocs", "build", "--strict"),
            *("--config-file", str(root / ".site" / "mkdocs.yml"), "--site-dir", str(out)),
        ],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=False,
    )
    warnings = re.findall(r"^(?:WARNING|ERROR) +- +(.*)$", done.stderr, re.MULTILINE)
    assert bool(warnings) == (done.returncode != 0), done.stderr
    return warnings


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site")
    assert build(ROOT, out) == []
    return out


@pytest.mark.slow
def test_pages_load_nothing_from_elsewhere(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 40
    for page in pages:
        for url in Loads(page.read_text(encoding="utf-8")).urls:
            assert not re.match(r"[a-z]*:?//", url), f"{page}: {url}"
            path = url.partition("?")[0].partition("#")[0]
            if path and not url.startswith("data:") and page.name != "404.html":
                assert (page.parent / path).exists(), f"{page}: {url}"
    for sheet in site.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        assert not re.search(r"(@import|url\()\s*[\"']?(https?:)?//", text), sheet


@pytest.mark.slow
def test_nothing_of_the_markdown_is_left(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        text = re.sub(r"<(script|style|pre|code)\b.*?</\1>", "", text, flags=re.DOTALL)
        shown = re.sub(r"<[^>]+>", "", text)
        found = re.search(r"\|:?--|\]\(|\]\[|\*\*|```|^ *::: ", shown, re.MULTILINE)
        assert not found, f"{page}: {shown[found.start() - 50 : found.end() + 50]}"


@pytest.mark.slow
def test_pages_show_what_they_should(site: Path) -> None:
    texts = {
        name: re.sub(r"\s+", " ", re.sub(r"<[^>]+>", "", (site / name).read_text(encoding="utf-8")))
        for name in (
            "environment.html", "guide.html", "reference/problems.html", "reference/cli.html",
            "own-components.html", "source/marouting/batch/rules.py.html",
            "notes/leaderboard.html",
        )
    }  # fmt: skip
    assert "All rules of the game, compiled." in texts["source/marouting/batch/rules.py.html"]
    assert "Judges a solution by the rules" in texts["reference/problems.html"]
    assert "--budget" in texts["reference/cli.html"]
    assert "rip_up.neighbours" in texts["environment.html"]
    for name, text in texts.items():
        assert name.startswith("source/") or not re.search(
            r":(class|func|meth|mod|data|attr):`", text
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "text", "warning"),
    [
        ("index.md", "[x](nowhere.md)", "nowhere.md"),
        ("index.md", "[x](paper.md#no-such-heading)", "no-such-heading"),
        ("index.md", "[x](../marouting/nowhere.py)", "nowhere.py"),
        ("unlisted.md", "# A page", 'not included in the "nav"'),
    ],
)
def test_a_wrong_link_or_page_is_a_warning(
    page: str, text: str, warning: str, tmp_path: Path
) -> None:
    for name in ("docs", ".site", "marouting", "policies", "configs", "tests"):
        shutil.copytree(ROOT / name, tmp_path / name)
    for file in ROOT.glob("*.md"):
        shutil.copy(file, tmp_path)
    with (tmp_path / "docs" / page).open("a", encoding="utf-8") as file:
        file.write(f"\n\n{text}\n")
    (said,) = build(tmp_path, tmp_path / "out")
    assert warning in said
