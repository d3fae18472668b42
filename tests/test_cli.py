import os
import subprocess
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest

from lpvmpc.errors import LPVMPCError, OptionError, OutputError
from lpvmpc.kit import cli


@dataclass(frozen=True, kw_only=True)
class Options:
    """Count."""

    number: int = 1
    """How many."""
    loud: bool = False
    """Say it."""
    tone: Literal["low", "high"] | None = None
    """How."""


def test_options_come_from_the_command_line():
    assert cli.parse(Options, ["--number", "3", "--loud"]) == Options(number=3, loud=True)
    assert cli.parse(Options, []) == Options()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--number", "x"], "--number is 'x', but must be a whole number"),
        (["--number"], "Missing value for argument '--number'"),
        (["--nummer", "3"], "Unrecognized options: --nummer, 3"),
        (["more"], "Unrecognized options: more"),
        (["--tone", "hgih"], "--tone is 'hgih', but must be one of high, low; --help lists"),
    ],
)
def test_a_wrong_command_line_is_one_sentence(arguments, sentence):
    with pytest.raises(LPVMPCError) as caught:
        cli.parse(Options, arguments)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value) and "│" not in str(caught.value)


def test_a_terminal_without_unicode_gets_the_same_sentence(root):
    words = [sys.executable, root / "eval" / "track.py", "--stiffness", "oracl"]
    said = [
        subprocess.run(words, env={**os.environ, "PYTHONIOENCODING": code}, capture_output=True)
        for code in ("utf-8", "ascii")
    ]
    assert said[0].stderr == said[1].stderr
    assert said[0].stderr.startswith(b"Error: --stiffness is 'oracl', but must be one of constant,")


def test_help_ends_with_code_zero(capsys):
    with pytest.raises(SystemExit) as stop:
        cli.run(Options, lambda options: 1, ["--help"])
    assert not stop.value.code
    assert "How many." in capsys.readouterr().out


def test_exit_codes_are_those_of_the_contract(capsys):
    def fail(error):
        def main(options):
            raise error

        return cli.run(Options, main, [])

    assert cli.run(Options, lambda options: cli.NOT_COMPLETED, []) == 3
    assert fail(OptionError("speed", -1, "positive")) == 2
    assert capsys.readouterr().err == "Error: speed is -1, but must be positive.\n"
    assert fail(LPVMPCError("two\nlines")) == 2
    assert capsys.readouterr().err == "Error: two lines\n"
    assert fail(KeyboardInterrupt()) == 130
    with pytest.raises(ZeroDivisionError):  # our own mistakes keep their traceback
        fail(ZeroDivisionError())


@pytest.mark.parametrize("value", [-1.0, 2.5, float("nan"), float("inf")])
def test_numbers_outside_their_range_are_refused(value):
    with pytest.raises(OptionError, match=r"--share is .*, but must be from 0 to 2 m\."):
        cli.check_number("--share", value, 0.0, 2.0, "m")


def test_whole_numbers_are_told_whole():
    with pytest.raises(OptionError, match=r"from 0 to 9223372036854775808\."):
        cli.check_number("--seed", 2**64, 0, 2**63)


def test_numbers_that_were_not_given_pass():
    cli.check_number("--share", None, 0.0, 1.0)
    cli.check_number("--share", 1.0, 0.0, 1.0)


def test_a_folder_is_made_and_tried(tmp_path):
    assert cli.writable_folder(tmp_path / "a" / "b").is_dir()
    assert not list((tmp_path / "a" / "b").iterdir())
    (tmp_path / "file").touch()
    for place in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/absent")):
        with pytest.raises(OutputError, match="Cannot write into"):
            cli.writable_folder(place)


def test_a_file_of_results_is_tried_before_anything_is_driven(tmp_path):
    cli.result_file(None)
    cli.result_file(tmp_path / "a" / "b.json")
    assert (tmp_path / "a").is_dir()
    with pytest.raises(OutputError, match=r"it is a folder, not a file\."):
        cli.result_file(tmp_path / "a")


def test_a_result_never_replaces_a_file_that_is_read(tmp_path, capsys):
    @dataclass(frozen=True, kw_only=True)
    class Files:
        """Read and write."""

        scenario: str = ""
        """What is read."""
        also: tuple[Path, ...] = ()
        """What else."""
        json: Path | None = None
        """What is written."""

    (tmp_path / "road.csv").write_text("0,0")
    (tmp_path / "link").symlink_to("road.csv")
    read, link = str(tmp_path / "road.csv"), str(tmp_path / "link")
    for words in (["--scenario", read], ["--scenario", link], ["--also", "x", read]):
        assert cli.run(Files, lambda options: cli.DONE, [*words, "--json", read]) == cli.BAD_INPUT
        said = capsys.readouterr().err
        assert f"--json is {read!r}, but must be another file than that of {words[0]}" in said
    assert cli.run(Files, lambda options: cli.DONE, ["--scenario", read, "--json", "x"]) == cli.DONE


def test_an_opengl_that_is_not_there_is_ignored_aloud(monkeypatch, capsys):
    monkeypatch.setattr(cli, "find_library", lambda name: None)
    monkeypatch.setenv("MUJOCO_GL", "egl")
    cli.check_opengl()
    assert "MUJOCO_GL" not in os.environ
    assert capsys.readouterr().err == (
        "Warning: MUJOCO_GL is egl, but libEGL is not installed; it is ignored.\n"
    )
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    cli.check_opengl()
    assert os.environ["MUJOCO_GL"] == "glfw" and capsys.readouterr().err == ""


@pytest.mark.parametrize("backend", ["vulkan", "e g l", "x" * 3000, "\x1b[31m"])
def test_a_wrong_opengl_is_ignored_with_one_sentence(monkeypatch, capsys, backend):
    monkeypatch.setenv("MUJOCO_GL", backend)
    cli.check_opengl()
    assert "MUJOCO_GL" not in os.environ
    err = capsys.readouterr().err
    assert err.startswith("Warning: MUJOCO_GL is ") and err.endswith("; it is ignored.\n")
    assert err.count("\n") == 1 and "\x1b" not in err and len(err) < 1500


@pytest.mark.parametrize(("name", "value", "fine"), [
    ("MPLBACKEND", "nonsense", "TkAgg"),
    ("NUMBA_NUM_THREADS", "0", "2"), ("NUMBA_NUM_THREADS", "-1", "128"),
])
def test_a_setting_that_a_library_would_refuse_is_ignored_aloud(monkeypatch, capsys, name, value,
                                                                fine):
    monkeypatch.setenv(name, fine)
    cli.check_environment()
    assert os.environ[name] == fine and capsys.readouterr().err == ""
    monkeypatch.setenv(name, value)
    cli.check_environment()
    assert name not in os.environ
    assert capsys.readouterr().err.startswith(f"Warning: {name} is {value}, but must be ")


def test_a_message_is_one_line_that_no_terminal_obeys():
    assert cli.one_line("a\n b\x1b[31m\x07 \udcff") == "a b\\x1b[31m\\x07 \\udcff"
    assert len(cli.one_line("x" * 10**6)) < 1100 and cli.one_line("é[red]") == "é[red]"


def test_warnings_of_the_package_are_sentences(capsys):
    def main(options):
        warnings.warn("the weights are old", stacklevel=2)
        return 0

    @dataclass(frozen=True, kw_only=True)
    class Options:
        """Nothing."""

    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert cli.run(Options, main, []) == 0
    assert capsys.readouterr().err == "Warning: the weights are old\n"


def test_no_place_for_compiled_code_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    code = (
        "import sys; from lpvmpc import _numba_cache; from lpvmpc.kit import cli\n"
        "from dataclasses import dataclass\n"
        "@dataclass(frozen=True)\nclass Options:\n    'Nothing.'\n"
        "def main(options):\n    raise RuntimeError(\"cannot cache function 'f': no locator\")\n"
        "sys.exit(cli.run(Options, main, []))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "NUMBA_CACHE_DIR" in done.stderr


def test_an_unwritable_home_moves_the_cache_to_the_temporary_folder(tmp_path):
    (tmp_path / "home").write_text("")
    (tmp_path / "tmp").mkdir()
    places = {"HOME": str(tmp_path / "home"), "TMPDIR": str(tmp_path / "tmp")}
    kept = {k: v for k, v in os.environ.items() if k not in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR")}
    code = "import os, lpvmpc; print(os.environ['NUMBA_CACHE_DIR'])"
    out = subprocess.check_output([sys.executable, "-c", code], env={**kept, **places}, text=True)
    assert out.startswith(str(tmp_path / "tmp" / "lpvmpc-")) and os.path.isdir(out.strip())
