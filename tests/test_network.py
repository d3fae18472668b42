import json
import os
import time

import numpy as np
import pytest
from safetensors import numpy as numpy_files

from lpvmpc.car import bicycle
from lpvmpc.car.bicycle import AF, AR, DELTA, NX, PHI, VX, A, R
from lpvmpc.control.stiffness import network, network_file
from lpvmpc.control.stiffness.network import NetworkTire
from lpvmpc.control.stiffness.network_file import load_weights, shipped
from lpvmpc.control.stiffness.secant_network import SecantNetwork
from lpvmpc.errors import DataError, LPVMPCError, OptionError
from lpvmpc.kit import safetensors
from lpvmpc.plant.mjcf import compile_model
from lpvmpc.sim.names import warn_of_another_car
from lpvmpc.units import GRAVITY


@pytest.fixture(scope="module")
def car(plant):
    return plant.params


@pytest.fixture(scope="module")
def tire(car):
    return NetworkTire(car)


@pytest.fixture(scope="module")
def secant(car):
    return SecantNetwork(car)


@pytest.fixture
def prediction(car):
    """A bend at 15 m/s, 3 m/s2, along a horizon of ten periods."""
    x = np.zeros((11, NX))
    x[:, VX], x[:, R], x[:, DELTA] = 15.0, 0.2, 0.05
    x[:, AF], x[:, AR] = np.linspace(0.02, 0.04, 11), np.linspace(0.01, 0.02, 11)
    x[:, PHI], x[:, A] = 3.0 * car.m * car.h / car.K_phi, -1.0
    return x


# Laws -------------------------------------------------------------------------------------------


def test_the_force_is_odd_in_the_slip(tire):
    for axle in (0, 1):
        for alpha in (0.003, 0.05, 0.2, 0.7):
            Fy, C = tire.axle(axle, alpha, -1000.0, -2.0, 3000.0)
            assert tire.axle(axle, -alpha, -1000.0, -2.0, -3000.0) == (-Fy, C)
        assert tire.axle(axle, 0.0, 500.0, 0.0, 1000.0)[0] == 0.0


def test_the_slope_is_the_derivative_of_the_force(tire):
    for axle in (0, 1):
        for alpha in (0.0, 0.01, 0.03, -0.03):
            h = 1e-6
            high, low = (tire.axle(axle, alpha + d, 800.0, 0.5, 2000.0)[0] for d in (h, -h))
            # 1e-6: rounding of forces of 1e4 N divided by a step of 1e-6
            slope = tire.axle(axle, alpha, 800.0, 0.5, 2000.0)[1]
            assert (high - low) / (2 * h) == pytest.approx(slope, rel=1e-6)


def test_friction_acts_by_similarity(tire):
    # F(alpha; f) = f F(alpha / f; 1) at the same loads and the same share of drive force
    for f in (0.4, 0.8):
        Fy, C = tire.axle(0, 0.02 * f, 500.0 * f, 0.0, 1000.0, f)
        full, slope = tire.axle(0, 0.02, 500.0, 0.0, 1000.0, 1.0)
        assert Fy == pytest.approx(f * full, rel=1e-12) and C == pytest.approx(slope, rel=1e-12)


def test_drive_and_brake_force_take_lateral_grip(tire):
    free = tire.axle(0, 0.1, 0.0, 0.0, 4000.0)[0]
    assert tire.axle(0, 0.1, 4000.0, 2.0, 4000.0)[0] < 0.9 * free
    # braking loads the front axle, but takes more than it gives
    assert tire.axle(0, 0.1, -6000.0, -5.0, 4000.0)[0] < 0.9 * free


def test_the_stiffness_at_small_slip_is_the_tires(tire, car):
    for axle, nominal in ((0, car.Cf), (1, car.Cr)):
        # 2 %: what the network was not told but learned
        assert tire.axle(axle, 0.0, 0.0, 0.0, 0.0)[1] == pytest.approx(nominal, rel=0.02)


def test_network_and_plant_agree_in_steady_cornering(tire, car, plant):
    plant.friction = 1.0
    for kappa in (0.01, 0.02, -0.027):
        state = plant.reset(vx=15.0, kappa=kappa)
        axles = plant.axles
        roll = car.m * car.h * state.ay
        for axle, alpha, Fx, Fy in (
            (0, axles.alpha_f, axles.Fxf, axles.Fyf),
            (1, axles.alpha_r, axles.Fxr, axles.Fyr),
        ):
            # 1.5 %: wheels' and single track's slip angles differ a little
            answer = tire.axle(axle, alpha, Fx, state.ax, roll)[0]
            assert answer == pytest.approx(Fy, rel=0.015)


# Bounds and clamps ------------------------------------------------------------------------------


def test_outputs_keep_their_physical_range_for_any_input(tire, car):
    rng = np.random.default_rng(0)
    L = car.wheelbase
    for _ in range(3000):
        axle = int(rng.integers(2))
        alpha, ax = rng.normal(0.0, 0.3), rng.normal(0.0, 5.0)
        Fx, roll, f = rng.normal(0.0, 6000.0), rng.normal(0.0, 6000.0), rng.uniform(0.2, 1.2)
        Fy, C = tire.axle(axle, alpha, Fx, ax, roll, f)
        nominal = (car.Cf, car.Cr)[axle]
        assert network.SLOPE_MIN * nominal <= C <= network.SLOPE_MAX * nominal
        static = car.m * GRAVITY * (car.lr, car.lf)[axle] / L
        Fz = max(static + (-1, 1)[axle] * car.m * car.h / L * ax, 0.2 * static)
        assert abs(Fy) <= network.FRICTION_MARGIN * f * car.mu * Fz * (1.0 + 1e-12)


def test_inputs_beyond_the_training_are_clamped_and_counted(tire):
    tire.reset()
    tire.axle(0, 0.02, 200.0, 0.0, 1000.0)
    assert tire.clamped == 0
    far = tire.axle(0, 3.0, 200.0, 0.0, 1000.0)
    assert tire.clamped == 1
    assert tire.axle(0, 6.0, 200.0, 0.0, 1000.0) == far
    tire.axle(0, 0.02, 200.0, 0.0, 1e6)
    assert tire.clamped == 3
    tire.reset()
    assert tire.clamped == 0


def test_the_force_is_continuous_across_the_clamps(tire):
    # steps of a thousandth of the whole range move the force by less than one percent of it
    for name, values in (
        ("alpha", np.linspace(-0.6, 0.6, 2001)),
        ("Fx", np.linspace(-9000.0, 9000.0, 4001)),
        ("roll", np.linspace(-12e3, 12e3, 2001)),
        ("ax", np.linspace(-15.0, 15.0, 2001)),
    ):
        base = {"alpha": 0.06, "Fx": 0.0, "ax": 0.0, "roll": 2000.0}
        Fy = [tire.axle(0, **{**base, name: float(v)})[0] for v in values]
        assert np.abs(np.diff(Fy)).max() < 80.0, name


def test_inputs_that_are_no_numbers_are_refused(tire, secant):
    with pytest.raises(LPVMPCError, match="not finite"):
        tire.axle(0, float("nan"), 0.0, 0.0, 0.0)
    with pytest.raises(LPVMPCError, match="finite, of shape"):
        secant.stiffness([[np.inf, 0.0, 0.0, 0.0, 0.0]])
    with pytest.raises(LPVMPCError, match="finite, of shape"):
        secant.stiffness([[1.0, 2.0]])
    with pytest.raises(LPVMPCError, match="not finite"):
        secant.sample(15.0, 0.0, float("nan"), 0.0, 0.0)


# Along the horizon ------------------------------------------------------------------------------


def test_tangents_are_exact_at_the_operating_point(tire, car, prediction):
    tires = np.zeros((10, 4))
    tire.horizon(None, prediction, tires)
    roll = 3.0 * car.m * car.h
    spin = 2.0 * car.J_w / car.R_w**2
    ay = 15.0 * 0.2
    ax, Fxf, Fxr = network.longitudinal(
        -1.0, 15.0, 0.05, ay, bicycle.Bicycle.of(car), car.m_eff, 1.0, car.brake_front, spin
    )
    for k in range(10):
        alpha_f = 0.5 * (prediction[k, AF] + prediction[k + 1, AF])
        alpha_r = 0.5 * (prediction[k, AR] + prediction[k + 1, AR])
        Fyf, Cf = tire.axle(0, alpha_f, Fxf, ax, roll)
        Fyr, Cr = tire.axle(1, alpha_r, Fxr, ax, roll)
        expected = (Cf, Fyf - Cf * alpha_f, Cr, Fyr - Cr * alpha_r)
        np.testing.assert_allclose(tires[k], expected, rtol=1e-12)


def test_mirrored_predictions_give_mirrored_tangents(tire, secant, prediction):
    mirror = prediction.copy()
    mirror[:, [R, DELTA, AF, AR, PHI]] *= -1.0
    one, two = np.zeros((10, 4)), np.zeros((10, 4))
    tire.horizon(None, prediction, one)
    tire.horizon(None, mirror, two)
    np.testing.assert_array_equal(one * [1, -1, 1, -1], two)


def test_drive_and_brake_forces_are_the_plants(plant, car):
    from lpvmpc.interface import Command

    plant.friction = 1.0
    plant.reset(vx=15.0)
    for wanted in (1.5, -4.0):
        for _ in range(20):
            state = plant.step(Command(0.0, wanted))
        axles, spin = plant.axles, 2.0 * car.J_w / car.R_w**2
        ax, Fxf, Fxr = network.longitudinal(
            plant.data.act[1], state.vx, 0.0, 0.0, bicycle.Bicycle.of(car), car.m_eff,
            car.drive_front, car.brake_front, spin,
        )
        # 2 % of the force and 30 N: loads still move while the body pitches
        assert ax == pytest.approx(state.ax, abs=0.05)
        assert Fxf == pytest.approx(axles.Fxf, rel=0.02, abs=30.0)
        assert Fxr == pytest.approx(axles.Fxr, rel=0.02, abs=30.0)


def test_the_assumed_friction_softens_the_tangents(tire, prediction):
    dry, wet = np.zeros((10, 4)), np.zeros((10, 4))
    tire.reset()
    tire.horizon(None, prediction, dry)
    tire.friction = 0.5
    tire.horizon(None, prediction, wet)
    tire.reset()
    assert np.all(wet[:, [0, 2]] < dry[:, [0, 2]])
    assert tire.friction == 1.0


def test_the_papers_network_gives_secants(secant, car, prediction):
    tires = np.zeros((10, 4))
    secant.reset()
    secant.horizon(None, prediction, tires)
    assert np.all(tires[:, [1, 3]] == 0.0)
    # a mild bend: between a third and the whole of the nominal stiffness
    for column, nominal in ((0, car.Cf), (2, car.Cr)):
        assert np.all((tires[:, column] > 0.3 * nominal) & (tires[:, column] < 1.1 * nominal))
    secant.stiffness([[200.0, 0.0, 0.0, 0.0, 0.0]])
    assert secant.clamped == 1


def test_the_compiled_network_computes_the_layers(secant):
    w = secant.weights.arrays
    x = np.array([14.0, 0.1, 0.03, -0.5, 0.2])
    h = (x - w["x_mean"]) / w["x_std"]
    for i in range(5):
        h = w[f"W{i}"] @ h + w[f"b{i}"]
        if i < 4:
            h = 1.0 / (1.0 + np.exp(-h))
    expected = w["y_mean"] + w["y_std"] * h
    # float32 weights: six digits
    np.testing.assert_allclose(secant.stiffness([x])[0], expected, rtol=1e-5)
    assert secant.sample(*x) == tuple(secant.stiffness([x])[0])


def test_inference_is_fast_enough(tire, secant, prediction):
    """Best of many, thread CPU time; the bars are 40 us per horizon and 10 us per sample."""
    tires = np.zeros((10, 4))

    def best(call):
        call()
        times = []
        for _ in range(30):
            start = time.thread_time_ns()
            for _ in range(50):
                call()
            times.append((time.thread_time_ns() - start) / 50e3)
        return min(times)

    assert best(lambda: tire.horizon(None, prediction, tires)) <= 40.0
    assert best(lambda: secant.horizon(None, prediction, tires)) <= 40.0
    assert best(lambda: tire.axle(0, 0.02, 0.0, 0.0, 1000.0)) <= 10.0
    assert best(lambda: secant.sample(15.0, 0.0, 0.02, 0.0, 0.1)) <= 10.0


# Weights ----------------------------------------------------------------------------------------


@pytest.fixture
def changed(tmp_path):
    """Writes a copy of shipped weights with changes; returns its path."""

    def call(kind="network", arrays=None, facts=None, drop=()):
        a, m = safetensors.read(shipped(kind))
        a = {k: v for k, v in {**a, **(arrays or {})}.items() if k not in drop}
        file = tmp_path / "w.safetensors"
        safetensors.write(file, a, {**m, **(facts or {})})
        return file

    return call


@pytest.mark.parametrize("kind", ["network", "network-secant"])
def test_shipped_weights_are_of_the_packaged_car(kind):
    weights = load_weights(kind)
    warn_of_another_car(weights, compile_model(visual=False))  # a warning is an error here
    facts = network_file.facts(weights)
    assert facts["kind"] == kind and len(facts["data_sha256"]) == 64
    assert facts["command"].startswith("python data_gen/train.py")
    assert facts["versions"]["mujoco"] and "seed" in facts


def test_another_car_is_a_warning(changed):
    model = compile_model(visual=False)
    model.numeric("tire_f").data[13] = 1.0
    with pytest.warns(UserWarning, match="trained on another car"):
        warn_of_another_car(load_weights("network"), model)
    file = changed(facts={"car_sha256": "0"})
    with pytest.warns(UserWarning, match="w.safetensors were trained on another car"):
        warn_of_another_car(load_weights("network", file), compile_model(visual=False), file.name)


def test_missing_weights_are_refused(tmp_path):
    with pytest.raises(DataError, match="There is no file"):
        load_weights("network", tmp_path / "none.safetensors")
    with pytest.raises(DataError, match="Cannot read"):
        load_weights("network", tmp_path)
    with pytest.raises(OptionError, match="'network' or 'network-secant'"):
        load_weights("transformer")


@pytest.mark.parametrize("kept", [0, 4, 50, 500, -8])
def test_truncated_weights_are_refused(changed, kept):
    file = changed()
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(DataError, match="damaged or no safetensors file"):
        load_weights("network", file)


def test_random_bytes_and_pickles_are_refused_and_nothing_is_executed(tmp_path):
    import pickle

    class Evil:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "executed"),))

    file = tmp_path / "w.safetensors"
    rng = np.random.default_rng(0)
    for content in (pickle.dumps(Evil()), rng.bytes(5000), b"\xff" * 100, b"{}" * 40):
        file.write_bytes(content)
        with pytest.raises(DataError, match="damaged or no safetensors file"):
            load_weights("network", file)
    assert not (tmp_path / "executed").exists()


def test_no_flipped_byte_is_taken_for_the_whole_file(changed):
    file = changed()
    raw, whole = file.read_bytes(), load_weights("network", file)
    rng = np.random.default_rng(1)
    for _ in range(300):
        broken = bytearray(raw)
        broken[int(rng.integers(len(raw)))] ^= int(rng.integers(1, 256))
        file.write_bytes(broken)
        try:
            found = load_weights("network", file)
        except DataError:
            continue  # refused in one sentence, as it should be
        except UserWarning as word:  # the checksum's name itself was hit
            assert "no checksum" in str(word)
            continue
        assert found.metadata == whole.metadata
        for name, array in whole.arrays.items():
            np.testing.assert_array_equal(found.arrays[name], array)


@pytest.mark.parametrize(
    "kind, arrays, facts, drop, sentence",
    [
        ("network", {}, {"format": "lpvmpc-network-0"}, (), "format 'lpvmpc-network-0'"),
        ("network", {}, {"kind": "network-secant"}, (), "are of a 'network-secant'"),
        ("network", {"b": np.zeros((2, 5))}, {}, (), r"b of shape \(2, 5\)"),
        ("network", {}, {}, ("V",), "V of shape None"),
        ("network", {}, {}, ("u",), "u of shape None"),
        ("network", {"slip_max": np.array([np.nan, 1.0])}, {}, (), "slip_max that is not finite"),
        ("network-secant", {"W2": np.zeros((16, 27))}, {}, (), r"W2 of shape \(16, 27\)"),
    ],
)
def test_weights_of_another_make_are_refused(changed, kind, arrays, facts, drop, sentence):
    with pytest.raises(DataError, match=sentence):
        load_weights(kind, changed(kind, arrays, facts, drop))


def test_models_refuse_each_others_weights(car):
    with pytest.raises(OptionError, match="weights of a 'network'"):
        NetworkTire(car, load_weights("network-secant"))
    with pytest.raises(OptionError, match="weights of a 'network-secant'"):
        SecantNetwork(car, load_weights("network"))


@pytest.mark.parametrize("kind", ["network", "network-secant"])
def test_a_changed_number_or_text_is_refused(tmp_path, kind):
    whole, file = shipped(kind).read_bytes(), tmp_path / "w.safetensors"
    for place in (len(whole) - 3, whole.index(b"data_sha256") + 20):
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(DataError, match="its checksum is another"):
            load_weights(kind, file)


def test_weights_without_a_checksum_are_read_with_a_word(tmp_path):
    arrays, facts = safetensors.read(shipped("network"))
    del facts["sha256"]
    numpy_files.save_file(arrays, tmp_path / "old.safetensors", facts)
    with pytest.warns(UserWarning, match="old.safetensors' have no checksum"):
        load_weights("network", tmp_path / "old.safetensors")


def test_the_file_format_is_safetensors(tmp_path):
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array([1, 2]), "c": np.float32([3.5])}
    safetensors.write(tmp_path / "x.safetensors", arrays, {"k": "v"})
    theirs = numpy_files.load_file(tmp_path / "x.safetensors")
    numpy_files.save_file(arrays, tmp_path / "y.safetensors", {"k": "v"})
    ours, facts = safetensors.read(tmp_path / "y.safetensors")
    assert facts == {"k": "v"}
    for name, array in arrays.items():
        np.testing.assert_array_equal(theirs[name], array)
        np.testing.assert_array_equal(ours[name], array)
        assert ours[name].dtype == array.dtype


def test_the_same_content_gives_the_same_bytes(tmp_path):
    facts = {"b": json.dumps([1]), "a": "2"}
    safetensors.write(tmp_path / "1", {"x": np.ones(3), "y": np.zeros(2)}, facts)
    safetensors.write(
        tmp_path / "2", {"y": np.zeros(2), "x": np.ones(3)}, dict(reversed(facts.items()))
    )
    assert (tmp_path / "1").read_bytes() == (tmp_path / "2").read_bytes()
