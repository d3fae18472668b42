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
