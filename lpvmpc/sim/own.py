"""A user's modules, loaded from their files: the current folder never hides a library.

What lies there beside a module can be imported by it, after everything else; a stray `random.py` or
`numpy.py` is neither run nor in the way.
"""

from __future__ import annotations

import importlib.machinery
import importlib.util
import os
import sys
from importlib import import_module, invalidate_caches
from pathlib import Path
from types import ModuleType


def own_module(name: str) -> ModuleType:
    """A module from the current folder, or else one that Python finds by its path.

    Args:
        name: Its name as in `import`. A file of the current folder goes before everything else of
            that name, and is loaded beside it.

    Raises:
        ImportError: There is none, or what it imports is not there; besides, whatever it raises.
    """
    file = file_here(name)
    if file is None:
        return import_module(name)
    here = os.getcwd()
    if here not in sys.path:
        sys.path.append(here)
    invalidate_caches()  # it may have been written just now
    if _lies_in(_found(name), file):
        return import_module(name)
    other = f"own_{name.replace('.', '_')}"
    if other in sys.modules and _lies_in(sys.modules[other].__spec__, file):
        return sys.modules[other]
    spec = importlib.util.spec_from_file_location(other, file)
    assert spec is not None and spec.loader is not None  # it ends in .py
    module = importlib.util.module_from_spec(spec)
    sys.modules[other] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        sys.modules.pop(other, None)
        raise
    return module


def file_of(name: str) -> Path | None:
    """File of a user's module, where it is found."""
    here = file_here(name)
    if here is not None:
        return here
    spec = _found(name)
    if spec is None or not spec.has_location or spec.origin is None:
        return None
    return Path(spec.origin)


def file_here(name: str) -> Path | None:
    """File of a module in the current folder; None where there is none."""
    parts = name.split(".")
    if not all(parts) or any(os.sep in part for part in parts):
        return None
    below = Path(*parts)
    for file in (below.parent / f"{below.name}.py", below / "__init__.py"):
        if file.is_file():
            return file.absolute()
    return None


def _found(name: str) -> importlib.machinery.ModuleSpec | None:
    """Where Python would find it."""
    try:
        return importlib.util.find_spec(name)
    except (ImportError, ValueError):
        return None


def _lies_in(spec: importlib.machinery.ModuleSpec | None, file: Path) -> bool:
    """Whether a module was found in a file."""
    if spec is None or not spec.has_location or spec.origin is None:
        return False
    return os.path.exists(spec.origin) and os.path.samefile(spec.origin, file)
