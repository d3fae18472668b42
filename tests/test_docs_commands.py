"""The commands in the documentation exist, and the tutorial and the how-tos do what they say.

Every command line of every page is parsed as it stands. The blocks of the tutorial and of the
how-tos are typed in order (slow): a block with a title is a file, a block of `sh` is run. What
installs something is not: that is walked by hand before a release.
"""

import json
import re
import runpy
import shlex
import shutil
import sys
import warnings
from importlib import import_module
from pathlib import Path

import pytest

from lpvmpc import commands
from lpvmpc.commands import COMMANDS, module_of
from lpvmpc.kit import cli

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "models/README.md",
                                  "cars/README.md", "examples/README.md")]
PAGES += sorted((ROOT / "docs").glob("*.md"))
COMMAND = re.compile(r"(?<![\w/.-])(?:\.venv/bin/)?lpvmpc ([a-z][^`#\n]*)")
BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.M | re.S)
SKIPPED = ("python3 -m venv", ".venv/bin/pip", ". .venv/bin/activate", "mkdir ~", "cd ~",
           "lpvmpc collect", "lpvmpc train",  # an hour; tests of their own run them
           "lpvmpc adopt",  # needs a recording of the reader's, and an hour
           "lpvmpc view")  # needs a display
"""How lines begin that no test types."""


def command_lines(page):
    """What stands behind `lpvmpc` in code blocks, indented or fenced, and in code in a sentence."""
    text = page.read_text()
    code = [line for line in re.findall(r"^(?: {4}|\t)(\S.*)$", text, re.M)]
    code += re.findall(r"^```.*?\n(.*?)^```$", text, re.M | re.S)
    text = re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)
    code += [" ".join(one.split()) for one in re.findall(r"`([^`]+)`", text)]
    code = "\n".join(code)
    found = {line.split("   ")[0].strip() for line in COMMAND.findall(code)}
    return sorted(line for line in found
                  if line.split()[0] in COMMANDS and not line.endswith("--help"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_command_line_can_be_typed(page):
    for line in command_lines(page):
        name, *words = shlex.split(line.partition(" > ")[0].rstrip(".,;:)"))
        if words and words[-1] == "--weights":  # a sentence that breaks off there
            words.pop()
        cli.parse(import_module(module_of(name)).Options, words)


def test_the_command_lines_are_found():
    found = [line for page in PAGES for line in command_lines(page)]
    assert "benchmark --controllers mine:Mine lpv-mpc --quick" in found  # tutorial
    assert "compare --controllers lpv-mpc lmpc-pso-pid stanley --render" in found  # README
    assert len(found) > 40


def typed(page, folder, monkeypatch):
    """Type a page's blocks, one after the other; yields each command line with its exit code."""
    monkeypatch.chdir(folder)
    for language, title, text in BLOCK.findall((ROOT / "docs" / page).read_text()):
        if title:
            (folder / title).parent.mkdir(parents=True, exist_ok=True)
            (folder / title).write_text(text)
            sys.modules.pop(Path(title).stem, None)
        elif language == "sh":
            for line in text.splitlines():
                if not line.startswith(SKIPPED):
                    yield line, run(line, monkeypatch)


def run(line, monkeypatch):
    """Run a line in this process; its exit code."""
    program, *words = shlex.split(line)
    with monkeypatch.context() as patched, warnings.catch_warnings():
        warnings.simplefilter("default", UserWarning)  # what the command says on stderr
        if program == "lpvmpc":
            patched.setattr(sys, "argv", [program])
            return commands.main(words)
        assert [program, words[0]] == ["python", "-m"], line
        patched.setattr(sys, "argv", words[1:])
        try:
            sys.modules.pop(words[1], None)
            runpy.run_module(words[1], run_name="__main__")
        except SystemExit as end:
            return end.code
        return 0


def largest(run):
    return json.loads(Path("runs", run, "metrics.json").read_text())["lateral_max_m"]


@pytest.mark.slow
def test_the_tutorial_does_what_it_says(tmp_path, monkeypatch):
    first, lines = {}, []
    for line, code in typed("tutorial.md", tmp_path, monkeypatch):
        assert code == 0, line
        lines.append(line)
        if "mine:Mine" in line and "mine" not in first:
            first["mine"] = largest("slalom-mine-Mine")
        elif "fleet" in line:
            first["fleet"] = largest("slalom-lpv-mpc")
        elif "--report" in line:
            first["ideal"] = largest("slalom-lpv-mpc")
            assert Path("runs/slalom-lpv-mpc/report.html").exists()
    assert len(lines) == 6 and lines[-1] == (
        "lpvmpc benchmark --controllers mine:Mine lpv-mpc --quick")
    assert Path("runs/benchmark-quick/benchmark.html").exists()
    assert first["ideal"] < 0.0015 and first["fleet"] > 5 * first["ideal"]
    assert first["mine"] > 0.5
    (folder,) = Path("runs").glob("slalom-mine-Mine-vs-*")
    runs = json.loads((folder / "comparison.json").read_text())["runs"]
    now, stanley, ours = (runs[name] for name in ("mine:Mine", "stanley", "lpv-mpc"))
    assert now["lateral_max_m"] < first["mine"] / 3
    assert 3 * ours["lateral_max_m"] < stanley["lateral_max_m"] < now["lateral_max_m"]


@pytest.mark.slow
def test_the_how_tos_work(tmp_path, monkeypatch):
    shutil.copy(ROOT / "cars" / "bmw-320i" / "tire.tir", tmp_path / "my.tir")
    lines = []
    for line, code in typed("howto.md", tmp_path, monkeypatch):
        assert code == 0, line
        lines.append(line)
    assert len(lines) == 9


@pytest.mark.parametrize("page", ["README.md", *(
    pytest.param(page, marks=pytest.mark.slow) for page in ("docs/gymnasium.md", "docs/worlds.md")
)])
def test_the_python_blocks_run(page, tmp_path, monkeypatch):
    if "gym" in page:  # an installed lpvmpc needs no import
        pytest.importorskip("lpvmpc.gym")
    monkeypatch.chdir(tmp_path)
    blocks = [text for language, _, text in BLOCK.findall((ROOT / page).read_text())
              if language == "python"]
    assert blocks
    for text in blocks:
        exec(compile(text.replace("10_000", "200"), page, "exec"), {"__name__": page})
