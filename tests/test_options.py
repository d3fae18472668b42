from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest

from lpvmpc.errors import LPVMPCError
from lpvmpc.kit.options import Option, parse


@dataclass(frozen=True, kw_only=True)
class Options:
    """Say what is driven.

    And how.
    """

    names: Annotated[tuple[str, ...], Option(positional=True, metavar="NAME", help="Who.")] = ()
    wind_scale: float = 1.0
    """Factor on the wind, in 100 % steps."""
    laps: int | None = None
    """How often."""
    out: Path | None = None
    """Where to (default: here)."""
    friction: tuple[float, ...] = (1.0,)
    """One number, or two."""
    start: tuple[float, float] | None = None
    """Where."""
    mode: Literal["slow", "fast"] = "fast"
    """How."""
    loud: bool = False
    """Say it."""


def test_every_kind_of_option_is_read():
    words = "--wind-scale 0.5 --laps 3 --out a/b --friction 0.4 1 --start 1 -2.5 --mode slow --loud"
    assert parse(Options, words.split()) == Options(
        wind_scale=0.5, laps=3, out=Path("a/b"), friction=(0.4, 1.0), start=(1.0, -2.5),
        mode="slow", loud=True,
    )
    assert parse(Options, []) == Options()


@pytest.mark.parametrize("words, expected", [
    ("a --laps 2 b", Options(names=("a", "b"), laps=2)),
    ("--loud a b", Options(names=("a", "b"), loud=True)),
    ("--laps=2 --laps 3", Options(laps=3)),
    ("--wind_scale 2", Options(wind_scale=2.0)),
    ("--wind-scale -1e-3", Options(wind_scale=-1e-3)),
    ("--wind-scale -inf", Options(wind_scale=-float("inf"))),
    ("--laps -2", Options(laps=-2)),
])
def test_words_may_stand_as_people_write_them(words, expected):
    assert parse(Options, words.split()) == expected


@pytest.mark.parametrize("words, sentence", [
    ("--laps 1.5", "--laps is '1.5', but must be a whole number"),
    ("--wind-scale fast", "--wind-scale is 'fast', but must be a number"),
    ("--friction 1 x", "--friction is 'x', but must be a number"),
    ("--friction", "Missing value for argument '--friction'"),
    ("--out --loud", "Missing value for argument '--out'"),
    ("--start 1", "Missing value for argument '--start'"),
    ("--out=", "--out is '', but must be the path of a file or a folder"),
    ("--friction 1 --laps 2 --friction 0.5", "--friction is given twice, but must come once"),
    ("--loud=3", "--loud takes no value"),
    ("--lap 3", "Unrecognized options: --lap"),
    ("a -x", "Unrecognized options: -x"),
    ("--mode quick", "--mode is 'quick', but must be one of fast, slow"),
])
def test_what_is_wrong_is_one_sentence(words, sentence, capsys):
    with pytest.raises(LPVMPCError) as caught:
        parse(Options, words.split())
    assert str(caught.value).startswith(sentence)
    assert str(caught.value).endswith("; --help lists the options.")
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("columns", ["1", "2", "5", "-3", "x"])
def test_the_help_comes_whatever_the_terminal_says_of_its_width(columns, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", columns)
    with pytest.raises(SystemExit):
        parse(Options, ["--help"])
    assert "--laps" in capsys.readouterr().out


def test_the_help_fits_80_columns_and_tells_defaults_once(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as stop:
        parse(Options, ["--laps", "3", "--help"])
    assert not stop.value.code
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 80
    lines = [" ".join(line.split()) for line in text.splitlines()]
    assert lines[0].endswith("[OPTIONS] [NAME ...]")
    assert lines[2:5] == ["Say what is driven.", "", "And how."]
    assert "NAME Who." in lines
    assert "--wind-scale FLOAT Factor on the wind, in 100 % steps. (default: 1.0)" in lines
    assert "--laps INT How often." in lines
    assert "--out PATH Where to (default: here)." in lines
    assert "--friction FLOAT [FLOAT ...]" in lines and "--start FLOAT FLOAT" in text
    assert "--mode {slow,fast} How. (default: fast)" in lines
    assert "--loud Say it." in lines
