"""The pages of the site that do not lie in docs/: mkdocs calls this while it builds.

README.md is the first page; examples become pages of their own; CONTRIBUTING.md, CHANGELOG.md and
the cards of the cars come along. A link to any other file of the project leads to a page that
shows it, a link to a folder to one that lists it. So a page is written once, and its links are
those that work in the source tree.
"""

from __future__ import annotations

import ast
import os
import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
LINK = re.compile(r"(\]\()([^)#\s]+)(#[^)\s]*)?(\))")
ELSEWHERE = re.compile(r"<(?!a\b)\w+[^>]*\b(?:src|href)=[\"']?(?:https?:)?//[^>]*>")
PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "models/README.md": "cars/zoe.md",
    "cars/README.md": "cars/index.md",
    "examples/README.md": "examples/index.md",
}
"""Files of the project, and what the site calls them; `_moved` adds cars and examples."""
NAMES = {".py": "python", ".toml": "toml", ".cff": "yaml", ".xml": "xml", ".sh": "sh"}
"""Languages of files that are shown, by their endings."""


def _moved() -> dict[str, str]:
    """Every page that comes from outside of docs/: its file, and its place in the site."""
    cards = {f"cars/{card.parent.name}/README.md": f"cars/{card.parent.name}.md"
             for card in sorted(ROOT.glob("cars/*/README.md"))}
    examples = {f"examples/{file.name}": f"examples/{file.stem}.md"
                for file in sorted(ROOT.glob("examples/*.py"))}
    return {**PAGES, **cards, **examples}


def on_config(config: Any) -> Any:
    """Fill the menu: a folder's name with a slash stands for all of its pages."""
    config.nav = [_filled(entry) for entry in config.nav]
    return config


def _filled(entry: Any) -> Any:
    """An entry of the menu, with the pages of the folders that it names."""
    if not isinstance(entry, dict):
        return entry
    (title, inside), = entry.items()
    if not isinstance(inside, list):
        return entry
    pages: list[Any] = []
    for one in inside:
        if isinstance(one, str) and one.endswith("/"):
            pages += _folder(one)
        else:
            pages.append(_filled(one))
    return {title: pages}


def _folder(name: str) -> list[str]:
    """The pages of a folder of the site, but for its index."""
    pages = {place for place in _moved().values() if place.startswith(name)}
    pages |= {file.relative_to(ROOT / "docs").as_posix()
              for file in (ROOT / "docs" / name).glob("*.md")}
    return sorted(pages - {f"{name}index.md"})


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that lie elsewhere, and whatever the pages link to."""
    for page in sorted((ROOT / "docs" / "results").glob("*.html")):
        source = page.relative_to(ROOT).as_posix()
        files.append(_page(source, _place(source), config))
    for source, place in _moved().items():
        files.append(_page(source, place, config))
    for file in [*files.documentation_pages()]:
        for match in LINK.finditer(file.content_string):
            target = _target(_source(file), match[2])
            if target is not None and files.get_file_from_path(place := _place(target)) is None:
                files.append(_page(target, place, config))
    for file in sorted(ROOT.glob("examples/notebooks/*")):
        source = file.relative_to(ROOT).as_posix()
        files.append(_page(source, _place(source), config))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let links lead to where their files are in the site."""
    here = page.file.src_uri

    def led(match: re.Match[str]) -> str:
        target = _target(_source(page.file), match[2])
        if target is None:
            return match[0]
        link = posixpath.relpath(_place(target), posixpath.dirname(here) or ".")
        return f"{match[1]}{link}{match[3] or ''}{match[4]}"

    return LINK.sub(led, markdown)


def on_post_build(config: Any) -> None:
    """Refuse pages that load something from elsewhere: the site is read from the disk as well."""
    for page in sorted(Path(config.site_dir).rglob("*.html")):
        if found := ELSEWHERE.search(page.read_text(encoding="utf-8")):
            raise PluginError(f"{page} loads something from elsewhere: {found[0]}")


def _source(file: File) -> str:
    """The file of the project that a page is made of."""
    moved = {place: source for source, place in _moved().items()}
    return moved.get(file.src_uri, f"docs/{file.src_uri}")


def _target(source: str, link: str) -> str | None:
    """The file or folder of the project that a link means; None: it leads out of it, or nowhere."""
    if "://" in link or link.startswith("mailto:"):
        return None
    target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link))
    return target if not target.startswith("..") and (ROOT / target).exists() else None


def _place(target: str) -> str:
    """Where a file or folder of the project is in the site."""
    moved = _moved()
    if target in moved:
        return moved[target]
    path, inside = ROOT / target, target.removeprefix("docs/")
    where = inside if inside != target else f"source/{target}"
    if path.is_dir():
        return f"{where}/index.md"
    if inside != target and path.suffix == ".html":  # a report's own: its page has the name
        return f"interactive/{path.name}"
    return f"{where}.md" if inside == target and _readable(path) else where


def _readable(path: Path) -> bool:
    """Whether a file is shown on a page of its own: text, and no page already."""
    return path.suffix in NAMES or not path.suffix


def _page(source: str, place: str, config: Any) -> File:
    """A page, or a file that is copied."""
    path = ROOT / source
    if path.is_dir():
        return File.generated(config, place, content=_listed(path))
    if place.endswith(".md") and path.suffix != ".md":
        return File.generated(config, place, content=_shown(path, source))
    return File.generated(config, place, abs_src_path=os.fspath(path))


def _shown(path: Path, source: str) -> str:
    """A page that shows a file: a script's docstring as text, then the script."""
    text, about = path.read_text(encoding="utf-8"), ""
    title, hidden = source, "---\nhide: [toc]\n---\n"  # lines of 100 characters want the room
    if source.startswith("examples/"):
        title = path.stem.replace("_", " ").capitalize()
        about = (ast.get_docstring(ast.parse(text)) or "") + "\n\n"
        twin = f"examples/notebooks/{path.stem}.ipynb"
        if (ROOT / twin).exists():
            about += f"[The same as a notebook](../{_place(twin)}).\n\n"
        text = text.split('"""', 2)[2].lstrip()
    code = f"```{NAMES.get(path.suffix, 'text')}\n{text.rstrip()}\n```\n"
    return f"{hidden}# {title}\n\n{about}{code}"


def _listed(folder: Path) -> str:
    """A page that lists the files of a folder: pages by their titles, then the others."""
    pages: list[str] = []
    others: dict[str, list[str]] = {}
    for file in sorted(folder.rglob("*")):
        if not file.is_file() or file.name.startswith("."):
            continue
        name = file.relative_to(folder).as_posix()
        here = _place(folder.relative_to(ROOT).as_posix())
        place = _place(file.relative_to(ROOT).as_posix())
        link = posixpath.relpath(place, posixpath.dirname(here))
        if file.suffix == ".md":
            title = file.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
            pages.append(f"- [{title}]({link})")
        else:
            others.setdefault(posixpath.dirname(name), []).append(f"[{file.name}]({link})")
    files = ["## Files", ""] if pages else []
    for sub, links in others.items():
        files += [f"{sub or 'Here'}: {', '.join(links)}", ""]
    title = folder.relative_to(ROOT).as_posix().removeprefix("docs/").capitalize()
    return "\n".join([f"# {title}", "", *pages, "", *files]) + "\n"
