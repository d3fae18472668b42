"""Reports written by scripts: tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def markdown_table(title: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table under one line of title, columns padded so that diffs stay readable.

    Args:
        title: What the table shows; also keeps `git diff` of two reports readable.
        header: Column names, shape (n,); the first column is left-aligned, the others right.
        rows: Cells, each row of shape (n,).
    """
    cells = [[str(cell) for cell in header], *([str(cell) for cell in row] for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    lines = [
        "| " + " | ".join(
            cell.ljust(w) if i == 0 else cell.rjust(w)
            for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        ) + " |"
        for row in cells
    ]  # fmt: skip
    rule = "|" + "|".join(
        "-" * (w + 2) if i == 0 else "-" * (w + 1) + ":" for i, w in enumerate(widths)
    ) + "|"  # fmt: skip
    return "\n".join([f"**{title}**", "", lines[0], rule, *lines[1:], ""])
