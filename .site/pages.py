"""What MkDocs is told beside mkdocs.yml: pages from outside docs/, and links that lead out of it.

The Markdown files read well on GitHub as they are. On the site

* README.md, CONTRIBUTING.md and CHANGELOG.md are pages;
* a link to a source file or a folder leads to a page with its text or its files;
* code such as ``marouting.evaluate`` leads to the API reference, and ``marouting.batch.rules`` to
  the text of the module. The pages of the reference are made of reference.yml and the docstrings;
  that of the command line is what ``--help`` prints.
"""

import posixpath
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from docstrings import DOCUMENTED, REFERENCE, ROOT
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

DOCS = ROOT / "docs"
OUTSIDE = {
    "guide.md": "README.md",
    "contributing.md": "CONTRIBUTING.md",
    "changelog.md": "CHANGELOG.md",
}
"""Pages of files that lie outside docs/."""

FENCE = re.compile(r"^ *```.*?^ *```[^\n]*$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(\]\()([^)\s]+)(\))")
CODE = re.compile(r"(?<![\[`])`([a-z_.A-Z0-9]+)(\(…?\))?`(?![\]`])")
SPAN = re.compile(r"(`[^`\n]+`)")
STAR = re.compile(r"(?<=\bA)\*(?![\w*])")
LANGUAGES = {".py": "python", ".yaml": "yaml", ".yml": "yaml", ".toml": "toml"}


def on_config(config: MkDocsConfig) -> None:
    """Puts the pages of the reference into the navigation."""
    pages: list[Any] = ["reference/README.md"]
    pages += [{page["title"]: f"reference/{name}.md"} for name, page in REFERENCE.items()]
    pages.append({"Command line": "reference/cli.md"})
    for entry in config.nav or ():
        if "Reference" in entry:
            entry["Reference"] = pages


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Adds the pages that are no files of docs/."""
    made = {page: (ROOT / name).read_text(encoding="utf-8") for page, name in OUTSIDE.items()}
    texts = [(file.src_uri, file.content_string) for file in files.documentation_pages()]
    targets = {
        target
        for page, text in [*texts, *made.items()]
        for target in _links(page, text)
        if _is_source(target)
    }
    for name, page in REFERENCE.items():
        made[f"reference/{name}.md"] = _reference_page(page)
    made["reference/README.md"] = _reference_index()
    made["reference/cli.md"] = _command_line()
    for uri, text in made.items():
        files.append(File.generated(config, uri, content=text))
    for target in sorted(targets):
        file = File.generated(config, _source_uri(target), content=_source_page(target))
        file.inclusion = InclusionLevel.NOT_IN_NAV
        files.append(file)


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001
    """Turns the links of a page to what the site has in their places."""
    uri = page.file.src_uri
    if uri.startswith(("source/", "reference/")):
        return markdown
    folder = posixpath.dirname(uri)

    def turned(match: re.Match[str]) -> str:
        target, anchor = _target(uri, match[2])
        if target is None or not target.exists():
            return match[0]  # of another site, or missing, of which MkDocs warns
        return f"{match[1]}{posixpath.relpath(_uri_of(target), folder or '.')}{anchor}{match[3]}"

    def to_reference(match: re.Match[str]) -> str:
        if match[1] in DOCUMENTED:
            return f"[{match[0]}][{match[1]}]"
        module = _module(match[1])
        if module is None:
            return match[0]
        return f"[{match[0]}]({posixpath.relpath(_source_uri(module), folder or '.')})"

    def text(part: str) -> str:
        # GitHub knows that a star after a letter and before a comma cannot begin emphasis.
        pieces = SPAN.split(LINK.sub(turned, part))
        pieces[::2] = [STAR.sub(r"\\*", piece) for piece in pieces[::2]]
        part = "".join(pieces).replace("<details>", "<details markdown>")
        lines = part.split("\n")
        return "\n".join(
            line if line.startswith("#") else CODE.sub(to_reference, line) for line in lines
        )

    return _outside_fences(markdown, text)


def _outside_fences(markdown: str, change: Callable[[str], str]) -> str:
    """Markdown with everything but its fenced blocks changed."""
    done, start = [], 0
    for fence in FENCE.finditer(markdown):
        done += [change(markdown[start : fence.start()]), fence[0]]
        start = fence.end()
    return "".join([*done, change(markdown[start:])])


def _links(page: str, markdown: str) -> Iterator[Path]:
    """The files of this repository that a page links to, and the modules that it names."""
    text = FENCE.sub("", markdown)
    for match in LINK.finditer(text):
        target, _ = _target(page, match[2])
        if target is not None and target.exists():
            yield target
    for match in CODE.finditer(text):
        module = _module(match[1])
        if module is not None:
            yield module


def _module(name: str) -> Path | None:
    """The file of a module such as ``marouting.batch.rules``; None if it is something else."""
    if name.split(".")[0] not in ("marouting", "policies") or "." not in name:
        return None
    path = ROOT / name.replace(".", "/")
    files = (path.with_suffix(".py"), path / "__init__.py")
    return next((file for file in files if file.exists()), None)


def _target(page: str, link: str) -> tuple[Path | None, str]:
    """The path that a link of a page leads to, and its anchor; None if it leads elsewhere."""
    if re.match(r"[a-z]+:|#|/", link):
        return None, ""
    path, hash_, anchor = link.partition("#")
    home = ROOT / OUTSIDE[page] if page in OUTSIDE else DOCS / page
    return (home.parent / path).resolve(), hash_ + anchor


def _is_source(target: Path) -> bool:
    """Whether a file or folder needs a page to be seen on the site."""
    if target.is_dir():
        return True
    if target.suffix == ".md":
        return False
    return not target.is_relative_to(DOCS) or target.suffix == ".py"


def _uri_of(target: Path) -> str:
    """Where the site has a file of this repository, in MkDocs' terms."""
    if _is_source(target):
        return _source_uri(target)
    for page, name in OUTSIDE.items():
        if target == ROOT / name:
            return page
    return target.relative_to(DOCS).as_posix()


def _source_uri(target: Path) -> str:
    name = target.relative_to(ROOT).as_posix()
    return f"source/{name}/README.md" if target.is_dir() else f"source/{name}.md"


def _source_page(target: Path) -> str:
    """A page with the text of a file, or the files of a folder."""
    name = target.relative_to(ROOT).as_posix()
    title = f"---\nsearch: {{exclude: true}}\nhide: [navigation, toc]\n---\n\n# `{name}`\n\n"
    if target.is_file():
        language = LANGUAGES.get(target.suffix, "text")
        text = target.read_text(encoding="utf-8").rstrip()
        return f'{title}````{language} linenums="1"\n{text}\n````\n'
    listed = sorted(p for p in target.iterdir() if not p.name.startswith(("_", ".")))
    home = posixpath.dirname(_source_uri(target))
    lines = []
    for path in listed:
        published = path.is_file() and path.is_relative_to(DOCS) and path.suffix != ".py"
        uri = posixpath.relpath(path.relative_to(DOCS).as_posix(), home) if published else ""
        lines.append(f"- [{path.name}]({uri})" if published else f"- `{path.name}`")
    return title + "\n".join(lines) + "\n"


def _reference_page(page: dict[str, Any]) -> str:
    blocks = "\n\n".join(
        f"::: {name}" + ("\n    options: {members: false}" if _module(name) else "")
        for name in page["names"]
    )
    return f"# {page['title']}\n\n{page['about']}\n\n{blocks}\n"


def _reference_index() -> str:
    rows = "\n".join(
        f"| [{page['title']}]({name}.md) | {page['about']} | "
        + ", ".join(f"[`{n.rsplit('.', 1)[-1]}`][{n}]" for n in page["names"])
        + " |"
        for name, page in REFERENCE.items()
    )
    return (
        "# API reference\n\nMade of the docstrings. `marouting` is the environment, `policies` all "
        "that plays it.\nThe [command line](cli.md) has a page of its own.\n\n"
        f"| | | |\n|---|---|---|\n{rows}\n"
    )


def _command_line() -> str:
    """What every command prints for ``--help``."""
    import click

    from policies.cli.main import cli

    context = click.Context(cli, info_name="marouting")
    parts = ["# The command line\n\nWhat `marouting COMMAND --help` prints."]
    for name in cli.list_commands(context):
        command = cli.commands[name]
        inner = click.Context(command, parent=context, info_name=name, max_content_width=88)
        parts.append(f"## marouting {name}\n\n```text\n{command.get_help(inner)}\n```")
    return "\n\n".join(parts) + "\n"
