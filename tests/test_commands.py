"""The command `lpvmpc NAME`, and the scripts that are the same."""

import os
import subprocess
import sys
from importlib import import_module

import pytest

from lpvmpc import commands
from lpvmpc.control.registry import CONTROLLERS, STIFFNESS_MODELS, TUNABLE
from lpvmpc.road.names import SCENARIOS
from lpvmpc.studies.names import BROKEN, STUDIES

SCRIPTS = {name: f"{'data_gen' if name in ('collect', 'train') else 'eval'}/{name}.py"
           for name in commands.COMMANDS}


def said_by(*command, cwd):
    """What a command prints."""
    answer = subprocess.run(
        [sys.executable, *map(str, command)], cwd=cwd, capture_output=True, text=True, check=True
    )
    assert answer.stderr == ""
    return answer.stdout


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_help_that_a_full_disk_has_lost_is_told():
    with open("/dev/full", "w") as full:
        answer = subprocess.run([sys.executable, "-m", "lpvmpc", "--help"], stdout=full,
                                stderr=subprocess.PIPE, text=True)
    sentence = "Error: Cannot write to standard output: No space left on device.\n"
    assert (answer.returncode, answer.stderr) == (2, sentence)


@pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"]])
def test_alone_it_lists_the_commands_with_a_line_each(capsys, arguments):
    assert commands.main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    for name, about in commands.COMMANDS.items():
        (line,) = (line for line in lines if line.split()[:1] == [name])
        assert line.endswith(about)
    assert max(map(len, lines)) <= 80


def test_an_unknown_command_is_one_sentence(capsys):
    assert commands.main(["trac"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1
    assert err.startswith("Error: Unknown command 'trac'; the choices are ablation, adopt,")


@pytest.mark.parametrize("name", commands.COMMANDS)
def test_every_command_is_a_module_with_options_and_main(name):
    module = import_module(commands.module_of(name))
    assert callable(module.main) and module.Options() == module.Options()


def test_command_and_script_have_the_same_options(root, tmp_path):
    command = said_by("-m", "lpvmpc", "track", "--help", cwd=tmp_path)
    script = said_by(root / SCRIPTS["track"], "--help", cwd=tmp_path)
    (usage, *options), (other_usage, *other_options) = command.split("\n"), script.split("\n")
    assert "lpvmpc track" in usage and "track.py" in other_usage
    assert options == other_options


@pytest.mark.parametrize("name", commands.COMMANDS)
def test_a_script_is_its_command_and_nothing_else(root, name):
    lines = (root / SCRIPTS[name]).read_text().splitlines()
    assert f"from {commands.module_of(name)} import Options, main" in lines and len(lines) < 12


@pytest.mark.parametrize(
    ("name", "listed"),
    [
        ("track", [*CONTROLLERS, *STIFFNESS_MODELS, *SCENARIOS]),
        ("compare", [*CONTROLLERS, *SCENARIOS]),
        ("tune", TUNABLE),
        ("fidelity", [*STUDIES, *BROKEN]),
    ],
)
def test_the_help_lists_the_choices_and_comes_without_numba_and_mujoco(name, listed, capsys):
    code = (
        "import sys; from lpvmpc.commands import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print(*sys.modules, file=sys.stderr)"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code, name, "--help"], capture_output=True, text=True, check=True
    )
    said = answer.stdout.replace("\u2502", " ")
    words = {word.strip(",.;:") for word in said.split()}
    assert not [choice for choice in listed if choice not in words]
    heavy = {"numba", "mujoco", "scipy", "proxsuite", "pyarrow", "matplotlib", "torch", "rich.live"}
    assert not heavy & set(answer.stderr.split())
