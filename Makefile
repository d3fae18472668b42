# make track  drive the paper's road: table, metrics, figures and video
# make test   run the tests
# make lint   ruff, mypy, which package may import which, spelling
# make docs   the site of all pages and of the reference, in site/; warnings are errors
# make clean  remove the environment and what the tools left behind
#
# Each target makes .venv and installs the versions of constraints.txt first. The stamps depend on
# the project file and the constraints, so an edit there installs again.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet --constraint constraints.txt

.DELETE_ON_ERROR:
.PHONY: track test lint docs clean egl

track: $(VENV)/.run egl
	$(BIN)/lpvmpc track --scenario paper --render $(ARGS)

test: $(VENV)/.dev egl
	$(BIN)/python -m pytest -n 2 $(ARGS)

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/codespell

docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "lpvmpc needs Python 3.11 or newer, but $(PYTHON) is $$($(PYTHON) --version 2>&1);" \
	         "name another one with: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.run: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) --editable .
	@touch $@

$(VENV)/.dev: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) --editable ".[dev]"
	@touch $@ $(VENV)/.run

$(VENV)/.docs: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) --editable ".[docs]"
	@touch $@

# Pictures need an OpenGL that works without a display. Only a warning: all else works without it.
egl: | $(BIN)/python
	@if [ "$${MUJOCO_GL:-egl}" = egl ]; then $(BIN)/python -c \
	  'import ctypes.util, sys; sys.exit(not ctypes.util.find_library("EGL"))' || \
	  echo "No EGL here, so no video: install it with: apt-get install libegl1 libgl1-mesa-dri" >&2; fi

clean:
	rm -rf $(VENV) build dist site .pytest_cache .ruff_cache .mypy_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
