"""Pictures of the studies in the house style of `lpvmpc.picture.style`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lpvmpc.picture.style import (
    BLUE,
    COLUMN,
    DOUBLE,
    DPI,
    GREEN,
    GREY,
    ORANGE,
    PINK,
    RED,
    SKY,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "BLUE", "COLUMN", "DOUBLE", "DPI", "GREEN", "GREY", "ORANGE", "PINK", "RED", "SKY",
    "axes", "label", "limit_band", "limit_line", "styled",
]

def axes(
    rows: int = 1, columns: int = 1, *, width: float = DOUBLE, height: float = 2.6, **options: Any
) -> tuple[Figure, Any]:
    """An empty figure with its axes; call it under `styled`.

    Args:
        rows: Rows of axes.
        columns: Columns of axes.
        width: [inch], COLUMN or DOUBLE.
        height: [inch].
        **options: Those of Figure.subplots.

    Returns:
        Figure, and one axes or an array of them, as Figure.subplots returns.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height))
    return figure, figure.subplots(rows, columns, **options)


def label(axis: Axes, x: str, y: str, title: str = "") -> None:
    """Names of the axes, with units, and a title."""
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    if title:
        axis.set_title(title)


def limit_line(axis: Axes, y: float, text: str = "limit", **options: Any) -> None:
    """A horizontal limit: dashed, red."""
    axis.axhline(y, **{"color": RED, "lw": 0.9, "ls": (0, (4, 2)), "label": text, **options})


def limit_band(axis: Axes, x: Any, low: Any, high: Any, text: str = "tolerance") -> None:
    """The allowed band around an expected curve: shaded."""
    axis.fill_between(x, low, high, color=RED, alpha=0.15, lw=0.0, label=text)
