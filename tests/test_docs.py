"""The pages of the reference name every public name, and nothing that is not there.

`make docs` builds them, and refuses docstrings that do not fit their functions.
"""

import re
from importlib import import_module
from pathlib import Path

import pytest

import lpvmpc

PAGES = Path(__file__).parents[1] / "docs" / "reference"
NAMED = sorted({name for page in PAGES.glob("*.md")
                for name in re.findall(r"^::: (\S+)", page.read_text(), re.M)})


def found(name):
    """The module, class or function of a dotted name."""
    try:
        return import_module(name)
    except ModuleNotFoundError:
        module, _, attribute = name.rpartition(".")
        return getattr(import_module(module), attribute)


@pytest.mark.parametrize("name", NAMED)
def test_what_a_page_names_exists_and_says_what_it_is(name):
    assert found(name).__doc__


def test_every_public_name_has_its_place():
    for name in set(lpvmpc.__all__) - {"__version__"}:
        home = f"lpvmpc.{lpvmpc._HOME[name]}"
        places = {home, f"{home}.{name}"}
        places.add(f"{getattr(getattr(lpvmpc, name), '__module__', home)}.{name}")
        assert places & set(NAMED), name


def test_every_page_is_in_the_menu(root):
    text = (root / "mkdocs.yml").read_text().partition("\nnav:")[2]
    menu = re.findall(r"[\w/-]+\.md", text)
    pages = {page.relative_to(root / "docs").as_posix()
             for page in [*PAGES.glob("*.md"), *(root / "docs").glob("*.md")]}
    made = {"index.md", "changelog.md", "contributing.md", "cars/index.md", "examples/index.md",
            "results/index.md"}  # docs/pages.py makes them of what lies elsewhere
    assert sorted(menu) == sorted(pages | made)
    assert all(folder in text for folder in (" cars/]", " examples/]", " results/]"))


def anchors(page):
    """What its headings are called in an address."""
    heads = re.findall(r"^#+ (.*)$", page.read_text(), re.M)
    plain = (re.sub(r"[^\w\s-]", "", head.replace("`", "").strip().lower()) for head in heads)
    return {re.sub(r"\s", "-", head) for head in plain}


def test_every_link_between_pages_leads_somewhere(root):
    pages = [*root.glob("*.md"), *root.glob("docs/**/*.md"), *root.glob("cars/**/*.md"),
             *root.glob("examples/*.md"), *root.glob("models/*.md")]
    links = []
    for page in pages:
        text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.S | re.M)
        links += [(page, link) for link in re.findall(r"\]\(([^)\s]+)\)", text)
                  if not re.match(r"\w+:", link)]
    assert len(links) > 100
    dead = []
    for page, link in links:
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            dead.append((page.relative_to(root).as_posix(), link))
    assert dead == []
