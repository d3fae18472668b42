import os
import re
import subprocess
import sys
import time
import tomllib
import zipfile
from collections import Counter
from pathlib import Path

import pytest

import lpvmpc
from lpvmpc import _numba_cache
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import commit, machine, versions


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel's contents, unpacked in a folder far from the sources."""
    root = Path(__file__).parents[1]
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=root, check=True, capture_output=True,
    )
    (file,) = folder.glob("*.whl")
    with zipfile.ZipFile(file) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


def test_the_wheel_carries_models_data_and_types(wheel, root):
    packed = {str(file.relative_to(wheel)) for file in wheel.rglob("*") if file.is_file()}
    for model in (root / "models").iterdir():
        assert f"lpvmpc/models/{model.name}" in packed
    assert "lpvmpc/py.typed" in packed
    for data in (root / "lpvmpc" / "control" / "weights").iterdir():
        assert f"lpvmpc/control/weights/{data.name}" in packed
    for data in ("road/data/paper.json", "studies/data/tire_golden.json"):
        assert f"lpvmpc/{data}" in packed


def test_the_wheel_works_from_another_folder(wheel, tmp_path):
    code = (
        "import lpvmpc; from lpvmpc import Plant, load_scenario;"
        f"assert lpvmpc.__file__.startswith({str(wheel)!r});"
        "assert Plant().params.m > 1000; assert load_scenario('paper').path.length > 1000"
    )
    environment = {**os.environ, "PYTHONPATH": str(wheel)}
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, check=True)


def test_the_wheel_brings_the_command(wheel, tmp_path):
    (file,) = wheel.glob("*.dist-info/entry_points.txt")
    script = re.search(r"^lpvmpc = ([\w.]+):(\w+)$", file.read_text(), re.M)
    environment = {**os.environ, "PYTHONPATH": str(wheel)}

    def say(*words):
        return subprocess.run([sys.executable, *words], cwd=tmp_path, env=environment, check=True,
                              capture_output=True, text=True).stdout

    assert "--scenario" in say("-m", "lpvmpc", "track", "--help")
    code = f"import sys; from {script[1]} import {script[2]}; sys.exit({script[2]}())"
    assert say("-c", code) == say("-m", "lpvmpc")


@pytest.mark.slow
def test_the_wheel_drives_from_an_empty_folder(wheel, tmp_path):
    """Everything is compiled anew: the code lies elsewhere."""
    environment = {**os.environ, "PYTHONPATH": str(wheel)}
    said = subprocess.run(
        [sys.executable, "-m", "lpvmpc", "track", "--scenario", "slalom"],
        cwd=tmp_path, env=environment, check=True, capture_output=True, text=True,
    )
    assert "Completed." in said.stdout
    assert (tmp_path / "runs" / "slalom-lpv-mpc" / "metrics.json").exists()


def test_the_versions_of_package_and_project_agree(root):
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    assert project["version"] == lpvmpc.__version__
    assert f"version: {lpvmpc.__version__}" in (root / "CITATION.cff").read_text()


def test_the_constraints_are_exact_and_cover_every_dependency(root):
    lines = (root / "constraints.txt").read_text().splitlines()
    pins = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    assert pins["torch"] == "2.13.0"
    pinned = {name.lower().replace("_", "-") for name in pins}
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = project["dependencies"] + [
        entry for name in ("dev", "train", "docs", "gym", "rl", "solvers") for entry in extras[name]
    ]
    names = {re.match(r"[\w-]+", entry)[0].lower() for entry in wanted}
    assert names - {"lpvmpc"} <= pinned


def test_every_public_name_exists():
    for name in lpvmpc.__all__:
        assert getattr(lpvmpc, name) is not None
    assert set(lpvmpc.__all__) <= set(dir(lpvmpc))
    with pytest.raises(AttributeError, match="no attribute 'absent'"):
        lpvmpc.absent  # noqa: B018


def test_importing_the_package_imports_nothing_heavy():
    code = "import sys, lpvmpc, lpvmpc.kit.cli; print(*sys.modules)"
    modules = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout.split()
    heavy = {"numba", "mujoco", "proxsuite", "scipy", "pyarrow", "matplotlib", "torch", "cv2", "av"}
    assert not heavy & set(modules)


def test_help_comes_quickly(root):
    # The promise is 1.5 s of an idle machine; processor time of the child, so that a busy one
    # does not fail it.
    best = min(_cpu_of([sys.executable, str(root / "eval" / "track.py"), "--help"])
               for _ in range(3))
    assert best < 1.5


def _cpu_of(command):
    before = os.times()
    subprocess.run(command, check=True, capture_output=True)
    after = os.times()
    return after.children_user + after.children_system - (
        before.children_user + before.children_system
    )


def test_driving_imports_nothing_for_pictures_or_training():
    code = "import sys; from lpvmpc import LPVMPC, Plant, load_scenario; print(*sys.modules)"
    modules = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout.split()
    assert not {"torch", "matplotlib", "cv2", "av", "gymnasium", "pyarrow"} & set(modules)


def test_a_result_names_versions_machine_and_commit():
    assert versions()["lpvmpc"] == lpvmpc.__version__
    assert "numpy" in versions() and "core" in machine()
    assert commit() is None or re.fullmatch(r"[\w.-]+", commit())


def test_a_change_of_the_code_is_told_and_one_of_the_results_is_not(tmp_path):
    files = tmp_path / "lpvmpc" / "code.py", tmp_path / "docs" / "results" / "table.md"
    for file in files:
        file.parent.mkdir(parents=True)
        file.write_text("one\n")
    for words in (
        ["init", "-q"],
        ["add", "."],
        ["-c", "user.name=a", "-c", "user.email=a@b.c", "commit", "-qm", "one"],
    ):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    clean = commit(files[0].parent)  # which is kept for the life of a process
    commit.cache_clear()
    assert re.fullmatch("[0-9a-f]{12}", clean)
    files[1].write_text("two\n")
    assert commit(files[0].parent) == clean
    commit.cache_clear()
    files[0].write_text("two\n")
    assert commit(files[0].parent) == f"{clean}-dirty"


def test_a_markdown_table_lines_up():
    text = markdown_table("Lengths", ["name", "m"], [["long one", 1.5], ["a", 22]])
    assert text.splitlines() == [
        "**Lengths**",
        "",
        "| name     |   m |",
        "|----------|----:|",
        "| long one | 1.5 |",
        "| a        |  22 |",
    ]


# What one can walk through -----------------------------------------------------------------------


def sizes(package):
    """Lines of every file of a package, by path, and files of every folder in it."""
    lines = {
        file.relative_to(package).as_posix(): len(file.read_text().splitlines())
        for file in package.rglob("*.py")
    }
    return lines, Counter(str(Path(file).parent) for file in lines)


def test_no_file_is_longer_than_400_lines_and_no_package_larger_than_16_files(root):
    lines, files = sizes(root / "lpvmpc")
    assert {"control/qp.py", "studies/parts/circle.py"} <= set(lines)  # that anything is counted
    assert {file: n for file, n in lines.items() if n > 400} == {}
    assert {folder: n for folder, n in files.items() if n > 16} == {}
    assert 1 <= files["."] <= 8


def test_a_package_grown_too_large_is_seen(tmp_path):
    inner = tmp_path / "inner"
    inner.mkdir()
    for i in range(17):
        (inner / f"{i}.py").write_text("x = 1\n" * (401 if i == 3 else 1))
    lines, files = sizes(tmp_path)
    assert lines["inner/3.py"] == 401 and lines["inner/4.py"] == 1
    assert files == {"inner": 17}


# The cache of compiled code ---------------------------------------------------------------------


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "package"
    folder.mkdir()
    (folder / "fast.py").write_text("from numba import njit\n")
    (folder / "plain.py").write_text("x = 1\n")
    return folder


def test_the_cache_key_changes_with_compiled_code_and_mujoco_only(package):
    key = _numba_cache.cache_key(package, "4.0.0")
    (package / "plain.py").write_text("x = 2\n")
    assert _numba_cache.cache_key(package, "4.0.0") == key
    assert _numba_cache.cache_key(package, "4.0.1") != key
    (package / "fast.py").write_text("from numba import njit  # edited\n")
    assert _numba_cache.cache_key(package, "4.0.0") != key


def test_old_caches_are_removed(tmp_path):
    for i in range(_numba_cache.KEEP + 2):
        (tmp_path / f"numba-{i}").mkdir()
        os.utime(tmp_path / f"numba-{i}", (i, i))
    _numba_cache._remove_old(tmp_path)
    left = sorted(folder.name for folder in tmp_path.iterdir())
    assert left == sorted(f"numba-{i}" for i in range(3, _numba_cache.KEEP + 2))


def test_a_chosen_cache_folder_is_respected(monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/somewhere/else")
    _numba_cache.place_numba_cache()
    assert os.environ["NUMBA_CACHE_DIR"] == "/somewhere/else"


def test_a_home_that_cannot_be_written_does_not_stop_the_import():
    environment = {**os.environ, "XDG_CACHE_HOME": "/proc/absent"}
    environment.pop("NUMBA_CACHE_DIR", None)
    start = time.monotonic()
    subprocess.run([sys.executable, "-c", "import lpvmpc"], env=environment, check=True)
    assert time.monotonic() - start < 30.0
