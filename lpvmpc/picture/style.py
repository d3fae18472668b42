"""The house style of all figures: colours, sizes, and a few strokes that they share.

matplotlib is imported on first use, pyplot never: no display and no global state are needed.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

P = ParamSpec("P")
T = TypeVar("T")

BLUE, SKY, GREEN, ORANGE, RED, PINK, GREY = (
    "#0072B2", "#56B4E9", "#009E73", "#E69F00", "#D55E00", "#CC79A7", "#6E6E6E")
"""Colours of Okabe and Ito, told apart with every common colour-vision deficiency, and a grey."""

RUNS = (BLUE, RED, GREEN, ORANGE, PINK, SKY)
"""Colours of runs that are compared, in their order."""

COLUMN, DOUBLE = 3.46, 7.13
"""Widths of one and of two columns [inch]."""

STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans", "font.size": 7.5, "axes.titlesize": 8.0,
    "axes.titlelocation": "left", "axes.labelsize": 7.5, "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0, "legend.fontsize": 6.8, "legend.frameon": False,
    "legend.handlelength": 1.6, "legend.borderaxespad": 0.2, "axes.spines.top": False,
    "axes.spines.right": False, "axes.linewidth": 0.6, "xtick.major.width": 0.6,
    "ytick.major.width": 0.6, "lines.linewidth": 1.0, "axes.grid": True, "grid.color": "#DDDDDD",
    "grid.linewidth": 0.5, "axes.axisbelow": True,
    "figure.constrained_layout.use": True,
}
DPI = 300
"""Resolution of the files [dots per inch]."""


def styled(draw: Callable[P, T]) -> Callable[P, T]:
    """Draw in the house style, whatever the caller's settings are."""

    @functools.wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> T:
        import matplotlib

        with matplotlib.rc_context({**matplotlib.rcParamsDefault, **STYLE}):
            return draw(*args, **kwargs)

    return drawn


def blank(width: float, height: float) -> Figure:
    """An empty figure, sizes in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


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
    figure = blank(width, height)
    return figure, figure.subplots(rows, columns, **options)


def label(axis: Axes, x: str, y: str, title: str = "") -> None:
    """Names of the axes, with units, and a title."""
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    if title:
        axis.set_title(title)


def y_label(axis: Axes, text: str, *, legend: int = 0, zero: bool = False) -> None:
    """Label of y, room for a legend of `legend` columns above the curves, a line at zero."""
    axis.set_ylabel(text)
    if zero:
        axis.axhline(0.0, color=GREY, lw=0.5, zorder=1)
    if legend:
        low, high = axis.get_ylim()
        axis.set_ylim(low, high + 0.25 * (high - low))
        axis.legend(loc="upper left", ncols=legend)


def peak(values: Any) -> float:
    """Largest magnitude of the finite values, never zero."""
    values = np.asarray(values, dtype=float)
    return max(float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0)), 1e-9)


def limit_line(axis: Axes, y: float, text: str = "limit", **options: Any) -> None:
    """A horizontal limit: dashed, red."""
    axis.axhline(y, **{"color": RED, "lw": 0.9, "ls": (0, (4, 2)), "label": text, **options})


def limit_band(axis: Axes, x: Any, low: Any, high: Any, text: str = "tolerance") -> None:
    """The allowed band around an expected curve: shaded."""
    axis.fill_between(x, low, high, color=RED, alpha=0.15, lw=0.0, label=text)
