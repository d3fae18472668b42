"""The answer to steering (ISO 7401): step, continuous sine, sweep, against transfer functions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lpvmpc.kit.findings import Limit, Table
from lpvmpc.picture import style
from lpvmpc.plant.mjcf import tires
from lpvmpc.studies.parts.steering import (
    AY,
    DT,
    FREQUENCIES,
    Sines,
    SteeringRecord,
    Sweep,
    amplitude,
    difference,
    half_steer,
    sine_responses,
    steer,
    step_response,
    step_steer,
    sweep_response,
    without_servo,
)
from lpvmpc.studies.reference.lateral_model import (
    LATERAL_ACCELERATION,
    YAW_RATE,
    frequency_response,
    lateral_model,
)
from lpvmpc.studies.reference.lateral_model import response as linear_response
from lpvmpc.studies.study import TARGET, CarUnderTest, Picture, Series, StudyResult
from lpvmpc.units import Array

METHOD = """\
Lateral transient response after ISO 7401, open loop, drive torque held. The input is always the
real angle of the road wheel (of the equivalent single track), so that the servo's lag of 33 ms is
not part of the car's response.

- *Step*: response times count from the instant at which the steer passes half its final value;
  t50 and t90 are reached at 50 and 90 % of the steady value, overshoot is (peak - steady) / steady.
  For the targets of the yaw rate the road wheel jumps (a servo without lag) to 2 m/s2; the
  lateral acceleration is watched with the real servo, and so is a step to 0.5 m/s2, which is laid
  over the transfer function under the same steer.
- *Continuous sine*: amplitude for 0.5 m/s2 in steady state; after the transient, gain and phase
  from a least-squares fit of sine, cosine and drift over two periods or more.
- *Sweep*: from 0.1 to 4 Hz in 40 s at the same amplitude, begun and ended in straight driving;
  the response is the ratio of the Fourier transforms of the whole record.
- *Transfer function*: linear single track with the tires' slopes, trails and relaxation lengths at
  the loads that drag leaves, rolling resistance, spinning wheels, and a body that rolls about the
  road on springs and dampers (`studies/reference/lateral_model.py`); no parameter is fitted.
- Valid in the linear range, some 0.1 g for 1 dB and 5 degrees; above 2 Hz the model's rigid wheels
  (no hop, no lateral compliance of the suspension) are too simple as well.
"""

SPEEDS = (15.0, 20.0, 100.0 / 3.6)
"""Speeds of sine and sweep [m/s]."""
STEP_AY = 2.0
"""Lateral acceleration of the step [m/s2], roughly."""
HIGHEST = {"yaw rate": 1.5, "lateral acceleration": 1.0}
"""Frequencies to which the transfer functions are compared [Hz]."""
OUTPUTS = {"yaw rate": YAW_RATE, "lateral acceleration": LATERAL_ACCELERATION}


def run(car: CarUnderTest) -> StudyResult:
    """Study the answer to steering."""
    result = StudyResult("transient", METHOD)
    p = car.params
    models = {vx: lateral_model(p, vx, tires(car.documented)) for vx in SPEEDS}
    sines = {vx: sine_responses(car, vx) for vx in SPEEDS}
    sweeps = {vx: sweep_response(car, vx) for vx in SPEEDS}
    jumps = _steps(result, car)
    _phases(result, sines)
    _frequency(result, models, sines, sweeps)
    runs = _against_model(result, car, models)
    _modes(result, models)
    result.pictures += [
        Picture(
            "frequency",
            "Gain and phase of yaw rate and lateral acceleration to the steer of the road wheel: "
            "transfer function with the band of 1 dB and 5 degrees, sine (dots) and sweep (thin "
            "lines).",
            _draw_frequency(models, sines, sweeps),
        ),
        Picture(
            "step",
            "Left: yaw rate after a jump of the road wheel to 2 m/s2, and the targets of its "
            "response times. Middle and right: a step of the servo to 0.5 m/s2, simulated and by "
            "the transfer function under the same steer.",
            _draw_steps(jumps, runs),
        ),
    ]
    return result


# --- verdicts ---


def _steps(result: StudyResult, car: CarUnderTest) -> dict[float, SteeringRecord]:
    p = car.params
    rows, jumps = [], {}
    sharp = without_servo(car.plant(Ts=DT))
    soft = car.plant(Ts=DT)
    why = TARGET
    for vx, t90 in ((12.0, 0.14), (15.0, 0.16), (20.0, 0.20), (100.0 / 3.6, None)):
        angle = STEP_AY * (p.wheelbase / vx**2 + 0.0044)
        jumps[vx] = step_steer(sharp, vx, angle)
        yaw = step_response(jumps[vx].r)
        slow = step_steer(soft, vx, angle)
        lateral = step_response(slow.ay, half_steer(slow))
        rows.append(
            (f"{vx:.1f}", *(1e3 * t for t in (yaw.t50, yaw.t90, yaw.peak)), 100.0 * yaw.overshoot,
             1e3 * lateral.t90, slow.ay[-300:].mean())
        )
        if t90 is None:
            continue
        at = f"{vx:g} m/s"
        for name, value, target in (
            ("t50", yaw.t50, 76.0), ("t90", yaw.t90, 126.0), ("peak", yaw.peak, 200.0)
        ):
            result.find(f"yaw rate {name} after a step, {at}", 1e3 * value, "ms",
                        Limit.near(target, 25.0), why, target=True)
        result.find(
            f"yaw rate overshoot, {at}", 100.0 * yaw.overshoot, "%", Limit.between(5.0, 7.0),
            "handling target", target=True,
        )
        result.find(f"lateral acceleration t90, {at}", 1e3 * lateral.t90, "ms",
                    Limit.near(1e3 * t90, 30.0), why, target=True)
    header = (
        "speed [m/s]", "yaw t50 [ms]", "t90 [ms]", "peak [ms]", "overshoot [%]",
        "ay t90, servo [ms]", "steady ay [m/s2]",
    )
    result.tables.append(Table("step", "Step of the road wheel", header, rows))
    return jumps


def _phases(result: StudyResult, sines: dict[float, Sines]) -> None:
    for frequency, target in ((0.5, -8.0), (1.0, -26.0), (2.0, -49.0)):
        response = sines[15.0].outputs[FREQUENCIES.index(frequency), 0]
        result.find(
            f"phase of yaw rate at {frequency:g} Hz, 15 m/s", math.degrees(np.angle(response)),
            "deg", Limit.near(target, 6.0), TARGET, target=True,
        )


def _frequency(
    result: StudyResult,
    models: dict[float, Any],
    sines: dict[float, Sines],
    sweeps: dict[float, Sweep],
) -> None:
    rows = []
    worst: dict[tuple[str, str], list[float]] = {}
    for vx, model in models.items():
        f = np.array(FREQUENCIES)
        expected = frequency_response(model, f)
        sweep = sweeps[vx]
        swept = frequency_response(model, sweep.frequencies)
        for column, (name, output) in enumerate(OUTPUTS.items()):
            near = f <= HIGHEST[name]
            gain, phase = difference(sines[vx].outputs[near, column], expected[near, output])
            within = sweep.frequencies <= HIGHEST[name]
            gain2, phase2 = difference(sweep.outputs[within, column], swept[within, output])
            rows.append((name, f"{vx:.1f}", gain, phase, gain2, phase2))
            for key, value in (
                ("sine gain", gain), ("sine phase", phase), ("sweep gain", gain2),
                ("sweep phase", phase2),
            ):
                worst.setdefault((name, key), []).append(float(value))
    short = {"yaw rate": "yaw rate", "lateral acceleration": "ay"}
    for name, highest in HIGHEST.items():
        why = f"transfer function up to {highest:g} Hz at 0.5 m/s2, worst of three speeds"
        for way in ("sine", "sweep"):
            result.find(
                f"{short[name]}, {way}: gain off by", max(worst[name, f"{way} gain"]), "dB",
                Limit.at_most(1.0), why,
            )
            result.find(
                f"{short[name]}, {way}: phase off by", max(worst[name, f"{way} phase"]), "deg",
                Limit.at_most(5.0), why,
            )
    result.find(
        "answer to a sine that is not sine", 100.0 * max(s.rest for s in sines.values()), "%",
        Limit.at_most(2.0), "frequency responses mean something only for a linear car",
    )
    header = (
        "output", "speed [m/s]", "sine gain [dB]", "sine phase [deg]", "sweep gain [dB]",
        "sweep phase [deg]",
    )
    result.tables.append(
        Table("differences", "Largest difference to the transfer function", header, rows)
    )
    for vx, measured in sines.items():
        columns: dict[str, Any] = {"f_hz": FREQUENCIES}
        for column, name in enumerate(OUTPUTS):
            key = name.replace(" ", "_")
            columns[f"{key}_gain"] = np.abs(measured.outputs[:, column])
            columns[f"{key}_phase_deg"] = np.degrees(np.angle(measured.outputs[:, column]))
        result.series.append(Series(f"sine-{vx:.0f}mps", columns))


def _against_model(
    result: StudyResult, car: CarUnderTest, models: dict[float, Any]
) -> dict[float, tuple[SteeringRecord, Array]]:
    runs, worst = {}, {name: 0.0 for name in OUTPUTS}
    for vx, model in models.items():
        before = np.zeros(round(0.1 / DT))
        step = np.full(round(1.4 / DT), amplitude(car, vx, AY))
        run = steer(car.plant(Ts=DT), vx, np.concatenate([before, step]))
        linear = linear_response(model, run.delta, DT)
        runs[vx] = run, linear
        for column, (name, output) in enumerate(OUTPUTS.items()):
            off = np.abs(run.outputs[:, column] - linear[:, output]).max()
            worst[name] = max(worst[name], off / abs(linear[-1, output]))
    for name, value in worst.items():
        short = "ay" if name.startswith("lateral") else name
        result.find(
            f"step to 0.5 m/s2: {short} off by", 100.0 * value, "%", Limit.at_most(10.0),
            "transfer function under the same steer, of the steady value; 10 % is 1 dB",
        )
    return runs


def _modes(result: StudyResult, models: dict[float, Any]) -> None:
    rows = []
    for vx, (A, _, _) in models.items():
        values = np.linalg.eigvals(A)
        pairs = sorted(values[values.imag > 1e-6], key=abs)
        cells: list[object] = [f"{vx:.1f}"]
        for value in pairs[:2]:
            cells += [abs(value) / (2.0 * math.pi), -value.real / abs(value)]
        cells += [""] * (5 - len(cells))
        rows.append(cells)
    header = ("speed [m/s]", "1st f [Hz]", "damping", "2nd f [Hz]", "damping ")
    caption = "Slowest oscillating modes of the transfer function (yaw and roll)"
    result.tables.append(Table("modes", caption, header, rows))


# --- pictures ---


@style.styled
def _draw_frequency(
    models: dict[float, Any], sines: dict[float, Sines], sweeps: dict[float, Sweep]
) -> Any:
    figure, axes = style.axes(2, 2, height=4.4, sharex=True)
    colours = (style.BLUE, style.GREEN, style.ORANGE)
    f = np.geomspace(0.15, 3.2, 200)
    for (vx, model), colour in zip(models.items(), colours, strict=True):
        expected = frequency_response(model, f)
        for column, (name, output) in enumerate(OUTPUTS.items()):
            gain, phase = axes[:, column]
            db = 20.0 * np.log10(np.abs(expected[:, output]))
            deg = np.degrees(np.unwrap(np.angle(expected[:, output])))
            near = f <= HIGHEST[name]
            for axis, line, tolerance in ((gain, db, 1.0), (phase, deg, 5.0)):
                axis.semilogx(f, line, color=colour, lw=1.0, label=f"{vx:.1f} m/s")
                axis.fill_between(f[near], line[near] - tolerance, line[near] + tolerance,
                                  color=colour, alpha=0.15, lw=0.0)
            sweep = sweeps[vx]
            for axis, found in (
                (gain, lambda z: 20.0 * np.log10(np.abs(z))),
                (phase, lambda z: np.degrees(np.unwrap(np.angle(z)))),
            ):
                axis.plot(sweep.frequencies, found(sweep.outputs[:, column]), color="black", lw=0.5,
                          label="sweep" if vx == SPEEDS[-1] else None)
                dots = found(sines[vx].outputs[:, column])
                axis.plot(FREQUENCIES, dots, "o", ms=3.0, color=colour, mec="black", mew=0.4,
                          zorder=5)
    ticks = (0.2, 0.5, 1.0, 2.0, 3.0)
    for column, name in enumerate(OUTPUTS):
        unit = "1/s" if column == 0 else "m/s² per rad"
        style.label(axes[0, column], "", f"gain [dB re {unit}]", name.capitalize())
        style.label(axes[1, column], "frequency [Hz]", "phase [deg]")
        axes[1, column].set_xticks(ticks, [f"{t:g}" for t in ticks])
        axes[1, column].minorticks_off()
    axes[0, 0].legend(loc="lower left")
    return figure


@style.styled
def _draw_steps(
    jumps: dict[float, SteeringRecord], runs: dict[float, tuple[SteeringRecord, Array]]
) -> Any:
    figure, (left, middle, right) = style.axes(1, 3, height=2.6)
    colours = (style.SKY, style.BLUE, style.GREEN)
    for vx, colour in zip((12.0, 15.0, 20.0), colours, strict=True):
        r = jumps[vx].r
        times = DT * np.arange(float(len(r)))
        left.plot(times, 100.0 * r / r[-300:].mean(), color=colour, label=f"{vx:g} m/s")
    for k, (share, target) in enumerate(((50.0, 0.076), (90.0, 0.126))):
        left.plot([target - 0.025, target + 0.025], [share] * 2, color=style.RED, lw=2.0, zorder=4,
                  solid_capstyle="butt", label=None if k else "targets")
    left.fill_between([0.175, 0.225], 104.5, 107.5, color=style.RED, alpha=0.4, lw=0.0)
    left.set_xlim(0.0, 0.6)
    left.set_ylim(0.0, 118.0)
    style.label(left, "time [s]", "yaw rate over steady [%]", "Jump to 2 m/s²")
    left.legend(loc="lower right")
    colours = (style.BLUE, style.GREEN, style.ORANGE)
    for (vx, (run, linear)), colour in zip(runs.items(), colours, strict=True):
        times = DT * np.arange(float(len(run.r))) - half_steer(run)
        for axis, values, expected in (
            (middle, np.degrees(run.r), np.degrees(linear[:, YAW_RATE])),
            (right, run.ay, linear[:, LATERAL_ACCELERATION]),
        ):
            axis.plot(times, values, color=colour, label=f"{vx:.1f} m/s")
            axis.plot(times, expected, color="black", lw=0.8, ls=(0, (4, 2)))
    middle.plot([], [], color="black", lw=0.8, ls=(0, (4, 2)), label="transfer function")
    for axis in (middle, right):
        axis.set_xlim(-0.1, 1.0)
    style.label(middle, "time after half the steer [s]", "yaw rate [deg/s]", "Step to 0.5 m/s²")
    style.label(right, "time after half the steer [s]", "lateral acceleration [m/s²]")
    middle.legend(loc="lower right")
    return figure
