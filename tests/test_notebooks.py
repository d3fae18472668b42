"""The notebooks are the examples' scripts, and run in a kernel of Jupyter."""

import json
import re
import runpy
from pathlib import Path

import pytest
from test_examples import SAYS

FOLDER = Path(__file__).parents[1] / "examples" / "notebooks"
NAMES = sorted(file.stem for file in FOLDER.glob("*.ipynb"))
MAKE = runpy.run_path(str(FOLDER / "make.py"))


@pytest.mark.parametrize("name", sorted(script.stem for script in MAKE["scripts"]()))
def test_a_notebook_is_its_script(name):
    file = FOLDER / f"{name}.ipynb"
    written = MAKE["notebook"](FOLDER.parent / f"{name}.py")
    assert file.read_text(encoding="utf-8") == written, "run python examples/notebooks/make.py"
    nbformat = pytest.importorskip("nbformat")
    nbformat.validate(nbformat.reads(written, as_version=4))


def test_every_example_but_the_bare_class_has_one():
    assert sorted([*NAMES, "mine"]) == sorted(SAYS)


def test_no_statement_is_lost(tmp_path):
    """A script's cells, one after the other, are the script without its guard."""
    script = tmp_path / "one.py"
    script.write_text(
        '"""A title.\n\nMore.\n"""\n\nimport os\n\nimport re\n\n\n@staticmethod\ndef f():\n'
        '    a = 1\n\n    return a\n\n\nif __name__ == "__main__":\n    # why\n    x = 1\n'
        "    y = 2\n\n    print(x)\n"
    )
    cells = json.loads(MAKE["notebook"](script))["cells"]
    assert ["".join(cell["source"]) for cell in cells] == [
        "# A title.\n\nMore.", "import os\n\nimport re",
        "@staticmethod\ndef f():\n    a = 1\n\n    return a", "# why\nx = 1\ny = 2", "print(x)",
    ]


def test_the_notebooks_run(tmp_path, monkeypatch):
    """All in one kernel, which forgets what it knew in between: its start costs the most."""
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    for variable in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(variable, str(tmp_path / variable))
    whole, ends = nbformat.v4.new_notebook(), {}
    for name in NAMES:
        whole.cells += nbformat.read(FOLDER / f"{name}.ipynb", as_version=4).cells
        ends[name] = len(whole.cells)
        whole.cells.append(nbformat.v4.new_code_cell("%reset -f"))
    folder = tmp_path / "work"
    folder.mkdir()
    where = {"metadata": {"path": str(folder)}}
    nbclient.NotebookClient(whole, timeout=900, kernel_name="python3", resources=where).execute()
    first = 0
    for name, end in ends.items():
        out = [one for cell in whole.cells[first:end] for one in cell.get("outputs", [])]
        assert {one.get("name") for one in out} == {"stdout"}, (name, out)  # no warnings, no error
        text = "".join(one["text"] for one in out)
        assert re.search(SAYS[name], text), (name, text)
        first = end
