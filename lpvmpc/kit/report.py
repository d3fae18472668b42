"""Reports as they are written: Markdown to read, CSV and JSON with every number, one picture."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import date
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpvmpc.kit.files import replacing, write_json, write_picture, write_text
from lpvmpc.kit.provenance import commit, machine, versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_report(
    folder: Path,
    name: str,
    *,
    text: str,
    table: str,
    values: object = None,
    copy: Path | None = None,
    picture: Figure | None = None,
    pictures: Mapping[str, Figure] | None = None,
    dpi: int = 200,
) -> list[Path]:
    """Write NAME.md, NAME.csv and, where they are given, NAME.json and NAME.png.

    They replace earlier ones all together.

    Args:
        folder: Where they go; it must be there.
        name: Name of the files, without a suffix.
        text: The report.
        table: Every number, as `csv_text` gives it.
        values: The same as a value for JSON.
        copy: A second place for these values, with another name perhaps.
        picture: The picture.
        pictures: More of them, by the names of their files.
        dpi: Their resolution [dots per inch].

    Returns:
        The files in the folder.

    Raises:
        OutputError: One of them cannot be written.
    """
    names = [f"{name}.md", f"{name}.csv"]
    if values is not None:
        names.append(f"{name}.json")
    drawn = {} if picture is None else {f"{name}.png": picture}
    drawn.update(pictures or {})
    names += drawn
    with replacing(folder, names) as new:
        write_text(new / names[0], text)
        write_text(new / names[1], table)
        if values is not None:
            write_json(new / names[2], values)
        for file, figure in drawn.items():
            write_picture(new / file, figure, dpi)
    if copy is not None and values is not None:
        write_json(copy, values)
    return [folder / file for file in names]


def csv_text(header: Sequence[str], rows: Iterable[Iterable[object]], digits: int = 6) -> str:
    """Rows as CSV: numbers with so many significant digits, nothing for None.

    Args:
        header: Names of the columns, with their units.
        rows: Cells, each row as long as the header.
        digits: Significant digits of numbers that are not whole; text stays as it is.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    for row in rows:
        writer.writerow(f"{x:.{digits}g}" if isinstance(x, float) else x for x in row)
    return text.getvalue()


def at_a_time(jobs: int) -> str:
    """How many runs were driven at a time, in words; 0: one for each CPU of a Ray cluster."""
    return "one run for each CPU of a Ray cluster" if jobs == 0 else (
        f"{jobs} run{'s' if jobs > 1 else ''} at a time"
    )


def versions_line() -> str:
    """Versions, commit and day, in one line."""
    used = ", ".join(f"{name} {number}" for name, number in versions().items())
    return f"Versions: {used}; commit {commit() or 'unknown'}; {date.today().isoformat()}."


def record(**more: Any) -> dict[str, Any]:
    """Under which conditions numbers were made, for JSON: machine, versions, commit, and more."""
    return {**more, "machine": machine(), "versions": versions(), "commit": commit()}


def finite(value: Any) -> Any:
    """A value that JSON can hold: None for a number that is not finite."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def page_of(package: str, template: str, data: Any, parts: Mapping[str, str]) -> str:
    """An HTML page that needs nothing else: a template, filled.

    A template marks with `@NAME@` where its parts go. `@STYLE@` is the style that all pages share,
    and `@DATA@` goes into a script of type application/json, which no text of the data can end.

    Args:
        package: The package in which the template lies, as `lpvmpc.picture`.
        template: Its file.
        data: What JSON can hold, for the page's script.
        parts: Further parts by their name in capitals: HTML, put in as it is.

    Raises:
        ValueError: A number of the data is not finite.
    """
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    style = (resources.files("lpvmpc.kit") / "page.css").read_text("utf-8").rstrip("\n")
    found = {"STYLE": style, "DATA": text, **parts}
    source = (resources.files(package) / template).read_text("utf-8")
    return re.sub(r"@([A-Z]+)@", lambda mark: found[mark[1]], source)
