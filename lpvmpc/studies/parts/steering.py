"""A car under a steering signal: steps, sines and sweeps, and how it answers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lpvmpc.interface import Command
from lpvmpc.plant.plant import Plant
from lpvmpc.studies.reference.circle_formulas import Linear
from lpvmpc.studies.study import CarUnderTest
from lpvmpc.units import Array

DT = 1e-3
"""Time between samples [s], the physics step."""
FREQUENCIES = (0.2, 0.35, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0)
"""Frequencies of the sine [Hz]."""
AY = 0.5
"""Lateral acceleration of sine and sweep, steady state [m/s2]."""
Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class SteeringRecord:
    """What a car did under a steering signal, sampled every DT."""

    delta: Array
    """Steer of the road wheel [rad], shape (n,)."""
    r: Array
    """Yaw rate [rad/s], shape (n,)."""
    ay: Array
    """Lateral acceleration of the centre of mass [m/s2], shape (n,)."""

    @property
    def outputs(self) -> Array:
        """Yaw rate and lateral acceleration, shape (n, 2)."""
        return np.stack([self.r, self.ay], axis=1)


@dataclass(frozen=True)
class StepResponse:
    """Characteristic values of a step response."""

    t50: float
    """Time to half of the steady value [s]."""
    t90: float
    """Time to 90 % of it [s]."""
    peak: float
    """Time of the largest value [s]."""
    overshoot: float
    """Largest value over the steady one, less 1 [-]."""


def without_servo(plant: Plant) -> Plant:
    """Let the road wheels stand where they are commanded to, at once."""
    plant.model.numeric("steering").data[:2] = 1e-6, 1e6
    return plant


def amplitude(car: CarUnderTest, vx: float, ay: float) -> float:
    """Steer that makes a lateral acceleration in the steady state of the linear formula [rad]."""
    return float(ay / (vx * Linear.of(car.params).yaw_gain(vx)))


def steer(plant: Plant, vx: float, commands: Array) -> SteeringRecord:
    """Steer a car that drives straight.

    Args:
        plant: with Ts = DT.
        vx: speed [m/s].
        commands: steer [rad] at 0, DT, ..., shape (n,).

    Returns:
        Samples at the same times, shape (n,) less one: the acceleration of an instant is known
        only after the step that begins there.
    """
    state = plant.reset(vx=vx)
    drive = float(plant.data.ctrl[1])
    samples = np.empty((len(commands), 3))
    for sample, command in zip(samples, commands, strict=True):
        sample[:2] = state.delta, state.r
        state = plant.step(Command(float(command), drive))
        sample[2] = state.ay
    return SteeringRecord(*samples.T)


def step_response(values: Array, begin: float = 0.0) -> StepResponse:
    """Response times of samples every DT.

    Args:
        values: shape (n,); the last 0.3 s are the steady state.
        begin: from when the times count [s].
    """
    steady = values[-round(0.3 / DT) :].mean()

    def crossing(share: float) -> float:
        k = int(np.argmax(values >= share * steady))
        before, after = values[k - 1], values[k]
        return DT * (k - 1 + (share * steady - before) / (after - before)) - begin

    peak = int(np.argmax(values))
    return StepResponse(
        crossing(0.5), crossing(0.9), DT * peak - begin, float(values[peak] / steady - 1.0)
    )


def step_steer(plant: Plant, vx: float, angle: float, seconds: float = 1.5) -> SteeringRecord:
    """Step of the command [rad] out of straight driving."""
    return steer(plant, vx, np.full(round(seconds / DT), angle))


def half_steer(run: SteeringRecord) -> float:
    """Instant at which the steer passes half its final value [s]."""
    return DT * float(np.argmax(run.delta >= 0.5 * run.delta[-1]))


def fit_sine(values: Array, frequency: float) -> tuple[complex, float]:
    """Sine in samples every DT; mean and drift are left out.

    Returns:
        Complex amplitude, and what is not sine: rms of the rest over rms of the sine.
    """
    times = DT * np.arange(float(len(values)))
    wave = 2.0 * math.pi * frequency * times
    basis = np.stack([np.cos(wave), np.sin(wave), np.ones_like(times), times], axis=1)
    weights = np.linalg.lstsq(basis, values, rcond=None)[0]
    rest = values - basis @ weights
    amplitude = complex(weights[0], -weights[1])
    return amplitude, float(np.sqrt(2.0 * np.mean(rest**2)) / abs(amplitude))


def sine_response(plant: Plant, vx: float, frequency: float, angle: float) -> tuple[Complex, float]:
    """Yaw rate and lateral acceleration over steer, (2,), and the share that is not sine."""
    period = 1.0 / frequency
    settle, watch = max(2.0 * period, 2.5), max(2.0 * period, 1.0)
    times = np.arange(0.0, settle + watch, DT)
    run = steer(plant, vx, angle * np.sin(2.0 * math.pi * frequency * times))
    last = slice(round(settle / DT), None)
    (delta, _), *outputs = (fit_sine(v[last], frequency) for v in (run.delta, run.r, run.ay))
    return np.array([z for z, _ in outputs]) / delta, max(rest for _, rest in outputs)


@dataclass(frozen=True)
class Sines:
    """Frequency response at FREQUENCIES."""

    outputs: Complex
    """Yaw rate and lateral acceleration over steer, shape (n, 2)."""
    rest: float
    """Largest share of a response, up to 1.5 Hz, that is not sine [-]."""


def sine_responses(car: CarUnderTest, vx: float) -> Sines:
    """Steer by continuous sines, one after another."""
    plant = car.plant(Ts=DT)
    angle = amplitude(car, vx, AY)
    found = [sine_response(plant, vx, f, angle) for f in FREQUENCIES]
    rest = max(rest for f, (_, rest) in zip(FREQUENCIES, found, strict=True) if f <= 1.5)
    return Sines(np.array([outputs for outputs, _ in found]), rest)


@dataclass(frozen=True)
class Sweep:
    """Frequency response from one sweep."""

    frequencies: Array
    """[Hz], shape (n,)."""
    outputs: Complex
    """Yaw rate and lateral acceleration over steer, shape (n, 2)."""


def sweep_response(car: CarUnderTest, vx: float) -> Sweep:
    """Steer by a sine whose frequency rises from 0.1 to 4 Hz in 40 s."""
    length, low, high = 40.0, 0.1, 4.0
    times = np.arange(0.0, length, DT)
    rate = math.log(high / low) / length
    phase = 2.0 * math.pi * low * np.expm1(rate * times) / rate
    fade = np.minimum(1.0, np.minimum(times / 5.0, (length - times) / 1.0))
    signal = amplitude(car, vx, AY) * fade * np.sin(phase)
    run = steer(car.plant(Ts=DT), vx, np.concatenate([signal, np.zeros(round(4.0 / DT))]))
    count = len(run.delta)
    frequencies: Array = np.asarray(np.fft.rfftfreq(count, DT), dtype=np.float64)
    inside = (frequencies >= 0.2) & (frequencies <= 3.0)
    spectra = [np.fft.rfft(v - v[0])[inside] for v in (run.delta, run.r, run.ay)]
    outputs = np.stack([spectra[1] / spectra[0], spectra[2] / spectra[0]], axis=1)
    return Sweep(frequencies[inside], outputs)


def difference(measured: Any, expected: Any) -> tuple[float, float]:
    """Largest difference of complex responses in gain [dB] and in phase [deg]."""
    ratio = np.asarray(measured) / np.asarray(expected)
    gain = float(np.max(np.abs(20.0 * np.log10(np.abs(ratio)))))
    return gain, float(np.max(np.abs(np.degrees(np.angle(ratio)))))
