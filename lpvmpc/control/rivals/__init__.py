"""Rivals: controllers that the package's own are measured against, one file each.

What lies here decides the runs of rivals alone: adding one, or changing one, leaves the kept
results of all other controllers valid (`sim.batch`). So nothing outside may import from here but
the table below, and `lpvmpc.gym` what a learned driver sees. Tuned weights lie in
`rivals/weights/NAME.toml`.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec


@dataclass(frozen=True, kw_only=True)
class Rival:
    """Where a rival is, and what it needs."""

    module: str
    """File of this package that holds it."""
    maker: str
    """Its class or maker, which takes the car first."""
    packages: tuple[str, ...] = ()
    """Packages that it imports beside those that lpvmpc needs."""
    extra: str = ""
    """Extra of lpvmpc that installs them."""
    learned: bool = False
    """Whether it was trained (`eval/learn.py`): it has a policy and no weights to tune."""
    slow: bool = False
    """Whether a lap takes it so long that the leaderboard has it drive a part of its runs alone."""

    def missing(self) -> str | None:
        """The first of its packages that is not installed."""
        return next((name for name in self.packages if find_spec(name) is None), None)


RIVALS: dict[str, Rival] = {
    "lqr": Rival(module="lqr", maker="LQR"),
    "nmpc": Rival(module="nmpc", maker="NMPC", packages=("casadi",), extra="nmpc", slow=True),
    "nmpc-textbook": Rival(
        module="nmpc", maker="TextbookNMPC", packages=("casadi",), extra="nmpc", slow=True
    ),
    "mpcc": Rival(module="mpcc", maker="MPCC", packages=("casadi",), extra="nmpc", slow=True),
    "lpv-mpc-alcala": Rival(module="alcala", maker="Alcala"),
    "mppi": Rival(module="mppi", maker="MPPI", slow=True),
    "ppo": Rival(module="ppo", maker="PPO", learned=True),
    "lpv-mpc-protected": Rival(module="forms", maker="lpv_mpc_protected"),
    "lmpc-pso-pid-plain": Rival(module="forms", maker="lmpc_plain"),
}
"""Rivals by name; `registry.CONTROLLERS` has them too."""
