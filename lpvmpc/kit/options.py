"""A command line read into a dataclass: a field is an option, the string below it is its help.

    @dataclass(frozen=True, kw_only=True)
    class Options:
        laps: int = 1
        "How often around."

gives `--laps INT`. Fields may be numbers, words, paths, words of a `Literal`, each of these or
None, tuples of them, and flags: `bool`, False unless given. Every field has a default.

argparse does the work, but not its messages: what is wrong is known here, and said in a sentence.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import Field, dataclass, fields
from itertools import pairwise
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from lpvmpc.errors import LPVMPCError

OptionsT = TypeVar("OptionsT")
KINDS: dict[type, tuple[str, str]] = {
    int: ("INT", "a whole number"),
    float: ("FLOAT", "a number"),
    str: ("STR", "a word"),
    Path: ("PATH", "the path of a file or a folder"),
}
"""Types of a value: how the help calls it, and an error."""
NUMBER = re.compile(r"-(\d+\.?\d*e[+-]?\d+|\.\d+e[+-]?\d+|inf|nan)", re.IGNORECASE)
"""Negative numbers that argparse takes for options."""


@dataclass(frozen=True, kw_only=True)
class Option:
    """What an annotation may add to a field: `Annotated[str, Option(metavar="NAME")]`."""

    help: str | None = None
    """The help, where it is made of other names and cannot be a string below the field."""
    metavar: str | None = None
    """What the help calls a value; one word per entry for a tuple of fixed length."""
    positional: bool = False
    """Whether its values come without an option's name in front; at most one tuple may."""


def parse(options: type[OptionsT], arguments: Sequence[str] | None = None) -> OptionsT:
    """Options from the command line.

    Args:
        options: A dataclass, as above.
        arguments: The words (default: those the process was called with).

    Raises:
        LPVMPCError: Unknown options, values of the wrong kind, or none where one is needed.
        SystemExit: After --help, with code 0.
    """
    words = _plain(sys.argv[1:] if arguments is None else arguments)
    texts = _texts(options) if {"-h", "--help"} & set(words) else {}
    about = (inspect.getdoc(options) or "").split("\n\n")
    parser = argparse.ArgumentParser(
        prog=os.path.basename(sys.argv[0]),
        description="\n\n".join(textwrap.fill(part, _width()) for part in about),
        formatter_class=argparse.RawTextHelpFormatter,
        argument_default=argparse.SUPPRESS,
        allow_abbrev=False,
        exit_on_error=False,
    )
    parser.usage = "%(prog)s [OPTIONS]"
    hints = get_type_hints(options, include_extras=True)
    for field in fields(options):  # type: ignore[arg-type]
        _add(parser, field, hints[field.name], texts.get(field.name, ""))
    try:
        given, unknown = parser.parse_known_intermixed_args(words)
    except argparse.ArgumentError as error:  # with the values' types known here, one of these two
        name = str(error.argument_name)
        if name.lstrip("-").replace("-", "_") in _flags(hints):
            raise _wrong(f"{name} takes no value") from None
        raise _wrong(f"Missing value for argument {name!r}") from None
    if unknown:
        raise _wrong(f"Unrecognized options: {', '.join(unknown)}")
    values = {k: tuple(v) if isinstance(v, list) else v for k, v in vars(given).items()}
    return options(**values)


def _wrong(what: str) -> LPVMPCError:
    return LPVMPCError(f"{what}; --help lists the options.")


def _plain(words: Sequence[str]) -> list[str]:
    """The words, with - for _ in names; negative numbers joined to the option before them."""
    plain: list[str] = []
    for word in map(str, words):
        name, equals, value = word.partition("=")
        if name.startswith("--"):
            plain.append(name.replace("_", "-") + equals + value)
        elif NUMBER.fullmatch(word) and plain and plain[-1].startswith("--"):
            plain[-1] += f"={word}"
        else:
            plain.append(word)
    return plain


def _add(parser: argparse.ArgumentParser, field: Field[Any], hint: Any, text: str) -> None:
    """Tell the parser of a field."""
    hint, extra = _bare(hint)
    text = extra.help or text
    default = field.default if isinstance(field.default, tuple) else (field.default,)
    if default not in ((), (None,)) and hint is not bool and "(default" not in text:
        text += f" (default: {' '.join(map(str, default))})"
    text = textwrap.fill(text.replace("%", "%%"), max(_width() - 24, 30), break_on_hyphens=False)
    flag = f"--{field.name.replace('_', '-')}"
    if hint is bool:
        assert field.default is False, field.name
        parser.add_argument(flag, action="store_true", help=text)
        return
    kinds = get_args(hint) if get_origin(hint) is tuple else ()
    read, metavar = _reader(flag, kinds[0] if kinds else hint)
    metavar = extra.metavar or metavar
    if extra.positional:
        parser.usage = f"{parser.usage} [{metavar} ...]"
        parser.add_argument(field.name, type=read, metavar=metavar, help=text, nargs="*")
    elif not kinds:
        parser.add_argument(flag, type=read, metavar=metavar, help=text)
    elif kinds[-1] is Ellipsis:
        parser.add_argument(flag, type=read, metavar=metavar, help=text, nargs="+", action=_Once)
    else:
        names = tuple(metavar.split()) if " " in metavar else (metavar,) * len(kinds)
        parser.add_argument(flag, type=read, metavar=names, help=text, nargs=len(kinds))


class _Once(argparse.Action):
    """Keep a list; a second one would silently replace the first."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: Any = None) -> None:
        """Refuse it."""
        if hasattr(namespace, self.dest):
            raise _wrong(f"{option_string} is given twice, but must come once, before all values")
        setattr(namespace, self.dest, values)


def _bare(hint: Any) -> tuple[Any, Option]:
    """The type of a field that is given, and what its annotation adds."""
    extra = Option()
    if get_origin(hint) is Annotated:
        hint, *more = get_args(hint)
        extra = next((one for one in more if isinstance(one, Option)), extra)
    if get_origin(hint) in (Union, UnionType):
        (hint,) = (one for one in get_args(hint) if one is not NoneType)
    return hint, extra


def _flags(hints: dict[str, Any]) -> list[str]:
    return [name for name, hint in hints.items() if _bare(hint)[0] is bool]


def _reader(flag: str, kind: Any) -> tuple[Callable[[str], Any], str]:
    """What turns a word into a value, or says what is wrong; and what the help calls it."""
    if get_origin(kind) is Literal:
        choices = get_args(kind)
        metavar, named = f"{{{','.join(choices)}}}", f"one of {', '.join(sorted(choices))}"
    else:
        choices = ()
        metavar, named = KINDS[kind]

    def read(word: str) -> Any:
        if choices and word in choices:
            return word
        try:
            if not choices and not (kind is Path and (not word or "\0" in word)):
                return kind(word)
        except ValueError:
            pass
        raise _wrong(f"{flag} is {word!r}, but must be {named}")

    return read, metavar


def _texts(options: type) -> dict[str, str]:
    """The string below each field."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(options))).body
    assert isinstance(tree, ast.ClassDef)
    return {
        field.target.id: " ".join(str(text.value.value).split())
        for field, text in pairwise(tree.body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
    }


def _width() -> int:
    """Columns of the terminal, as argparse leaves them for text."""
    return max(shutil.get_terminal_size().columns - 2, 20)
