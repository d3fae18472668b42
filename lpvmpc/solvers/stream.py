"""The quadratic programs of a lap, as `lpv-mpc` meets them, and the file that keeps them.

A file is NumPy's .npz. `P, q, A, l, u` hold the condensed programs

    min 0.5 x'Px + q'x   subject to   l <= Ax <= u,

one after the other along the first axis: the names and the form of OSQP's Maros and Meszaros set.
Under the names of `control.horizon.Horizon` lies what they were condensed from, so that a solver
that keeps the states can be given the same program in stages (`staged`). `about` is a line of JSON
that says where they come from.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from lpvmpc.control.solver.checked import QPResult, QPSolver
from lpvmpc.errors import DataError, LPVMPCError
from lpvmpc.kit.files import read_bytes, writing
from lpvmpc.plant.plant import Plant
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.metrics import metrics
from lpvmpc.sim.names import load_controller, load_scenario
from lpvmpc.units import Array

Mask = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

CONDENSED = {"P": "H", "q": "g", "A": "C", "l": "lo", "u": "hi"}
"""Names in the file, and what `control.qp` calls them."""
STAGES = ("Ad", "Bd", "cd", "x_ref", "q_x", "r_du", "terminal", "z_ref", "x0", "u_before")
"""What the program in stages has besides: `q_x` are the weights of the states, `x0` is where the
plan begins, `u_before` the input before it."""
CONSTANTS = ("scale", "slack_weights")
"""What is the same in all periods."""
SHAPE = ("soft", "soft_every", "n_rates")
"""Whole numbers that say how rows are made of states."""
LARGEST = 2**30
"""Most bytes of a file, and of what it unpacks to: a thousand programs take a twentieth."""
DAMAGES = (OSError, ValueError, KeyError, EOFError, NotImplementedError, RuntimeError,
           zipfile.BadZipFile, zlib.error)
"""What reading a damaged file raises."""


class QP(NamedTuple):
    """One program in its condensed form; the units are those of `control.qp`."""

    H: Array
    """Hessian, shape (n, n)."""
    g: Array
    """Gradient, shape (n,)."""
    C: Array
    """Rows, shape (m, n)."""
    lo: Array
    """Lower bounds, shape (m,), -inf allowed."""
    hi: Array
    """Upper bounds, shape (m,), inf allowed."""


class Staged(NamedTuple):
    """The same program with the states kept.

    min 0.5 v'Pv + q'v   subject to   Ev = b,   lo + shift <= Fv <= hi + shift,

    v = (u_0, x_1, u_1, x_2, ..., u_{N-1}, x_N, slack); the rows F are those of the condensed
    program in their order, and so are their multipliers.
    """

    P: Array
    """Hessian, shape (nv, nv)."""
    q: Array
    """Gradient, shape (nv,)."""
    E: Array
    """Dynamics, shape (N nx, nv)."""
    b: Array
    """Their right sides, shape (N nx,)."""
    F: Array
    """Rows, shape (m, nv)."""
    shift: Array
    """What the states are without inputs, where the condensed rows have it in their bounds, shape
    (m,)."""


@dataclass(frozen=True, kw_only=True)
class Lap:
    """A closed loop whose programs are recorded."""

    key: str
    """Its name."""
    scenario: str
    """Name of the scenario."""
    grip: float | None
    """Share of the grip that its speed asks for; None: the scenario's own speed."""
    world: str
    """Name of the world."""


LAPS = (
    Lap(key="ideal", scenario="circuit", grip=0.65, world="ideal"),
    Lap(key="rtk", scenario="circuit", grip=0.87, world="rtk"),
    Lap(key="limit", scenario="circuit", grip=1.0, world="ideal"),
)
"""What is recorded: a calm lap, one with the noise of a test car, one at the limit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Stream:
    """The programs of a lap."""

    name: str
    """Its name."""
    about: Mapping[str, Any]
    """Where they come from."""
    arrays: Mapping[str, Array]
    """As in the file, by name."""

    def __len__(self) -> int:
        return len(self.arrays["P"])

    def qp(self, k: int) -> QP:
        """Program k, condensed."""
        return QP(*(self.arrays[name][k] for name in CONDENSED))

    @lru_cache(maxsize=4)  # noqa: B019 -- five solvers ask for the same one after the other
    def staged(self, k: int) -> Staged:
        """Program k, in stages."""
        a = self.arrays
        Bd, r_du, terminal = a["Bd"][k], a["r_du"][k], 2.0 * a["terminal"][k]
        scale, (linear, square) = a["scale"], a["slack_weights"]
        soft, every, n_rates = (int(a[name]) for name in SHAPE)
        N, nx, nu = Bd.shape
        nv, nz = N * (nx + nu) + 1, nx + nu
        u = [slice(i * nz, i * nz + nu) for i in range(N)]
        x = [slice(i * nz + nu, (i + 1) * nz) for i in range(N)]
        P, q = np.zeros((nv, nv)), np.zeros(nv)
        E, b = np.zeros((N * nx, nv)), np.zeros(N * nx)
        F = np.zeros((len(a["l"][k]), nv))
        price = np.diag(2.0 * r_du * scale**2)
        for i in range(N):
            P[x[i], x[i]] += np.diag(2.0 * a["q_x"][k, i])
            q[x[i]] -= 2.0 * a["q_x"][k, i] * a["x_ref"][k, i]
            P[u[i], u[i]] += price
            if i > 0:
                P[u[i - 1], u[i - 1]] += price
                P[u[i], u[i - 1]] -= price
                P[u[i - 1], u[i]] -= price
            rows = slice(i * nx, (i + 1) * nx)
            E[rows, x[i]] = -np.eye(nx)
            E[rows, u[i]] = Bd[i] * scale
            b[rows] = -a["cd"][k, i]
            if i > 0:
                E[rows, x[i - 1]] = a["Ad"][k, i]
            else:
                b[rows] -= a["Ad"][k, 0] @ a["x0"][k]
            F[i * nu : (i + 1) * nu, u[i]] = np.eye(nu)
            for m in range(n_rates):
                row = N * nu + i * n_rates + m
                F[row, u[i].start + m] = 1.0
                if i > 0:
                    F[row, u[i - 1].start + m] = -1.0
        q[u[0]] -= 2.0 * r_du * scale * a["u_before"][k]
        last = np.r_[x[-1], u[-1]]
        unit = np.concatenate([np.ones(nx), scale])
        P[np.ix_(last, last)] += terminal * np.outer(unit, unit)
        q[last] -= unit * (terminal @ a["z_ref"][k])
        P[-1, -1], q[-1] = 2.0 * square, linear
        shift = np.zeros(len(F))
        first, n_soft = N * (nu + n_rates), N // every
        for i in range(n_soft):
            step = (i + 1) * every - 1
            for row, sign in ((first + i, -1.0), (first + n_soft + i, 1.0)):
                F[row, x[step].start + soft] = 1.0
                F[row, -1] = sign
                shift[row] = self._free[k, step]
        F[first + 2 * n_soft, -1] = 1.0
        return Staged(P, q, E, b, F, shift)

    @cached_property
    def patterns(self) -> tuple[Mask, Mask, Mask]:
        """Where P, E and F in stages may differ from zero, as masks."""
        some = [self.staged(k) for k in np.linspace(0, len(self) - 1, 20).astype(int)]
        P, E, F = (
            np.any([np.not_equal(getattr(one, name), 0.0) for one in some], axis=0)
            for name in ("P", "E", "F")
        )
        return P | np.eye(len(P), dtype=bool), E, F

    @cached_property
    def _free(self) -> Array:
        """Response of the softly bounded state without inputs, shape (programs, N)."""
        a = self.arrays
        x, found = a["x0"], []
        for i in range(a["Ad"].shape[1]):
            x = np.einsum("kij,kj->ki", a["Ad"][:, i], x) + a["cd"][:, i]
            found.append(x[:, int(a["soft"])])
        return np.stack(found, axis=1)

    def condensed(self, v: Array) -> Array:
        """The variables of the condensed program among those in stages; shape (n,)."""
        N, nx, nu = self.arrays["Bd"].shape[1:]
        inputs = v[:-1].reshape(N, nx + nu)[:, :nu]
        return np.append(inputs.ravel(), v[-1])


TOUCHED = 1e-6
"""Distance from its bound at which a row counts as active."""


class Recorder:
    """Stands in a controller's place of the solver, and keeps what it is asked."""

    def __init__(self, controller: Any) -> None:
        self.controller, self.solver = controller, controller.solver
        self.kept: dict[str, list[Array]] = {name: [] for name in (*CONDENSED, *STAGES)}
        self.active: list[bool] = []

    def reset(self) -> None:
        """Forget everything."""
        self.solver.reset()
        self.active.clear()
        for values in self.kept.values():
            values.clear()

    def solve(self, H: Array, g: Array, C: Array, lo: Array, hi: Array) -> QPResult:
        """Keep the program, and solve it."""
        h = self.controller.horizon
        nx = h.Ad.shape[1]
        now = {
            "P": H, "q": g, "A": C, "l": lo, "u": hi, "q_x": h.q, "u_before": h.queue[-1],
            "x0": h.schedule[0, h.schedule.shape[1] - nx :],
        }
        for name, values in self.kept.items():
            values.append(np.array(now[name] if name in now else getattr(h, name)))
        result: QPResult = self.solver.solve(H, g, C, lo, hi)
        # the slack is at its bound nearly always
        rows = C[:-1] @ result.z
        touched = np.minimum(rows - lo[:-1], hi[:-1] - rows) < TOUCHED
        self.active.append(bool(touched.any()))
        return result


def record(lap: Lap, count: int, seed: int = 0) -> Stream:
    """Drive a lap with `lpv-mpc`, and keep programs from all over it.

    Args:
        lap: What is driven.
        count: How many are kept, evenly spread over the lap, and besides at most as many with an
            active row, which are rare: evenly spread over those.
        seed: Of the closed loop.

    Raises:
        LPVMPCError: The car did not complete the lap.
    """
    controller: Any = load_controller("lpv-mpc")
    assert isinstance(controller.solver, QPSolver)
    recorder = controller.solver = Recorder(controller)
    options: dict[str, Any] = {} if lap.grip is None else {"grip": lap.grip}
    scenario = load_scenario(lap.scenario, **options)
    log = simulate(Plant(), controller, scenario, world=lap.world, seed=seed)
    result = metrics(log)
    if not result["completed"]:
        raise LPVMPCError(f"The lap {lap.key!r} was not completed: {result['reason']}.")
    periods = len(recorder.kept["P"])
    chosen = np.union1d(
        _spread(np.arange(periods), count), _spread(np.flatnonzero(recorder.active), count)
    )
    arrays = {name: np.stack([values[i] for i in chosen]) for name, values in recorder.kept.items()}
    h = controller.horizon
    arrays |= {name: np.array(getattr(h, name)) for name in CONSTANTS}
    shape = dict(zip(SHAPE, (h.soft, h.soft_every, len(h.du_max)), strict=True))
    arrays |= {name: np.array(value) for name, value in shape.items()}
    about = {
        "controller": "lpv-mpc", "scenario": lap.scenario, "grip": lap.grip, "world": lap.world,
        "seed": seed, "periods": periods,
    }
    return Stream(name=lap.key, about=about, arrays=arrays)


def _spread(places: IntArray, count: int) -> IntArray:
    """Some of the places, evenly spread over them."""
    if len(places) <= count:
        return places
    return places[np.linspace(0, len(places) - 1, count).round().astype(int)]


def save(file: str | os.PathLike[str], stream: Stream) -> None:
    """Write a stream.

    Raises:
        OutputError: It cannot be written.
    """
    about = json.dumps({"name": stream.name, **stream.about})
    with writing(file), open(file, "wb") as out:
        np.savez_compressed(out, about=np.array(about), **stream.arrays)  # type: ignore[arg-type]


def load(file: str | os.PathLike[str]) -> Stream:
    """Read a stream.

    Raises:
        DataError: The file is missing, damaged, or holds no such programs.
    """
    path = os.fspath(file)
    try:
        raw = io.BytesIO(read_bytes(path, LARGEST))
        with zipfile.ZipFile(raw) as parts:  # which may say that it unpacks to more than memory has
            if sum(part.file_size for part in parts.infolist()) > LARGEST:
                raise ValueError(f"it unpacks to more than {LARGEST // 2**20} MiB")
        with np.load(raw, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
        about = json.loads(str(arrays.pop("about")))
        if not isinstance(about, dict):
            raise ValueError("its line on where they come from is no table")
    except DAMAGES as error:
        why = getattr(error, "strerror", None) or " ".join(str(error).split())[:120]
        raise DataError(f"The file {path!r} holds no programs that can be read: {why}.") from error
    lacking = [n for n in (*CONDENSED, *STAGES, *CONSTANTS, *SHAPE) if n not in arrays]
    if lacking:
        raise DataError(f"The file {path!r} holds no programs of a lap: no array {lacking[0]!r}.")
    _check(path, arrays)
    return Stream(name=str(about.pop("name", "")), about=about, arrays=arrays)


def _check(path: str, arrays: Mapping[str, Array]) -> None:
    """Refuse arrays that are no programs: of the wrong kind or shape, or with NaN.

    Raises:
        DataError: Which of them it is.
    """
    count = {name: len(a) if a.ndim else 0 for name, a in arrays.items()}
    wrong = [name for name, a in arrays.items() if a.dtype.kind not in "biuf" or np.isnan(a).any()]
    wrong += [name for name in SHAPE if arrays[name].shape != ()]
    wrong += [name for name in (*CONDENSED, *STAGES)
              if count[name] != count["P"] or not count[name]]
    if not wrong:
        (n, m), nx = (arrays[name].shape[-1] for name in ("P", "l")), arrays["x0"].shape[-1]
        N, nu = arrays["Bd"].shape[1:2], arrays["u_before"].shape[-1]
        shapes = {"P": (n, n), "q": (n,), "A": (m, n), "l": (m,), "u": (m,), "Ad": (*N, nx, nx),
                  "Bd": (*N, nx, nu), "cd": (*N, nx), "x_ref": (*N, nx), "q_x": (*N, nx)}
        wrong = [name for name, shape in shapes.items() if arrays[name].shape[1:] != shape]
    if wrong:
        raise DataError(f"The file {path!r} holds no programs of a lap: its array {wrong[0]!r} is "
                        "damaged.")
