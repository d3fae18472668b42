import json
import math

import pytest

from lpvmpc.errors import OutputError
from lpvmpc.kit.findings import Finding, Limit, promises_sentence, promises_table
from lpvmpc.kit.report import csv_text, finite, record, write_report


def finding(figure, value, limit):
    return Finding(figure=figure, value=value, unit="mm", limit=limit)


def test_a_verdict_needs_a_value_and_a_limit():
    low, high = Limit.at_least(1.5), Limit.at_most(2.0)
    assert [finding("x", v, high).ok for v in (2.0, 2.1, math.nan, None)] == [
        True, False, False, None,
    ]
    assert [finding("x", v, low).ok for v in (1.5, 1.4, math.inf)] == [True, False, True]
    assert finding("x", 1.0, None).ok is None
    assert (low.bound, low.is_lower, high.bound, high.is_lower) == (1.5, True, 2.0, False)
    assert Limit.at_most(1234.5, 3).text == "<= 1.23e+03"


def test_promises_are_told_in_a_table_and_a_sentence():
    good, bad = finding("one", 0.5, Limit.at_most(1.0)), finding("two", 3.0, Limit.at_most(1.0))
    unknown = finding("three", None, None)
    assert promises_sentence([good]) == "All 1 promises that were measured are met."
    assert promises_sentence([good, bad, unknown]) == (
        "1 of 2 are met, not met: two; 1 were not measured."
    )
    rows = [line.split() for line in promises_table("T", [good, bad, unknown]).splitlines()[4:]]
    assert rows == [
        ["|", "one", "|", "0.5", "|", "<=", "1", "|", "mm", "|", "met", "|"],
        ["|", "two", "|", "3", "|", "<=", "1", "|", "mm", "|", "MISSED", "|"],
    ]


def test_csv_has_short_numbers_and_nothing_for_none():
    rows = [(1, 0.123456789, None, True, 'a, "b"')]
    assert csv_text(("n", "x_m", "y_m", "ok", "why"), rows) == (
        'n,x_m,y_m,ok,why\n1,0.123457,,True,"a, ""b"""\n'
    )
    assert csv_text(("x_m",), [[1.0 / 3.0]], digits=3) == "x_m\n0.333\n"


def test_a_report_is_its_files_and_a_copy_of_the_values(tmp_path):
    values = {"x": finite(math.inf), "y": finite(1.5), "record": record(seed=3)}
    files = write_report(
        tmp_path, "r", text="# R\n", table="x\n1\n", values=values, copy=tmp_path / "copy.json"
    )
    assert [file.name for file in files] == ["r.md", "r.csv", "r.json"]
    assert (tmp_path / "r.json").read_bytes() == (tmp_path / "copy.json").read_bytes()
    read = json.loads((tmp_path / "r.json").read_text())
    assert read["x"] is None and read["y"] == 1.5 and read["record"]["seed"] == 3
    assert set(read["record"]) == {"seed", "machine", "versions", "commit"}
    with pytest.raises(OutputError, match=r"Cannot write into '.*none'"):
        write_report(tmp_path / "none", "r", text="", table="")
