"""Other forms of the package's controllers: the baseline bare, the paper's controller protected.

`lmpc-pso-pid-plain` is the baseline as the paper has it, without the protections that
`lmpc-pso-pid` drives with. `lpv-mpc-protected` is `lpv-mpc-paper` with those of the others: the
exact hold, slip cap, traction control, no steering by speed errors, a car far beside its path led
back, driving on after refused solves, and a tuned factor on the nominal stiffness.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar

from lpvmpc.car.params import VehicleParams
from lpvmpc.control.cost import PAPER_WEIGHTS, SHARED_RANGES, Weights
from lpvmpc.control.formulation import PAPER, Formulation, changed
from lpvmpc.control.lmpc import LMPC, LMPCWeights
from lpvmpc.control.lpv_mpc import LPVMPC
from lpvmpc.control.stiffness.models import ConstantStiffness
from lpvmpc.control.weights_file import chosen
from lpvmpc.errors import OptionError

PROTECTED = replace(
    PAPER, hold="exact", slip_cap=True, traction=True, decoupled=True, approach=True, drive_on=True
)
"""The paper's plain formulation with the protections."""


@dataclass(frozen=True, kw_only=True)
class ProtectedWeights(Weights):
    """The weights of `lpv-mpc-protected`: those of `lpv-mpc-paper`, and a stiffness factor."""

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {**SHARED_RANGES, "stiffness": (0.3, 1.5)}
    """Where tuning searches."""

    stiffness: float = 1.0
    """Factor on the nominal cornering stiffness."""

    def __post_init__(self) -> None:
        """Refuse what no cost, and no car, can have."""
        super().__post_init__()
        if not 0.05 <= self.stiffness <= 5.0:
            raise OptionError("weight stiffness", self.stiffness, "a number from 0.05 to 5")


def lpv_mpc_protected(
    car: VehicleParams,
    *,
    weights: ProtectedWeights | Mapping[str, float] | None = None,
    formulation: Formulation | Mapping[str, Any] | None = None,
    delay: int = 0,
) -> LPVMPC:
    """The controller `lpv-mpc-protected`.

    Args:
        car: Vehicle parameters.
        weights: Cost weights and the factor, or some by name; the shipped ones by default.
        formulation: What differs from `PROTECTED`.
        delay: Known delay between command and effect [periods], compensated by prediction.

    Raises:
        OptionError: A value outside its domain.
    """
    name = "lpv-mpc-protected"
    w = chosen(name, weights, ProtectedWeights(**asdict(PAPER_WEIGHTS)))
    made = LPVMPC(
        car,
        stiffness=ConstantStiffness(car, w.stiffness),
        weights=w,
        formulation=changed(PROTECTED, formulation),
        delay=delay,
    )
    made.name = name
    return made


def lmpc_plain(
    car: VehicleParams,
    *,
    weights: LMPCWeights | Mapping[str, float] | None = None,
    delay: int = 0,
) -> LMPC:
    """The controller `lmpc-pso-pid-plain`, see `LMPC`."""
    return LMPC(car, weights=weights, delay=delay, protect=False)
