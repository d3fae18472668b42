"""What a report claims: figures with limits, whose verdicts follow from the two, and tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lpvmpc.kit.markdown import markdown_table


@dataclass(frozen=True)
class Limit:
    """What a figure must be: an interval, both ends allowed. A value that is NaN never passes."""

    low: float
    """Smallest allowed value, -inf for none."""
    high: float
    """Largest allowed value, inf for none."""
    text: str
    """The interval as it is printed."""

    def __post_init__(self) -> None:
        """An empty interval is our own mistake."""
        assert self.low <= self.high, self

    def allows(self, value: float) -> bool:
        """Whether the value lies inside."""
        return bool(self.low <= value <= self.high)

    @property
    def is_lower(self) -> bool:
        """Whether it has a lower end alone."""
        return self.high == math.inf

    @property
    def bound(self) -> float:
        """The only end of a one-sided limit."""
        return self.low if self.is_lower else self.high

    @classmethod
    def at_most(cls, high: float, digits: int = 4) -> Limit:
        """No more than this."""
        return cls(-math.inf, float(high), f"<= {high:.{digits}g}")

    @classmethod
    def at_least(cls, low: float, digits: int = 4) -> Limit:
        """No less than this."""
        return cls(float(low), math.inf, f">= {low:.{digits}g}")

    @classmethod
    def between(cls, low: float, high: float) -> Limit:
        """An interval."""
        return cls(float(low), float(high), f"{low:.4g} to {high:.4g}")

    @classmethod
    def near(cls, expected: float, tolerance: float) -> Limit:
        """An expected value, and how far off it may be, in its unit."""
        text = f"{expected:.4g} +- {tolerance:.3g}"
        return cls(float(expected - tolerance), float(expected + tolerance), text)

    @classmethod
    def percent(cls, expected: float, percent: float) -> Limit:
        """An expected value, and how far off it may be, in percent of it."""
        off = abs(expected) * percent / 100.0
        text = f"{expected:.4g} +- {percent:g} %"
        return cls(float(expected - off), float(expected + off), text)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One figure with its limit; the verdict follows from the two."""

    key: str = ""
    """Its name in files, where it has one."""
    figure: str
    """What was measured, in a few words."""
    value: float | None
    """The measured value; None where it was not measured."""
    unit: str = ""
    """Its unit; empty for a pure number."""
    limit: Limit | None
    """What it must be; None where that is not known, because it depends on another figure."""
    why: str = ""
    """Where the limit comes from, in one line; never from the result."""

    @property
    def ok(self) -> bool | None:
        """The verdict; None where the value was not measured or the limit is not known."""
        if self.value is None or self.limit is None:
            return None
        return self.limit.allows(self.value)


@dataclass(frozen=True)
class Table:
    """Numbers for a report, written as Markdown and as CSV."""

    name: str
    """Part of the file name, in lower case with hyphens."""
    caption: str
    """One line above the table."""
    header: Sequence[str]
    """Names of the columns with their units."""
    rows: Sequence[Sequence[object]]
    """Cells; numbers are printed with four digits."""

    def cells(self) -> list[list[str]]:
        """All cells as text."""
        return [[number_text(value) for value in row] for row in self.rows]


def number_text(value: object, digits: int = 4) -> str:
    """A value as text: numbers with so many significant digits, truth as yes or no."""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return f"{value:.{digits}g}"
    return str(value)


def promises_table(
    title: str, found: Sequence[Finding], show: Callable[[float], str] = "{:.3g}".format
) -> str:
    """The findings that were measured, with limit and verdict, as Markdown.

    Args:
        title: Line above the table.
        found: The findings.
        show: A value as text.
    """
    body = [
        (f.figure, show(f.value), f.limit.text, f.unit, "met" if f.ok else "MISSED")
        for f in found
        if f.value is not None and f.limit is not None
    ]
    return markdown_table(title, ("figure", "value", "limit", "unit", "verdict"), body)


def promises_sentence(found: Sequence[Finding]) -> str:
    """How many promises are met, and which are not."""
    measured = [f for f in found if f.ok is not None]
    bad = [f.figure for f in measured if not f.ok]
    rest = f"; {len(found) - len(measured)} were not measured" if len(measured) < len(found) else ""
    if not bad:
        return f"All {len(measured)} promises that were measured are met{rest}."
    met = len(measured) - len(bad)
    return f"{met} of {len(measured)} are met, not met: {'; '.join(bad)}{rest}."
