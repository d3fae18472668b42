"""The Dockerfile, read as a builder reads it: there is no docker where the tests run."""

import re
import tomllib
from fnmatch import fnmatch

import pytest

SOURCES = ("pyproject.toml", "README.md", "LICENSE", "constraints.txt", "lpvmpc/__init__.py",
           "lpvmpc/road/data", "models/vehicle.xml")
"""What the image is built from."""


@pytest.fixture
def steps(root):
    """The instructions: (name, rest), continued lines joined."""
    text = re.sub(r"\\\n\s*", "", (root / "Dockerfile").read_text())
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [tuple(line.split(" ", 1)) for line in lines]


@pytest.fixture
def project(root):
    return tomllib.loads((root / "pyproject.toml").read_text())["project"]


def ignored(root, path):
    """Whether .dockerignore keeps a path from the builder; its patterns begin at the root."""
    patterns = (root / ".dockerignore").read_text().split()
    parts = path.split("/")
    return any(fnmatch("/".join(parts[:n]), pattern.strip("/"))
               for pattern in patterns for n in range(1, len(parts) + 1))


def test_all_that_is_copied_is_there_and_reaches_the_builder(root, steps):
    (copied,) = [rest.split() for name, rest in steps if name in ("COPY", "ADD")]
    assert copied == [".", "/src"]
    for path in SOURCES:
        assert (root / path).exists() and not ignored(root, path), path
    assert ignored(root, ".git/config") and ignored(root, "runs/paper")


def test_the_base_image_has_a_python_that_the_project_is_for(steps, project):
    name, image = steps[0]
    version = re.fullmatch(r"python:(3\.\d+)-slim-bookworm", image)
    assert name == "FROM" and version is not None
    assert f"Programming Language :: Python :: {version[1]}" in project["classifiers"]


def test_what_is_installed_is_what_the_constraints_name(root, steps, project):
    (words,) = [rest.split() for name, rest in steps if name == "RUN" and "pip install" in rest]
    constraints, package = words[words.index("-c") + 1], words[-1].strip('"')
    assert constraints == "/src/constraints.txt"
    place, _, extra = package.rstrip("]").partition("[")
    assert place == "/src" and extra in project["optional-dependencies"]
    named = {line.partition("==")[0].lower().replace("_", "-")
             for line in (root / "constraints.txt").read_text().splitlines() if "==" in line}
    asked = [*project["dependencies"], *project["optional-dependencies"][extra]]
    missing = [need for need in asked if re.match(r"[\w-]+", need)[0].lower() not in named]
    assert missing == []


def test_the_image_has_the_opengl_that_the_message_about_it_asks_for(root, steps):
    (packages,) = [rest for name, rest in steps if name == "RUN" and "apt-get" in rest]
    message = (root / "lpvmpc" / "picture" / "video" / "stage.py").read_text()
    wanted = re.search(r"`apt-get install ([\w -]+)`", message)[1].split()
    assert len(wanted) == 3 and set(wanted) <= set(packages.split())
    assert "rm -rf /var/lib/apt/lists/*" in packages
    settings = dict(pair.split("=") for name, rest in steps if name == "ENV"
                    for pair in rest.split())
    assert settings["MUJOCO_GL"] == "egl"


def test_the_image_runs_the_command_where_the_users_folder_is(root, steps, project):
    last = dict(steps[-2:])
    assert last["WORKDIR"] == "/work"
    (command,) = re.findall(r'"(\S+)"', last["ENTRYPOINT"])
    assert command in project["scripts"]
    usage = (root / "Dockerfile").read_text()
    assert '-v "$PWD:/work" lpvmpc track' in usage


def test_the_citation_names_this_version_and_the_paper(root, project):
    text = (root / "CITATION.cff").read_text()
    fields = dict(re.findall(r"^([a-z-]+): *(.+)$", text, re.M))
    assert fields["cff-version"] == "1.2.0" and fields["type"] == "software"
    assert fields["version"] == project["version"] and fields["license"] == project["license"]
    released = re.search(rf"## \[{re.escape(project['version'])}\] - (\S+)",
                         (root / "CHANGELOG.md").read_text())
    assert fields["date-released"] == released[1]
    for key in ("title", "message", "authors", "references"):
        assert re.search(rf"^{key}:", text, re.M), key
