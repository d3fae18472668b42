"""Where numba keeps the machine code of this package between runs.

numba notices when the file of a compiled function changes, but neither a change in a function of
another file that was inlined into it, nor another MuJoCo whose structs are laid out differently
(plant/callbacks.py compiles their offsets in). Either would silently run old code. So the cache
folder carries a key of both: an edit of any compiled file, or another MuJoCo, starts an empty one.
"""

import hashlib
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

KEEP = 6
"""Number of cache folders kept; the oldest are removed when a new one is made."""

_UNIX = hasattr(os, "getuid")


def cache_key(package: Path, mujoco_version: str) -> str:
    """Key of the compiled code: MuJoCo's version and the text of every file that uses numba."""
    digest = hashlib.sha256(mujoco_version.encode())
    for file in sorted(package.rglob("*.py")):
        text = file.read_bytes()
        if b"numba" in text and file.name != "_numba_cache.py":
            digest.update(file.name.encode() + b"\0" + text)
    return digest.hexdigest()[:16]


def place_numba_cache() -> None:
    """Point numba at the folder of our key, unless the user has chosen one (NUMBA_CACHE_DIR).

    Where the user's cache cannot be written, the folder lies among the temporary ones.
    """
    if os.environ.get("NUMBA_CACHE_DIR"):
        return
    name = f"numba-{cache_key(Path(__file__).parent, _mujoco_version())}"
    for root in _roots():
        folder = root / name
        try:
            if not folder.exists():
                root.mkdir(parents=True, exist_ok=True)
                _remove_old(root)
                folder.mkdir(exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK | os.X_OK):
            break
    else:
        return  # numba looks for itself, and says that there is none
    os.environ["NUMBA_CACHE_DIR"] = str(folder)  # worker processes inherit it
    if "numba" in sys.modules:  # it has read its environment already
        sys.modules["numba"].config.CACHE_DIR = str(folder)


def _roots() -> Iterator[Path]:
    """Folders for the cache, the first that can be written is taken."""
    with suppress(RuntimeError):  # nobody's home
        yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "lpvmpc"
    with suppress(OSError):  # not even a temporary folder
        root = Path(tempfile.gettempdir()) / f"lpvmpc-{os.getuid() if _UNIX else ''}"
        root.mkdir(mode=0o700, exist_ok=True)
        status = root.lstat()  # in a folder of everybody's, others could place code to be run
        if stat.S_ISDIR(status.st_mode) and (not _UNIX or status.st_uid == os.getuid()):
            yield root


def _mujoco_version() -> str:
    """Version of MuJoCo by the name of its metadata folder.

    Neither `import mujoco` nor importlib.metadata: they would cost `import lpvmpc` 300 and 30 ms.
    """
    spec = find_spec("mujoco")
    if spec is None or spec.origin is None:
        return "none"
    site = Path(spec.origin).parent.parent
    return ",".join(sorted(folder.name for folder in site.glob("mujoco*.dist-info")))


def _remove_old(root: Path) -> None:
    """Remove all but the newest cache folders; a folder in use only costs compiling again."""
    folders = sorted(root.glob("numba-*"), key=lambda f: f.stat().st_mtime, reverse=True)
    for folder in folders[KEEP - 1 :]:
        shutil.rmtree(folder, ignore_errors=True)
