"""The controllers to compare with: the paper's own baseline, and two by geometry.

- `LMPC` (`lmpc-pso-pid`): lateral MPC on the linear bicycle, constant stiffness, PID on the speed.
- `Stanley` (`stanley`) and `PurePursuit` (`pure-pursuit`): steering laws by geometry, the same PID.

Each has its weights in one frozen dataclass, with the ranges in which they are tuned.
"""

from lpvmpc.geometric import PurePursuit, PurePursuitWeights, Stanley, StanleyWeights
from lpvmpc.lmpc import LMPC, LMPCWeights
from lpvmpc.pid import PIDGains, SpeedPID

__all__ = [
    "LMPC",
    "LMPCWeights",
    "PIDGains",
    "PurePursuit",
    "PurePursuitWeights",
    "SpeedPID",
    "Stanley",
    "StanleyWeights",
]
