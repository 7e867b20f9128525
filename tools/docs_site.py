"""Pages of the documentation site that are made from other files, and a check of the site.

MkDocs calls `on_files`: the README becomes the first page, the commands' help and the public
names of the package become the reference, so neither can differ from the code. It calls
`on_page_content` with the HTML of each page. Run as a script, it makes sure that the finished
site loads nothing from another host and shows no escaped bar.
"""

from __future__ import annotations

import argparse
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
WIDTH = 100


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made here."""
    from mkdocs.structure.files import File

    pages = {
        "index.md": moved("README.md"),
        "changelog.md": moved("CHANGELOG.md"),
        "contributing.md": moved("CONTRIBUTING.md"),
        "reference/commands.md": commands(),
        "reference/python.md": public_names(),
    }
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Remove the backslash of an escaped bar in code inside a table.

    A table in Markdown needs `\\|` there. GitHub shows a bar, Python-Markdown both characters.
    """
    return re.sub(r"<td.*?</td>", lambda cell: cell.group(0).replace("\\|", "|"), html, flags=re.S)


def moved(name: str) -> str:
    """A page of the repository's root as a page of the site: links into docs/ become its own.

    Links to other files of the repository keep their text alone: the site does not hold them.
    """
    text = (ROOT / name).read_text(encoding="utf-8")
    own = {"CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}

    def link(found: re.Match[str]) -> str:
        image, shown, target = found.groups()
        path, _, anchor = target.partition("#")
        anchor = f"#{anchor}" if anchor else ""
        if "://" in target or not path:
            return found.group(0)
        if path.startswith("docs/"):
            return f"{image}[{shown}]({path.removeprefix('docs/')}{anchor})"
        if path in own:
            return f"{image}[{shown}]({own[path]}{anchor})"
        return shown

    return re.sub(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)", link, text)


def commands() -> str:
    """The help of every command, as the command line prints it."""
    import typer

    from fieldgrid.cli import app
    from fieldgrid.cli.listing import SHOWS_ALL

    group = typer.main.get_command(app)
    parts = ["# Commands", "", "Made from the command line itself: `fieldgrid COMMAND --help-all`."]
    context = typer.Context(
        group, info_name="fieldgrid", max_content_width=WIDTH, terminal_width=WIDTH
    )
    for name in group.list_commands(context):  # type: ignore[attr-defined]
        command = group.get_command(context, name)  # type: ignore[attr-defined]
        own = typer.Context(
            command, info_name=name, parent=context, max_content_width=WIDTH, terminal_width=WIDTH
        )
        own.meta[SHOWS_ALL] = True
        parts += ["", f"## fieldgrid {name}", "", "```text", command.get_help(own).strip(), "```"]
    return "\n".join(parts) + "\n"


def public_names() -> str:
    """A reference entry for each public name of the package."""
    import fieldgrid

    parts = ["# Python", "", "Everything below is imported as `fieldgrid.NAME`."]
    for name in sorted(dir(fieldgrid), key=str.lower):
        home = getattr(fieldgrid, name)
        module = getattr(home, "__module__", None)
        target = f"{module}.{name}" if module else home.__name__
        parts += ["", f"::: {target}"]
    return "\n".join(parts) + "\n"


class _Loads(HTMLParser):
    """What a page makes a browser load: not links that a reader follows."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {key: value or "" for key, value in attrs}
        if tag in ("script", "img", "iframe", "source", "video"):
            self.found.append(values.get("src", ""))
        elif tag == "link" and values.get("rel") not in ("canonical", "prev", "next"):
            self.found.append(values.get("href", ""))


def foreign(site: Path) -> Iterator[str]:
    """What pages and style sheets of a site load from another host."""
    for page in sorted(site.rglob("*.html")):
        loads = _Loads()
        loads.feed(page.read_text(encoding="utf-8"))
        yield from (f"{page.relative_to(site)}: {url}" for url in loads.found if "//" in url)
    for sheet in sorted(site.rglob("*.css")):
        for url in re.findall(r"url\(([^)]*)\)", sheet.read_text(encoding="utf-8")):
            if "//" in url and "data:" not in url:
                yield f"{sheet.relative_to(site)}: {url}"


def escaped(pages: list[Path]) -> Iterator[str]:
    """Cells of tables that show the backslash before a bar."""
    for page in pages:
        for cell in re.findall(r"<td.*?</td>", page.read_text(encoding="utf-8"), re.S):
            if "\\|" in cell:
                yield f"{page.name}: {cell}"


def main() -> None:
    """Exit 1 when the site has no page, loads something from another host, or shows an escape."""
    parser = argparse.ArgumentParser(description="Check a built documentation site.")
    parser.add_argument("site", type=Path)
    site = parser.parse_args().site
    pages = list(site.rglob("*.html"))
    problems = [*foreign(site), *escaped(pages)] if pages else [f"{site} has no page"]
    for problem in problems:
        print(problem, file=sys.stderr)
    print(f"{len(pages)} pages, {len(problems)} problems")
    sys.exit(bool(problems))


if __name__ == "__main__":
    main()
