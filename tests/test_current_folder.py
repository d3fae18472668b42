import os
import subprocess
import sys

import pytest

from lpvmpc.kit.workers import workers
from lpvmpc.sim.names import load_controller
from lpvmpc.sim.own import file_of, own_module

STRAY = ("random", "numpy", "bz2", "socket", "mujoco", "scipy", "psutil", "numba", "typing")
OWN = """
import {helper}
class Own:
    def reset(self, rng): pass
    def command(self, state, preview): return 0.0, {helper}.AX
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with modules of the names of libraries, and a controller in two files."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = set(sys.modules)
    for name in STRAY:
        (tmp_path / f"{name}.py").write_text(f"open('ran-{name}', 'w'); raise SystemExit('stray')")
    (tmp_path / "own_helper_xy.py").write_text("AX = 0.25\n")
    (tmp_path / "own_xy.py").write_text(OWN.format(helper="own_helper_xy"))
    yield tmp_path
    assert not list(tmp_path.glob("ran-*"))
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def test_a_stray_file_is_neither_run_nor_in_the_way_of_a_command(folder):
    words = [sys.executable, "-m", "lpvmpc", "track", "--controller", "own_xy:Gone"]
    env = {k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"}
    done = subprocess.run(words, cwd=folder, env=env, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == (
        "Error: Controller 'own_xy:Gone' does not exist: module 'own_xy' has no class 'Gone'; it "
        "has Own.\n"
    )


def path_of(_):
    import random  # the standard library's: the stray one would end this process

    return random.__file__, list(sys.path)


def test_workers_have_the_path_of_their_parent(folder):
    with workers(2) as pool:
        ((file, path),) = pool.map(path_of, [0])
    assert path == [entry or os.getcwd() for entry in sys.path] and str(folder) not in file


def test_an_own_controller_is_loaded_from_its_file_after_the_libraries(folder):
    assert load_controller("own_xy:Own").command(None, None) == (0.0, 0.25)
    assert sys.path[-1] == str(folder) and own_module("own_xy") is sys.modules["own_xy"]
    import random

    assert str(folder) not in random.__file__


def test_an_own_file_may_be_named_like_a_library(folder):
    (folder / "secrets.py").write_text(OWN.format(helper="own_helper_xy"))
    assert load_controller("secrets:Own").command(None, None) == (0.0, 0.25)
    assert own_module("secrets") is own_module("secrets")
    import secrets

    assert secrets.token_hex and file_of("secrets") == folder / "secrets.py"


def test_a_module_in_a_package_of_the_current_folder_is_found(folder):
    (folder / "package_xy").mkdir()
    (folder / "package_xy" / "__init__.py").write_text("")
    (folder / "package_xy" / "law.py").write_text("from package_xy import __file__\nx = 3\n")
    assert own_module("package_xy.law").x == 3
    assert file_of("package_xy.law") == folder / "package_xy" / "law.py"
    assert file_of("package_xy") == folder / "package_xy" / "__init__.py"
    assert file_of("..law") is None and file_of("/etc/law") is None
