"""What is wrong with a sensor: one channel per signal, and the sensors of some cars."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from lpvmpc.errors import OptionError

DEG = math.pi / 180.0


@dataclass(frozen=True, kw_only=True)
class Channel:
    """What is wrong with one signal, in the signal's own unit; the default is exact.

    `Sensing` checks its channels, and names them where it refuses one.
    """

    measured: bool = True
    """Whether there is such a sensor at all."""
    std: float = 0.0
    """Standard deviation of the white noise of each sample."""
    bias_std: float = 0.0
    """Standard deviation of a constant error, drawn once a run."""
    bias_range: float = 0.0
    """Half width of a uniform constant error, drawn once a run and added to the one above."""
    scale_range: float = 0.0
    """Half width of a uniform relative error [-], drawn once a run."""
    wander_std: float = 0.0
    """Standard deviation of an error that changes slowly."""
    wander_time: float = 10.0
    """Its time constant [s]."""
    quantum: float = 0.0
    """Step to which the reading is rounded; 0: none."""
    rate: float = 0.0
    """Samples per second [Hz]; 0: one at each control instant."""
    latency: tuple[float, float] = (0.0, 0.0)
    """Range of the age at which a sample arrives [s]: drawn for each sample of the pose, which
    says how old it is, and once a run for every other signal, which does not."""
    dropout: float = 0.0
    """Probability that a sample is lost [-]."""

    def __post_init__(self) -> None:
        latency: object = self.latency
        if isinstance(latency, list):  # as a file gives it
            object.__setattr__(self, "latency", tuple(latency))

    @property
    def noise(self) -> float:
        """Standard deviation of white noise and rounding together, in the signal's unit."""
        return math.hypot(self.std, self.quantum / math.sqrt(12.0))

    @property
    def constant(self) -> float:
        """Standard deviation of the constant error, in the signal's unit."""
        return math.hypot(self.bias_std, self.bias_range / math.sqrt(3.0))


LARGEST = {
    "position": 100.0,
    "psi": math.pi,
    "vx": 50.0,
    "vy": 50.0,
    "r": 5.0,
    "ax": 50.0,
    "ay": 50.0,
    "delta": 0.5,
    "wheel_speed": 100.0,
}
"""The channels, and for each an error larger than any sensor has [m, rad, m/s, rad/s, m/s2]."""
LONGEST = 1.0
"""No sample is older or rarer than this [s]."""
_ERRORS = ("std", "bias_std", "bias_range", "wander_std", "quantum")


@dataclass(frozen=True, kw_only=True)
class Sensing:
    """The sensors of a car, one channel per signal; the default is exact.

    Raises:
        OptionError: A value outside its domain, or sensors from which a state cannot be observed.
    """

    position: Channel = Channel()
    """x and y of the centre of mass [m]. Its rate, latency and dropout are those of the pose."""
    psi: Channel = Channel()
    """Heading [rad], in the same sample as the position."""
    vx: Channel = Channel()
    """Longitudinal speed [m/s]."""
    vy: Channel = Channel()
    """Lateral speed [m/s]."""
    r: Channel = Channel()
    """Yaw rate [rad/s]."""
    ax: Channel = Channel()
    """Longitudinal acceleration [m/s2]."""
    ay: Channel = Channel()
    """Lateral acceleration [m/s2]."""
    delta: Channel = Channel()
    """Road-wheel angle [rad]."""
    wheel_speed: Channel = Channel()
    """Spin of each wheel [rad/s]; the errors of the four are independent."""
    lane: bool = False
    """The position comes from a camera that sees the lane: the whole of its error lies across the
    path. Simplification: along the path the position is exact, as if a map gave it; only the
    curvature of the road ahead depends on it, and that changes little within half a metre."""

    def __post_init__(self) -> None:
        for name in LARGEST:
            _check(name, getattr(self, name))
        if not isinstance(self.lane, bool):
            raise OptionError("sensing lane", self.lane, "true or false")
        for name, default in (("rate", 0.0), ("latency", (0.0, 0.0)), ("dropout", 0.0)):
            if getattr(self.psi, name) != default:
                raise OptionError(
                    f"sensing psi.{name}", getattr(self.psi, name),
                    f"left out: heading and position are one sample, see position.{name}",
                )
        absent = [name for name in LARGEST if not getattr(self, name).measured]
        for name in ("position", "r", "ax", "ay", "delta"):
            if name in absent:
                lost = {"position": "ey"}.get(name, name)
                raise OptionError(
                    f"sensing {name}.measured", False,
                    f"true: without {name} the state {lost} cannot be observed",
                )
        if "vx" in absent and "wheel_speed" in absent:
            raise OptionError(
                "sensing vx.measured", False,
                "true: without vx and wheel_speed the state vx cannot be observed",
            )

    @property
    def exact(self) -> bool:
        """Whether every signal is measured and nothing is wrong with any."""
        return self == EXACT

    def scaled(self, factor: float) -> Sensing:
        """The same sensors with noise, bias, scale error and wander times a factor.

        Quanta, rates, latencies and dropouts stay.
        """
        grown = ("std", "bias_std", "bias_range", "scale_range", "wander_std")
        channels = {}
        for name in LARGEST:
            channel = getattr(self, name)
            values = {key: factor * getattr(channel, key) for key in grown}
            channels[name] = replace(channel, **values)
        return replace(self, **channels)


def _check(name: str, channel: Channel) -> None:
    """Raise OptionError for a channel that no sensor can have."""
    if not isinstance(channel, Channel):
        raise OptionError(f"sensing {name}", channel, "a Channel")
    if not isinstance(channel.measured, bool):
        raise OptionError(f"sensing {name}.measured", channel.measured, "true or false")
    largest = dict.fromkeys(_ERRORS, LARGEST[name])
    largest.update(scale_range=0.5, wander_time=1e6, rate=1e4, dropout=1.0)
    for key, limit in largest.items():
        value = getattr(channel, key)
        if not (_number(value) and 0.0 <= value <= limit):
            raise OptionError(f"sensing {name}.{key}", value, f"a number from 0 to {limit:.4g}")
    if channel.wander_time == 0.0:
        raise OptionError(f"sensing {name}.wander_time", channel.wander_time, "positive")
    if channel.dropout == 1.0:
        raise OptionError(f"sensing {name}.dropout", channel.dropout, "below 1")
    if 0.0 < channel.rate < 1.0 / LONGEST:
        allowed = f"0 or at least {1.0 / LONGEST:g} Hz"
        raise OptionError(f"sensing {name}.rate", channel.rate, allowed)
    age = channel.latency
    pair = isinstance(age, tuple) and len(age) == 2 and all(_number(value) for value in age)
    if not (pair and 0.0 <= age[0] <= age[1] <= LONGEST):
        allowed = f"a pair of seconds, 0 <= shortest <= longest <= {LONGEST:g}"
        raise OptionError(f"sensing {name}.latency", age, allowed)


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


EXACT = Sensing()
"""Everything is known, vy too."""

RTK = Sensing(
    position=Channel(std=0.01),
    psi=Channel(std=0.1 * DEG),
    vx=Channel(std=0.03),
    vy=Channel(measured=False),
    r=Channel(std=0.1 * DEG),
    ax=Channel(std=0.05, bias_std=0.05),
    ay=Channel(std=0.05, bias_std=0.05),
    delta=Channel(std=0.05 * DEG),
    wheel_speed=Channel(std=0.1),
)
"""A test car with RTK-GNSS and a dual antenna.

Position 1 cm: from literature, the RTK grade of OxTS RT3000-class units. Heading 0.1 deg: from
literature, 0.2 deg per metre of antenna distance in the same manual, antennas 2 m apart. Speed
0.03 m/s: estimated, about twice the 0.05 km/h of the data sheet, for slip and levers. vy not
measured: such units give it, but from their own filter; here the filter is ours. Yaw rate and
accelerations: estimated, a tactical MEMS unit at 30 Hz with road vibration. Steering 0.05 deg at
the wheel and wheel spin 0.1 rad/s (0.03 m/s at the rim): assumed. No latency: assumed, the manual
says 3.5 ms. The white noise of position stands for what is correlated over minutes in reality.
"""

PRODUCTION = Sensing(
    position=Channel(
        std=0.03, wander_std=0.05, wander_time=10.0, rate=30.0, latency=(0.060, 0.100)
    ),
    psi=Channel(std=0.2 * DEG, wander_std=0.3 * DEG, wander_time=10.0),
    vx=Channel(measured=False),
    vy=Channel(measured=False),
    r=Channel(std=0.1 * DEG, bias_std=0.2 * DEG),
    ax=Channel(std=0.1, bias_std=0.1),
    ay=Channel(std=0.1, bias_std=0.1),
    delta=Channel(quantum=0.1 * DEG, bias_std=0.5 * DEG),
    wheel_speed=Channel(quantum=0.1, scale_range=0.01),
    lane=True,
)
"""A production car: a lane camera, and what its stability control has anyway.

Lane camera, 3 cm and 0.2 deg white, 5 cm and 0.3 deg wander over 10 s, 30 Hz, 60 to 100 ms old:
estimated; 30 Hz is usual, the errors are of the size that papers on lane keeping assume, and makers
publish none. Yaw rate 0.2 deg/s bias: estimated; a maker's workshop manual allows 3.75 deg/s over
life and temperature, the rest is what is left after zeroing at standstill. Accelerations 0.1 m/s2
bias: estimated likewise (the same manual allows 0.09 g). Steering: steps of 0.1 deg at the road
wheel (1.5 deg at the hand wheel; sensors resolve 0.1 deg there, so steps are assumed, they stand
for hysteresis) and an offset of 0.5 deg (assumed: alignment and mounting, before any learning).
Wheel speeds: steps of 0.1 rad/s, 0.03 m/s at a radius of 0.3 m, and radii wrong by up to 1 %
(estimated: wear and pressure).
"""
