"""The arrays and constants of one control period, for Python by name and for compiled code at once.

numba looks at every argument of a call: 24 of them cost 4 us, a handle costs 1 us. So compiled
functions take `Horizon.handle`, a numba structref whose fields have the names of `Horizon` and
share its arrays; `@njit(cache=True)` keeps such functions between processes.

Sizes: a horizon of N periods, of which N / n share one frozen model; nx states and nu inputs of the
model; ns states along the plan, of which the first ns - nx are taken as they are measured.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numba import njit, types
from numba.experimental import structref

from lpvmpc.control.qp import n_rows
from lpvmpc.units import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Horizon:
    """What one control period reads and writes; `allocated` makes it."""

    # model
    Ts: float
    """Control period [s]."""
    car: Array
    """Constants of the model's car, as its compiled code orders them."""
    form: int
    """`bicycle.CORRECTED` or PRINTED."""
    method: int
    """`bicycle.EXACT` or EULER."""
    Ad: Array
    """Transition matrices, shape (N, nx, nx)."""
    Bd: Array
    """Input matrices, shape (N, nx, nu)."""
    cd: Array
    """Constant terms, shape (N, nx)."""
    axle_forces: Array
    """Affine forces (Cf [N/rad], F0f [N], Cr, F0r) of the axles per interval, shape (n, 4)."""

    # cost
    decoupled: int
    """Whether speed errors never steer: the steering's effect on the speed is taken as planned, and
    the path is looked at where the car will be, not where its reference would."""
    damped: int
    """Whether the model is frozen along the mean of the last two predictions."""
    steady: int
    """Whether the states' reference is steady cornering; else speed alone, the others zero."""
    x_ref: Array
    """Reference of the states at steps 1..N, shape (N, nx)."""
    q: Array
    """Diagonal weights of the states at steps 1..N, shape (N, nx)."""
    q_noisy: Array
    """The same where the measurements are noisy, shape (N, nx)."""
    calm: float
    """Factor on the weights of ey and epsi where they are not; 1: no difference is made."""
    calm_gain: float
    """Gain of the observer there."""
    quiet: Array
    """How free of noise the measurements are, 0 to 1: for the observer, and for the weights, where
    a late command counts as well; shape (2,)."""
    r_du: Array
    """Diagonal weights of the inputs' increments, shape (nu,)."""
    table: Array
    """Terminal weights, at each of `cost.SPEEDS` for one of `table_lags` after the other, shape
    (16 n_lags, nx + nu, nx + nu); where `calm` is not 1, those for quiet measurements after them,
    as many."""
    table_lags: Array
    """Lags of steering and drive that the terminal weights are for [s], shape (n_lags, 2)."""
    terminal: Array
    """Terminal weight of this period, symmetric, shape (nx + nu, nx + nu)."""
    z_ref: Array
    """Its reference, shape (nx + nu,)."""
    slack_weights: Array
    """Linear and quadratic penalty of the slack, shape (2,)."""

    # bounds
    delta_max: float
    """Largest steering angle [rad]."""
    slip_cap: float
    """Largest front slip angle that a command may ask for, on a dry road [rad]."""
    drive: Array
    """Largest braking [m/s2], drive force [N], power [W], mass with the wheels' spin [kg]."""
    wheels: Array
    """Wheel radius [m], half the front track [m], smallest speed at which slip means something
    [m/s], largest lateral acceleration on a dry road [m/s2], share of the drive on the front axle;
    for traction control."""
    traction: int
    """Whether there is traction control."""
    u_lo: Array
    """Lower bounds of the inputs, shape (N, nu)."""
    u_hi: Array
    """Upper bounds of the inputs, shape (N, nu)."""
    du_max: Array
    """Largest increments of the first inputs, shape (n_rates,); the others have none."""
    soft: int
    """Index of the softly bounded state."""
    soft_every: int
    """The soft bound holds at every this many steps, a divisor of N."""
    soft_bound: Array
    """The soft bound itself: |x[soft]| <= soft_bound + slack, shape (1,)."""
    approach: int
    """Whether a car far beside its path is led back to it, not pulled."""

    # the QP, see `qp.condense`
    scale: Array
    """Unit of each input inside the QP, shape (nu,)."""
    free: Array
    """Free response of the states at steps 1..N, shape (N, nx)."""
    forced: Array
    """Forced response of the states to the QP's inputs, shape (N, nx, N nu)."""
    H: Array
    """Hessian, shape (N nu + 1, N nu + 1)."""
    g: Array
    """Gradient, shape (N nu + 1,)."""
    C: Array
    """Constraint matrix, shape (rows, N nu + 1)."""
    lo: Array
    """Lower bounds of the rows, shape (rows,)."""
    hi: Array
    """Upper bounds of the rows, shape (rows,)."""

    # from one period to the next
    plan: Array
    """Commands (delta [rad], ax [m/s2]) of the horizon, shape (N, 2)."""
    prediction: Array
    """States predicted under the plan, now included, shape (N + 1, ns)."""
    schedule: Array
    """States along which the model is frozen; the first one is where the plan begins: measured,
    and predicted over the delay. Shape (N + 1, ns)."""
    knots: Array
    """The schedule at the ends of the intervals that share a model, shape (n + 1, ns)."""
    delay: int
    """Known periods until a command takes effect."""
    lateness: Array
    """Periods beyond them, as learned, a whole number, shape (1,)."""
    queue: Array
    """Commands, that of the period before last; those on their way to the car are the last ones,
    shape (delay + 1 or more, 2)."""
    x_last: Array
    """State measured in the period before, shape (ns,)."""
    kappa_last: Array
    """Curvature of the period before [1/m], shape (1,)."""
    predicted: Array
    """State that was expected for now, shape (ns,)."""
    inner: Array
    """Expectation of what is not measured: a, slip angles, roll; shape (5,)."""
    gain: Array
    """Gain of the disturbance observer on (vx, vy, r), shape (3,)."""
    disturbance: Array
    """Estimated acceleration that the model lacks, of (vx, vy, r), shape (3,)."""
    unmodelled: Array
    """Acceleration of (vy, r) that the model without observer left unexplained, shape (2,)."""
    driven: Array
    """What drive and brakes gave at its end, as the measured acceleration tells it [m/s2], shape
    (1,)."""
    acting: Array
    """Affine forces of the axles in the period before, shape (4,)."""
    slips: Array
    """Mean slip angles of the axles in it [rad], shape (2,)."""
    noise: Array
    """Variance of what the observer sees from one period to the next, squared units of the
    disturbance, and that of ey and epsi, as rates, shape (5,)."""
    error: Array
    """What the observer saw in the period before, shape (5,)."""
    walk: Array
    """How far a disturbance is believed to move within a second, shape (3,); infinite: as far as
    the gain lets it."""
    allowed: Array
    """What traction control allows and believes, all positive [m/s2], shape (5,): drive, brakes,
    braking that locked a wheel, braking that the road holds on a straight, lateral acceleration
    that bends are driven with."""

    def __post_init__(self) -> None:
        """Make the handle; numbers of one kind, so that all handles have one type."""
        values = [getattr(self, name) for name in _TYPES]
        for i, type_ in enumerate(_TYPES.values()):
            if not isinstance(type_, types.Array):
                values[i] = int(values[i]) if type_ is types.int64 else float(values[i])
        object.__setattr__(self, "handle", _make(tuple(values)))

    handle: Any = None
    """The same for compiled functions: fields by name, arrays shared, numbers copied."""

    @classmethod
    def allocated(
        cls,
        N: int,
        nx: int,
        nu: int,
        *,
        q: Array,
        r_du: Array,
        du_max: Array,
        scale: Array,
        car: Array,
        table: Array | None = None,
        ns: int | None = None,
        delay: int = 0,
        unknown: int = 0,
        soft_every: int = 1,
        **constants: Any,
    ) -> Horizon:
        """Arrays of zeros, but for what is given.

        Args:
            N: Periods of the horizon.
            nx: States of the model.
            nu: Inputs of the model.
            q: See the fields, also for the rest.
            r_du: As above.
            du_max: As above.
            scale: As above.
            car: As above.
            table: As above; no terminal weight by default.
            ns: As above; nx by default.
            delay: Periods until a command takes effect.
            unknown: Periods by which that may be later.
            soft_every: As above; so many periods share one model.
            constants: Other fields that are no zeros.
        """
        n, z, ns = N // soft_every, nx + nu, ns or nx
        columns, rows = N * nu + 1, n_rows(N, nu, len(du_max), soft_every)
        shapes: dict[str, tuple[int, ...]] = {
            "Ad": (N, nx, nx), "Bd": (N, nx, nu), "cd": (N, nx), "axle_forces": (n, 4),
            "x_ref": (N, nx), "terminal": (z, z), "z_ref": (z,), "slack_weights": (2,),
            "drive": (4,), "wheels": (5,), "u_lo": (N, nu), "u_hi": (N, nu),
            "free": (N, nx), "forced": (N, nx, N * nu), "H": (columns, columns),
            "g": (columns,), "C": (rows, columns), "lo": (rows,), "hi": (rows,),
            "plan": (N, 2), "prediction": (N + 1, ns), "schedule": (N + 1, ns),
            "knots": (n + 1, ns),
            "queue": (delay + unknown + 1, 2), "x_last": (ns,), "kappa_last": (1,),
            "predicted": (ns,), "inner": (5,), "gain": (3,), "disturbance": (3,),
            "unmodelled": (2,), "acting": (4,), "slips": (2,), "allowed": (5,), "lateness": (1,),
            "soft_bound": (1,), "table_lags": (1, 2), "driven": (1,), "noise": (5,), "error": (5,),
            "walk": (3,), "quiet": (2,),
        }
        if "table_lags" in constants:
            shapes["table_lags"] = np.shape(constants["table_lags"])
        arrays: dict[str, Any] = {name: np.zeros(shape) for name, shape in shapes.items()}
        arrays["soft_bound"][:] = arrays["walk"][:] = np.inf
        for name in [name for name in arrays if name in constants]:
            arrays[name][...] = constants.pop(name)
        numbers: dict[str, Any] = {
            "form": 0, "method": 0, "steady": 0, "delta_max": np.inf, "slip_cap": np.inf,
            "traction": 0, "soft": 0, "decoupled": 0, "damped": 0, "approach": 0, "calm": 1.0,
            "calm_gain": 0.0,
        }
        return cls(
            q=q.copy(),
            q_noisy=q.copy(),
            r_du=r_du.copy(),
            du_max=du_max.copy(),
            scale=scale.copy(),
            car=car.copy(),
            table=np.zeros((0, z, z)) if table is None else table.copy(),
            soft_every=soft_every,
            delay=delay,
            **arrays,
            **(numbers | constants),
        )

    def forget(self) -> None:
        """Start anew: nothing planned, nothing predicted, nothing observed."""
        for array in (
            self.plan, self.prediction, self.schedule, self.knots, self.queue, self.x_last,
            self.kappa_last, self.inner, self.disturbance, self.lateness, self.noise, self.error,
            self.quiet,
        ):
            array[...] = 0.0
        self.allowed[:] = np.inf

    def __getstate__(self) -> dict[str, Any]:
        """All but the handle, which is made anew from them."""
        return {name: value for name, value in vars(self).items() if name != "handle"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """The arrays of another process, and a handle of this one."""
        vars(self).update(state)
        self.__post_init__()


class Handle(structref.StructRefProxy):
    """A `Horizon` as compiled code sees it; numba makes it.

    Its type is an attribute here: numba asks twice a call, and a property costs 0.1 us each time.
    """

    __slots__ = ("_numba_type_",)

    @classmethod
    def _numba_box_(cls, ty: Any, mi: Any) -> Handle:
        """Called by numba with the type and the memory of a new handle."""
        handle: Handle = super()._numba_box_(ty, mi)
        handle._numba_type_ = ty
        return handle


@structref.register
class HandleType(types.StructRef):
    """Type of a `Handle`."""


_KINDS = {"int": types.int64, "float": types.float64}
_DIMENSIONS = {
    **dict.fromkeys(("Ad", "Bd", "table", "forced"), 3),
    **dict.fromkeys(
        ("cd", "axle_forces", "x_ref", "q", "terminal", "u_lo", "u_hi", "free", "H", "C", "plan",
         "prediction", "schedule", "knots", "queue"), 2),
}
_TYPES = {
    field.name: _KINDS.get(str(field.type))
    or types.Array(types.float64, _DIMENSIONS.get(field.name, 1), "C")
    for field in fields(Horizon)
    if field.name != "handle"
}
"""Types of the handle's fields."""
structref.define_proxy(Handle, HandleType, list(_TYPES))


@njit(cache=True)
def _make(values):
    """A handle of the values of all fields, in their order."""
    return Handle(*values)
