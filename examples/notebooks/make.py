"""Write the examples as notebooks, into this folder: `python examples/notebooks/make.py`.

A script's docstring becomes a text, each of its functions, classes and paragraphs a cell, and what
stands below `if __name__ == "__main__":` is moved out of there. The scripts are what is edited; a
test holds the notebooks to them, and runs them.
"""

from __future__ import annotations

import ast
import json
import textwrap
from itertools import pairwise
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent
GUARD = 'if __name__ == "__main__":'


def scripts() -> list[Path]:
    """The examples that do something; a class alone, to be named on a command line, does not."""
    return [file for file in sorted(FOLDER.parent.glob("*.py")) if GUARD in file.read_text()]


def notebook(script: Path) -> str:
    """A script as a notebook, the JSON of format 4.5."""
    source = script.read_text(encoding="utf-8")
    about = ast.get_docstring(ast.parse(source)) or ""
    title, _, rest = about.partition("\n")
    cells = [("markdown", f"# {title}\n{rest}".rstrip())]
    above, _, below = source.partition(GUARD)
    for part in (above.split('"""', 2)[2], textwrap.dedent(below.partition("\n")[2])):
        cells += [("code", text) for text in paragraphs(part)]
    return json.dumps(_written(cells), indent=1, ensure_ascii=False) + "\n"


def paragraphs(source: str) -> list[str]:
    """Code cut at the empty lines between its statements; imports stay together."""
    lines, body = source.splitlines(), ast.parse(source).body
    imports = (ast.Import, ast.ImportFrom)
    starts = [0]
    for before, after in pairwise(body):
        apart = "" in lines[before.end_lineno : _first(after) - 1]
        if apart and not (isinstance(before, imports) and isinstance(after, imports)):
            starts.append(before.end_lineno or 0)
    ends = [*starts[1:], len(lines)]
    return ["\n".join(lines[a:b]).strip("\n") for a, b in zip(starts, ends, strict=True)]


def _first(statement: ast.stmt) -> int:
    """The line on which a statement begins, from 1, its decorators included."""
    decorators: list[ast.expr] = getattr(statement, "decorator_list", [])
    return min([statement.lineno, *(one.lineno for one in decorators)])


def _written(cells: list[tuple[str, str]]) -> dict[str, Any]:
    found = []
    for k, (kind, text) in enumerate(cells):
        cell: dict[str, Any] = {"cell_type": kind, "id": f"cell-{k}", "metadata": {},
                                "source": text.splitlines(keepends=True)}
        found.append(cell | ({"execution_count": None, "outputs": []} if kind == "code" else {}))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {"cells": found, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


if __name__ == "__main__":
    for script in scripts():
        file = FOLDER / f"{script.stem}.ipynb"
        file.write_text(notebook(script), encoding="utf-8")
        print(f"Wrote {file.relative_to(FOLDER.parents[1])}")
