"""Wrong inputs: command lines and files, each to be refused in one sentence with exit code 2.

A list, not a generator of noise: every entry stands for a mistake that somebody makes. The files
are in `wrong_files`; the options' entries follow from their types, so that a new option is tried
as soon as it exists.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from lpvmpc.errors import LPVMPCError
from lpvmpc.kit import cli
from lpvmpc.reliability import wrong_files

Main = Callable[[Sequence[str]], int]
"""Runs a command line and gives its exit code."""
SLOW = 60.0
"""No refusal takes more of the processor than this [s]: the first one may have to compile."""
NO_NUMBERS = ("x", "", "1,5", "1e", "[red]")
"""Words that are no numbers."""
NO_INTEGERS = ("1.5", "nan", "1e3", "0x10")
"""Words that are no whole numbers."""
NO_COMMANDS = (("nothing",), ("Track",), ("--scenario", "paper"))
"""Command lines that name no command."""


@dataclass(frozen=True, kw_only=True)
class Wrong:
    """A wrong input."""

    words: tuple[str, ...]
    """The command line, or the name of a reader and a file."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a command answered."""

    wrong: Wrong
    """What was asked."""
    fault: str
    """What is wrong with the answer; "" where it is as it should be."""
    sentence: str
    """What it said."""
    seconds: float
    """Time of the processor that it took [s]."""


OUT_OF_RANGE: dict[str, str] = {
    "track": """--seed -1 | --delay -1 | --delay 31 | --latency -1 | --latency 201 | --latency 1.5
        --latency nan | --latency inf | --step-timeout 0 | --step-timeout nan | --laps 0 | --laps -3
        --laps 101 | --laps 2 --scenario paper | --start-offset 6 0 | --start-offset 0 2
        --start-offset nan 0 | --start-offset 1 | --friction 0 | --friction -1 | --friction 3
        --friction nan | --wind-scale -1 | --wind-scale 11 | --wind-scale inf | --v-max 0
        --v-max -5 | --v-max 61 | --v-max nan | --ay-max 0 | --ay-max 16 | --ay-max inf | --grip 0
        --grip 1.3 | --grip nan | --grip 0.5 --ay-max 3 | --smoothing -1 | --smoothing 10
        --closed --no-closed | --closed --scenario paper | --scenario nowhere | --scenario none.csv
        --scenario random-x | --controller nobody | --controller no_module:Class
        --controller json:Nothing | --controller json:loads | --controller : | --controller os:
        --stiffness rigid | --world mars | --world none.toml | --estimator guess | --estimator x:Y
        --weights none.toml | --weights none.toml --controller json:JSONDecoder
        --json /dev/null/x | --out /dev/null/x | --out /proc/x | --export bag | --traffic tram
        --traffic none.toml | --traffic /dev/zero | --detour | --json empty-folder | --json loop/x
        --out roads/empty.csv | --out roads/empty.csv/x | --out loop | --json roads/empty.csv/x
        --scenario roads/a-word.csv --json roads/a-word.csv | --seed 18446744073709551616
        --step-timeout 1e-300 | --step-timeout inf | --step-timeout -1 | --friction 1e-300
        --friction 1e400 | --friction 0x1p0 | --smoothing 1e9 | --smoothing nan
        --start-offset inf 0 | --start-offset 0.5 0.1 0.2 | --export csv,mcap | --export CSV
        --solver gurobi | --controller stanley --solver active-set | --controllers stanley
        --controller stanley --stiffness network | extra | -- | -x | --sc paper | @file
        --scenario loop | --scenario loop.csv | --scenario random- | --scenario random--1
        --scenario random-1e3 | --scenario random-1.csv | --scenario http://x/y.csv | --scenario -
        --scenario /dev/fd/99 | --scenario /proc/self/mem | --scenario ~/none.csv
        --controller json:a:b | --controller json.loads | --controller none.py:C
        --controller ./none:C | --controller ../none:C | --controller json:__class__
        --car loop | --car roads/empty.csv | --car empty-folder | --tire loop
        --tire roads/empty.csv | --weights loop | --world loop | --traffic loop
        --scenario slalom --closed | --isolate --controller none:C""",
    "view": """empty-folder | empty-folder --html | none --html | --html | a b --html | roads --html
        empty-folder --speed 0 | empty-folder --speed nan --html | /dev/null --html""",
    "export": """empty-folder | none | a b | empty-folder --to bag | /dev/null | /proc
        empty-folder --to csv | none --to csv""",
    "compare": """--controllers lpv-mpc | --controllers lpv-mpc lpv-mpc | --controllers a b
        --controllers lpv-mpc/rigid stanley | --controllers stanley none:Class
        --controllers stanley pure-pursuit lpv-mpc lpv-mpc-paper lmpc-pso-pid a b
        --controllers stanley pure-pursuit --scenario nowhere | --seed -1 | --delay 31
        --controllers stanley lqr --controllers stanley pure-pursuit | --controllers / stanley
        --controllers lpv-mpc/ stanley | --controllers stanley pure-pursuit --json empty-folder
        --controllers stanley pure-pursuit --out roads/empty.csv
        --controllers stanley pure-pursuit --friction 0 | --friction nan | --wind-scale -1
        --v-max 0 | --ay-max 0 | --grip 2 | --out /dev/null/x""",
    "tune": """--controller nobody | --scenario nowhere | --worlds mars | --seeds 0 | --seeds 1001
        --generations 0 | --generations 10001 | --population 1 | --population 3 | --jobs 0
        --jobs -1 | --seed -1 | --address x | --sphere --controller stanley | --sphere --jobs 2
        --sphere --resume | --resume --out empty-folder | --out /dev/null/x
        --out roads/empty.csv | --json empty-folder | --controller ppo | --scenario loop
        --worlds worlds/a-pickle.toml | --worlds rtk --worlds fleet | --population 100000000
        --backend ray --address 256.1.1.1:1 | --backend local --address 1.2.3.4:5
        --sphere --out /dev/null/x | --spread none | --spread none none | --spread /dev/zero x""",
    "collect": """--samples 0 | --samples -5 | --samples 1000000000 | --seed -1 | --jobs -1
        --jobs 1025 | --friction 0 | --friction 2 | --friction 1 0.5 | --friction 1 1 1
        --friction nan | --mass 0 | --mass 100 | --mass 2000 1500 | --mass nan | --out data.csv
        --out /dev/null/x.parquet | --address x | --friction 0.5 --friction 0.7
        --out empty-folder | --out loop | --out roads/empty.csv/x.parquet | --car cars/no-car.xml
        --mass 1500 1500 1500""",
    "train": """--data none.parquet | --seed -1 | --seeds 0 | --seeds 101 | --epochs 0 | --epochs -1
        --epochs 10000000 | --out weights.pt | --also none.parquet | --data loop
        --data empty-folder | --preset Paper""",
    "benchmark": """--jobs -1 | --seeds 0 | --seeds 901 | --sample -1 | --controllers nobody
        --out /dev/null/x | --cache /dev/null/x | --verify none | --resume --cache empty-folder
        --controllers stanley stanley | --controllers stanley --controllers lqr
        --verify roads/empty.csv | --verify empty-folder | --verify loop | --cache roads/empty.csv
        --out roads/empty.csv | --json empty-folder | --car cars/no-car.xml | --address x""",
    "ablation": """--jobs -1 | --jobs 1025 | --out /dev/null/x | --cache /dev/null/x
        --out roads/empty.csv | --json empty-folder | --car loop | --cache loop
        --resume --cache empty-folder""",
    "worlds": """--jobs -1 | --seeds 0 | --seeds 10001 | --parts weather | --controllers nobody
        --out /dev/null/x | --cache /dev/null/x | --resume --cache empty-folder | --address x
        --out roads/empty.csv | --json empty-folder | --cache roads/empty.csv | --seeds 1e2
        --parts worlds --parts margins | --controllers stanley stanley""",
    "fidelity": """astrology | straight astrology | --jobs -1 | --broken wheel
        --out /dev/null/x | Tire | tire --out roads/empty.csv | tire --json empty-folder
        tire --tire roads/empty.csv | tire --car cars/no-car.xml""",
    "reproduce": """--jobs -1 | --out /dev/null/x | --cache /dev/null/x | --out roads/empty.csv
        --json empty-folder | --cache loop""",
    "replay": """--recording none.csv | --recording /dev/zero | --recording /proc
        --recording none.csv --fit wings | --fit-on none.csv | --save x | --study --out /dev/null/x
        --recording none.csv --car none | --recording loop | --recording empty-folder""",
    "adopt": """none.csv | --out x | none.csv --out x | /dev/zero --out x
        none.csv --out /dev/null/x
        none.csv --out x --held-back nan | none.csv --out x --held-back 1
        none.csv --out x --samples 5 | none.csv --out x --jobs -1 | none.csv --out x --fit wings
        none.csv --out x --generations -1 | none.csv --out x --car none | loop --out x
        a.csv b.csv --out x | recordings/nan.csv --out roads/empty.csv""",
    "solvers": """--solvers nobody | --count 0 | --programs none | --programs /dev/zero
        --programs /dev/null | --programs empty-folder | --keep /dev/null/x | --out /dev/null/x
        --out roads/empty.csv | --keep roads/empty.csv | --programs roads/empty.csv
        --programs loop | --count 99999999999 | --json empty-folder""",
    "speed": """--rounds 0 | --rounds 101 | --out /dev/null/x | --rounds 1e1 | --json empty-folder
        --out roads/empty.csv | --car cars/no-car.xml""",
    "stiffness": """--seeds -1 | --out roads/empty.csv | --json empty-folder | --car loop""",
}
"""Values outside their domain, and options that exclude each other; a | or a line's end parts
them."""


def wrong_inputs(options: Mapping[str, type]) -> list[Wrong]:
    """All of them, in a fixed order.

    Args:
        options: The commands' options, by the names of the commands.
    """
    found = [Wrong(words=words) for words in NO_COMMANDS]
    for name, kind in options.items():
        found += [Wrong(words=(name, *words)) for words in _by_type(kind)]
        entries = OUT_OF_RANGE.get(name, "").replace("\n", "|").split("|")
        found += [Wrong(words=(name, *entry.split())) for entry in entries if entry.strip()]
        found += [Wrong(words=(name, *words)) for words in _empty(kind)]
    return found + list(_files())


def _empty(options: Any) -> Iterator[tuple[str, ...]]:
    """Paths that are none, as an unset variable of a shell leaves them."""
    hints = get_type_hints(options, include_extras=True)
    for field in fields(options):
        if _kind(hints[field.name]) is Path and not _positional(hints[field.name]):
            yield (f"--{field.name.replace('_', '-')}", "")


def _by_type(options: Any) -> Iterator[tuple[str, ...]]:
    """Words that the options' types refuse, whatever they mean."""
    yield ("--no-such-option",)
    yield ("--no-such-option", "3")
    hints = get_type_hints(options, include_extras=True)
    for field in fields(options):
        flag, kind = f"--{field.name.replace('_', '-')}", _kind(hints[field.name])
        if kind is bool:
            yield (f"{flag}=yes",)
            continue
        if _positional(hints[field.name]):
            continue
        yield (flag,)
        if get_origin(kind) is Literal:
            yield (flag, "neither")
        elif kind in (int, float):
            for word in (*NO_NUMBERS[:3], *(NO_INTEGERS[:2] if kind is int else ())):
                yield (flag, word)


def _positional(hint: Any) -> bool:
    """Whether an option's values come without a name."""
    extras = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
    return any(isinstance(extra, cli.Option) and extra.positional for extra in extras)


def _kind(hint: Any) -> Any:
    """The type of one value."""
    if get_origin(hint) is Annotated:
        hint = get_args(hint)[0]
    if get_origin(hint) in (Union, UnionType):
        (hint,) = (one for one in get_args(hint) if one is not NoneType)
    return get_args(hint)[0] if get_origin(hint) is tuple else hint


def _files() -> Iterator[Wrong]:
    """Wrong files, each given to the command or the reader that takes such files."""
    stanley = ("track", "--controller", "stanley", "--out", "out")
    for file in (*wrong_files.names("roads"), "x" * 300 + ".csv", "[/red].csv", "\x1b[31m.csv"):
        yield Wrong(words=(*stanley, "--scenario", file))
    for file in (*wrong_files.names("weights"), "/dev/zero", "/dev/null", "x" * 300):
        yield Wrong(words=(*stanley, "--weights", file))
    for file in wrong_files.names("worlds"):
        yield Wrong(words=(*stanley, "--world", file))
    for file in wrong_files.names("worlds"):
        if file.endswith(("unknown-base.toml", "no-toml.toml", "pipe.toml", "deep.toml")):
            yield Wrong(words=("tune", "--worlds", file))
    for file in wrong_files.names("traffic"):
        yield Wrong(words=(*stanley, "--traffic", file))
    for file in wrong_files.names("cars"):
        yield Wrong(words=(*stanley, "--car", file))
    for file in wrong_files.names("recordings"):
        yield Wrong(words=("replay", "--recording", file, "--out", "out"))
    for file in (*wrong_files.names("data"), "/dev/zero"):
        yield Wrong(words=("train", "--data", file))
    for kind in READERS:
        for file in (*wrong_files.names(kind), "/dev/zero"):
            yield Wrong(words=(f"read {kind}", file))


def _read_network(file: str) -> None:
    from lpvmpc.control.stiffness.network_file import load_weights

    load_weights("network", file)


def _read_tire(file: str) -> None:
    from lpvmpc.car.tir import read_tir

    read_tir(file)


READERS: dict[str, Callable[[str], None]] = {"networks": _read_network, "tires": _read_tire}
"""Readers that no command's option leads to."""


def ask(wrong: Wrong, main: Main) -> Answer:
    """Give a wrong input to its command in this process; see what it answers.

    Args:
        wrong: The input.
        main: Runs a command line that begins with the command's name, and gives its exit code.

    Raises:
        KeyboardInterrupt: Ctrl-C.
    """
    out, err = io.StringIO(), io.StringIO()
    start, code = time.process_time(), None
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = _answer(wrong.words, main)
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else 1
        except Exception:
            err.write(traceback.format_exc())
    if code == cli.INTERRUPTED:  # Ctrl-C, which the command has answered as its own
        raise KeyboardInterrupt
    said = err.getvalue()
    errors = [line for line in said.splitlines() if not line.startswith("Warning:")]
    seconds = time.process_time() - start
    fault = ""
    if "Traceback" in said:
        fault = "a traceback"
    elif code != cli.BAD_INPUT:
        fault = f"exit code {code}"
    elif len(errors) != 1 or not errors[0].startswith("Error: ") or errors[0][-1] not in ".;":
        fault = "not one sentence"
    elif not all(c.isprintable() for c in errors[0]) or len(errors[0]) > cli.LONGEST + 20:
        fault = "a sentence that no terminal should see"
    elif seconds > SLOW:
        fault = f"{seconds:.0f} s"
    return Answer(wrong=wrong, fault=fault, sentence=said.strip(), seconds=seconds)


def _answer(words: Sequence[str], main: Main) -> int:
    """The exit code of a command line; that of a reader as a command would have it."""
    first, *rest = words
    if not first.startswith("read "):
        return main(list(words))
    try:
        READERS[first.removeprefix("read ")](rest[0])
    except LPVMPCError as error:
        print("Error:", cli.one_line(str(error)), file=sys.stderr)
        return cli.BAD_INPUT
    return cli.DONE


@contextlib.contextmanager
def set_up(folder: Path) -> Iterator[None]:
    """Work in a folder that holds the wrong files."""
    wrong_files.write(folder)
    (folder / "empty-folder").mkdir(exist_ok=True)
    for name, other in (("loop", "loop.csv"), ("loop.csv", "loop")):
        if not (folder / name).is_symlink():
            (folder / name).symlink_to(other)
    before = os.getcwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
