"""Running studies, one after another or several at once, and saving what they made."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from lpvmpc.errors import LPVMPCError, OutputError
from lpvmpc.kit.files import into, write_picture, write_text
from lpvmpc.kit.findings import Limit, number_text
from lpvmpc.kit.report import csv_text
from lpvmpc.kit.workers import workers
from lpvmpc.studies.study import CarUnderTest, StudyResult, load_study

Progress = Callable[[StudyResult], None]

DIED = (
    "A process that ran a study was killed, perhaps for want of memory; fewer --jobs need less."
)


def conduct(
    names: Sequence[str],
    folder: Path,
    *,
    broken: str | None = None,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[StudyResult]:
    """Run studies and save their pictures and numbers.

    Args:
        names: Which, out of `names.STUDIES`.
        folder: Receives a PNG for each picture and a CSV for each table and series.
        broken: Name of a car of `names.BROKEN` to study (default: the packaged car).
        jobs: Number of processes.
        progress: Called with each result as soon as it is there.

    Returns:
        The results in the order of the names, their pictures without the figures.

    Raises:
        UnknownNameError: A study or a broken car does not exist.
        OutputError: The folder cannot be written.
    """
    for name in names:
        load_study(name)
    results = {}
    with workers(max(min(jobs, len(names)), 1), died=DIED) as pool:
        for result in pool.each(partial(conduct_one, folder=folder, broken=broken), names):
            results[result.study] = result
            if progress is not None:
                progress(result)
    return [results[name] for name in names]


def conduct_one(name: str, folder: Path, broken: str | None = None) -> StudyResult:
    """Run one study and save its pictures and numbers.

    A study that stops halfway, because a broken car cannot be driven, failed.
    """
    from lpvmpc.studies.reference.broken_cars import break_car

    car = CarUnderTest.packaged() if broken is None else break_car(broken)
    study = load_study(name)
    begin = time.process_time()
    try:
        result = study(car)
    except OutputError:
        raise
    except LPVMPCError as error:
        result = StudyResult(name, f"The study stopped: {error}")
        why = "a car that cannot be driven through the study is wrong"
        result.find("study came to its end", 0.0, "", Limit.at_least(1.0), why)
    result.seconds = time.process_time() - begin
    save(result, folder)
    result.pictures = [replace(picture, figure=None) for picture in result.pictures]
    return result


def save(result: StudyResult, folder: Path) -> None:
    """Write pictures as PNG, tables and series as CSV: `<study>-<name>` in the folder.

    Raises:
        OutputError: A file cannot be written.
    """
    from lpvmpc.picture.figures import DPI

    with into(folder):
        for picture in result.pictures:
            if picture.figure is not None:
                file = folder / f"{result.study}-{picture.name}.png"
                write_picture(file, picture.figure, DPI)
        for table in result.tables:
            file = folder / f"{result.study}-{table.name}.csv"
            write_text(file, csv_text(table.header, table.cells()))
        for series in result.series:
            columns = [np.asarray(column) for column in series.columns.values()]
            rows = ([number_text(x, 7) for x in row] for row in zip(*columns, strict=True))
            file = folder / f"{result.study}-{series.name}.csv"
            write_text(file, csv_text(list(series.columns), rows))
