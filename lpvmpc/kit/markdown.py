"""Reports written by scripts: tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def markdown_table(
    title: str, header: Sequence[str], rows: Iterable[Sequence[object]], words: Sequence[str] = ()
) -> str:
    """A Markdown table under one line of title, columns padded so that diffs stay readable.

    Args:
        title: What the table shows; also keeps `git diff` of two reports readable.
        header: Column names, shape (n,); the first column is left-aligned, the others right.
        rows: Cells, each row of shape (n,).
        words: Names of further columns that hold text, and are left-aligned too.
    """
    cells = [[str(cell) for cell in header], *([str(cell) for cell in row] for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    left = [i == 0 or name in words for i, name in enumerate(header)]
    lines = [
        "| " + " | ".join(
            cell.ljust(w) if is_text else cell.rjust(w)
            for cell, w, is_text in zip(row, widths, left, strict=True)
        ) + " |"
        for row in cells
    ]
    rule = "|" + "|".join(
        "-" * (w + 2) if is_text else "-" * (w + 1) + ":"
        for w, is_text in zip(widths, left, strict=True)
    ) + "|"
    return "\n".join([f"**{title}**", "", lines[0], rule, *lines[1:], ""])
