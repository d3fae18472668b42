"""A trace as CSV: one line a control instant, a column each, every digit kept."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lpvmpc.kit.files import whole

if TYPE_CHECKING:
    from lpvmpc.sim.log import Log


def write_csv(log: Log, file: Path) -> None:
    """Write the trace's columns, and the step's time `step_us` beside them.

    Numbers are written so that reading gives the same number again; what is not known is nan. The
    times of a call of the controller that has no row, since it failed, are left out.

    Raises:
        OutputError: The file cannot be written.
    """
    columns = {**log.columns, "step_us": log.timing["step_us"][: len(log)]}
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    with whole(file) as part, part.open("w", encoding="utf-8", newline="") as text:
        text.write(",".join(columns) + "\n")
        for row in rows:
            text.write(",".join(str(int(x)) if isinstance(x, bool) else str(x) for x in row) + "\n")
