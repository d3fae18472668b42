import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from lpvmpc import learn
from lpvmpc.control.stiffness import network, network_file
from lpvmpc.errors import DataError, LPVMPCError, OptionError
from lpvmpc.kit import safetensors
from lpvmpc.learn import collect as collection
from lpvmpc.learn import dataset
from lpvmpc.learn import scores as fit

torch = pytest.importorskip("torch")
from lpvmpc.learn import train as training  # noqa: E402  (needs torch)
from lpvmpc.learn.train import Job, preset, splits, train  # noqa: E402

COMMAND = "train"


@pytest.fixture(scope="session")
def file(tmp_path_factory):
    """Data of 18 runs or more: two of every kind."""
    out = tmp_path_factory.mktemp("training") / "s.parquet"
    collection.collect(collection.Plan(samples=18 * 128, seed=5), out)
    return out


@pytest.fixture(scope="module")
def data(file):
    return dataset.read(file)


@pytest.fixture(scope="module")
def car(plant):
    return plant.params


def subset(data, mask):
    """The rows of a mask as data."""
    return replace(data, columns={k: v[mask] for k, v in data.columns.items()})


# Splits -----------------------------------------------------------------------------------------


def test_held_out_runs_share_no_run_with_the_training(data):
    runs = splits(data, 0)[0]
    assert runs.name == "runs"
    train_runs, test_runs = set(data["run"][runs.train]), set(data["run"][~runs.train])
    assert not train_runs & test_runs
    assert set(data["manoeuvre"][~runs.train]) == set(data.kinds), "every kind is tested"
    assert set(data["manoeuvre"][runs.train]) == set(data.kinds), "every kind is trained"


def test_each_kind_is_held_out_in_turn(data):
    found = {split.name: split for split in splits(data, 0)}
    assert set(found) == {"runs", "random", *(f"without {kind}" for kind in data.kinds)}
    for kind in data.kinds:
        np.testing.assert_array_equal(found[f"without {kind}"].train, data["manoeuvre"] != kind)


def test_splits_depend_on_the_seed_alone(data):
    for a, b in zip(splits(data, 1), splits(data, 1), strict=True):
        np.testing.assert_array_equal(a.train, b.train)
    assert (splits(data, 1)[0].train != splits(data, 2)[0].train).any()


def test_too_few_runs_to_split_are_refused(data):
    kind = data["manoeuvre"] == "step-steer"
    one = subset(data, data["run"] == data["run"][0])
    with pytest.raises(DataError, match="1 run of the kind step-steer, but at least 2"):
        splits(one, 0)
    with pytest.raises(DataError, match="one kind of manoeuvre only, step-steer"):
        splits(subset(data, kind), 0)


# Learning ---------------------------------------------------------------------------------------


def test_our_network_learns_the_tires_in_seconds(data, car):
    trained = train(data, Job(preset=preset("default", 60), only=("runs",)), car)
    scores = fit.scores(
        fit.predict(trained.weights[0], data, car), data, ~trained.names[0][1].train
    )
    # a fifth of the usual data and training: 0.97 instead of 0.99
    assert min(scores["C_f"], scores["C_r"]) > 0.9
    assert min(scores["Fy_f"], scores["Fy_r"]) > 0.97
    assert trained.curve[-1, 1] < 0.1 * trained.curve[0, 1]


def test_a_car_that_does_nothing_lies_in_the_trained_range(data, car):
    trained = train(data, Job(preset=preset("default", 1), seeds=(0,)), car)
    z_low = trained.weights[0].arrays["z_low"]
    assert (z_low[:, :2] == 0.0).all(), "squares of roll moment and longitudinal force"
    tire = network.NetworkTire(car, trained.weights[0])
    tire.axle(0, 0.0, 0.0, 0.0, 0.0)
    assert tire.clamped == 0


def test_the_papers_network_learns_too(data, car):
    trained = train(data, Job(preset=preset("paper", 150), only=("runs",)), car)
    scores = fit.scores(fit.predict(trained.weights[0], data, car), data, trained.names[0][1].train)
    assert min(scores["C_f"], scores["C_r"]) > 0.3
    assert [trained.weights[0].arrays[f"W{i}"].shape for i in range(5)] == [
        (16, 5), (28, 16), (16, 28), (9, 16), (2, 9),
    ]


def test_the_papers_preset_is_the_papers():
    how = training.PRESETS["paper"]
    assert (how.epochs, how.batch, how.rate, how.cycle) == (2500, 64, 5e-4, False)
    assert network_file.SECANT_SIZES == (5, 16, 28, 16, 9, 2)


@pytest.mark.parametrize("name", ["default", "paper"])
def test_torch_and_the_compiled_network_agree(data, car, name):
    """Loss computed from the exported weights by numba equals torch's."""
    trained = train(data, Job(preset=preset(name, 3), only=("runs",)), car)
    p = fit.predict(trained.weights[0], data, car)
    mask = ~trained.names[0][1].train
    if name == "paper":
        w = trained.weights[0].arrays
        y = np.column_stack([data["Cf_Nprad"], data["Cr_Nprad"]])
        loss = (((p.C - y) / w["y_std"])[mask] ** 2).mean()
        # outputs below 5 % of the nominal stiffness are bounded, which is rare
        assert loss == pytest.approx(trained.curve[-1, 2], rel=1e-3)
        return
    samples = dataset.samples_of(data, car)
    error, z = 0.0, np.zeros(3)
    for k in np.flatnonzero(mask):
        for i, axle in enumerate("fr"):
            s, D = network.features(
                samples["alpha"][k, i], samples["Fx"][k, i], samples["ax"][k],
                samples["roll"][k], 1.0, samples["norms"][k, i], z,
            )
            force = (p.Fy[k, i] - data[f"Fy{axle}_N"][k]) / D
            slope = (p.slope[k, i] - data[f"slope_{axle}_Nprad"][k]) / (car.Cf, car.Cr)[i]
            error += force**2 / (s * s + 0.1) + 0.1 * slope**2
    # 2 %: inference clamps inputs to the training's range, the loss does not
    assert error / mask.sum() / 2 == pytest.approx(trained.curve[-1, 2], rel=0.02)


def test_networks_trained_together_are_those_trained_alone(data, car):
    job = Job(preset=preset("default", 5), seeds=(0, 3))
    both = train(data, job, car)
    alone = train(data, replace(job, seeds=(0,), only=("runs",)), car)
    for name, array in alone.weights[0].arrays.items():
        # the batched products may be added up in another order, in single precision
        np.testing.assert_allclose(both.weights[0].arrays[name], array, rtol=0.05, atol=0.05)
    assert [s for s, _ in both.names] == [0] * 11 + [3] * 11


def test_the_same_seed_gives_the_same_weights_and_another_does_not(data, car):
    job = Job(preset=preset("default", 4), only=("runs",))
    a, b, c = (train(data, replace(job, seeds=(s,)), car).weights[0].arrays for s in (0, 0, 1))
    assert all(np.array_equal(a[name], b[name]) for name in a)
    assert not np.array_equal(a["u"], c["u"])


def test_interrupted_training_resumes_to_the_same_bytes(data, car, tmp_path):
    job = Job(preset=preset("default", 6), only=("runs", "random"))
    whole = train(data, job, car)

    def stop(epoch, loss):
        if epoch == 3:
            raise KeyboardInterrupt

    checkpoint = tmp_path / "c"
    with pytest.raises(KeyboardInterrupt):
        train(data, job, car, checkpoint=checkpoint, progress=stop)
    rest = train(data, job, car, checkpoint=checkpoint, resume=True)
    for w, r in zip(whole.weights, rest.weights, strict=True):
        assert all(np.array_equal(w.arrays[name], r.arrays[name]) for name in w.arrays)
    np.testing.assert_array_equal(whole.curve, rest.curve)
    with pytest.raises(DataError, match="has another networks"):
        train(data, replace(job, seeds=(9,)), car, checkpoint=checkpoint, resume=True)
    with pytest.raises(DataError, match="has another preset"):
        longer = replace(job, preset=preset("default", 7))
        train(data, longer, car, checkpoint=checkpoint, resume=True)
    checkpoint.write_bytes(checkpoint.read_bytes()[:-9])
    with pytest.raises(DataError, match="damaged"):
        train(data, job, car, checkpoint=checkpoint, resume=True)


def test_training_stopped_in_its_first_epoch_leaves_the_checkpoint_it_promises(
    data, car, tmp_path, monkeypatch
):
    job = Job(preset=preset("default", 200), only=("runs",))
    step = training._State.step
    calls = []

    def stop(state, *what):
        calls.append(what)
        if len(calls) == 3:  # in the middle of an epoch
            raise KeyboardInterrupt
        return step(state, *what)

    monkeypatch.setattr(training._State, "step", stop)
    checkpoint = tmp_path / "c"
    with pytest.raises(KeyboardInterrupt):
        train(data, job, car, checkpoint=checkpoint)
    arrays, _ = safetensors.read(checkpoint)
    assert arrays["progress"].tolist() == [0, 0]

    def leave(epoch, loss):
        raise KeyboardInterrupt

    first = [], []
    for place, resume in zip(first, (True, False), strict=True):
        file = checkpoint if resume else tmp_path / "d"
        with pytest.raises(KeyboardInterrupt):
            train(data, job, car, checkpoint=file, resume=resume, progress=leave)
        place.append(file.read_bytes())
    assert first[0] == first[1]


def test_a_loss_that_is_no_number_is_an_error(data, car):
    broken = dict(data.columns)
    broken["Fyf_N"] = broken["Fyf_N"] * 1e30
    with pytest.raises(LPVMPCError, match="diverged in epoch 0"):
        train(replace(data, columns=broken), Job(preset=preset("default", 2), only=("runs",)), car)


def test_jobs_that_cannot_be_trained_are_refused():
    with pytest.raises(OptionError, match="epochs is 0"):
        Job(preset=preset("default", 0))
    with pytest.raises(OptionError, match="seeds"):
        Job(preset=preset("default"), seeds=())


# Measures ---------------------------------------------------------------------------------------


def test_r2_is_one_for_the_truth_and_zero_for_the_mean():
    y = np.array([1.0, 2.0, 4.0])
    assert fit.r2(y, y) == 1.0
    assert fit.r2(y, np.full(3, y.mean())) == 0.0
    assert np.isnan(fit.r2(np.ones(3), np.ones(3)))


def test_scores_see_a_perfect_prediction(data):
    truth = fit.Prediction(
        np.column_stack([data["Cf_Nprad"], data["Cr_Nprad"]]),
        np.column_stack([data["Fyf_N"], data["Fyr_N"]]),
        np.column_stack([data["slope_f_Nprad"], data["slope_r_Nprad"]]),
    )
    every = np.ones(len(data), dtype=bool)
    assert set(fit.scores(truth, data, every).values()) == {1.0}
    assert {row["p95_error"] for row in fit.by_slip(truth, data, every)} == {0.0}


# The script -------------------------------------------------------------------------------------


def test_the_script_leaves_weights_and_a_report(run, file, tmp_path):
    code, out, err = run(
        "--data", file, "--out", "w/n.safetensors", "--epochs", 3, "--seeds", 2, "--also", file
    )
    assert (code, err) == (0, "")
    weights = network_file.load_weights("network", tmp_path / "w" / "n.safetensors")
    facts = network_file.facts(weights)
    assert facts["data_sha256"] == dataset.file_sha256(file) and facts["seed"] == 0
    found = sorted(f.name for f in (tmp_path / "w" / "n-fit").iterdir())
    assert found == [
        "learning-curve.csv", "learning-curve.png", "prediction.png", "r2.csv", "slip.csv",
    ]
    rows = (tmp_path / "w" / "n-fit" / "r2.csv").read_text().splitlines()
    assert rows[0].startswith("seed,split,set,samples,C_f,C_r,Fy_f")
    assert len(rows) == 1 + 2 * (11 * 2 + 1)
    assert "brake-in-turn" in out and "Paper: 0.88 train, 0.78 test" in out
    assert max(len(line) for line in out.splitlines()) <= 80
    assert not list((tmp_path / "w").glob("*.checkpoint"))


def test_a_resumed_training_leaves_the_same_bytes(run, file, tmp_path, monkeypatch):
    words = ["--data", str(file), "--epochs", "1", "--seeds", "1", "--out", "n.safetensors"]
    left = []
    for more in ([], ["--resume"]):
        monkeypatch.setattr(sys, "argv", ["train.py", *words, *more])
        assert run(*words, *more)[0] == 0
        left.append((tmp_path / "n.safetensors").read_bytes())
    assert left[0] == left[1]
    assert b"--epochs 1 --seeds 1 --out n.safetensors" in left[0]


def test_data_of_another_car_are_a_warning(run, file, tmp_path):
    data = dataset.read(file)
    import pyarrow.parquet as pq

    table = pq.read_table(file)
    meta = {**table.schema.metadata, b"car_sha256": b'"0"'}
    pq.write_table(table.replace_schema_metadata(meta), tmp_path / "other.parquet")
    assert len(data)
    code, _, err = run("--data", "other.parquet", "--epochs", 1, "--seeds", 1)
    assert code == 0
    assert err == (
        "Warning: the data have no checksum, so damage to them cannot be told.\n"  # it was dropped
        "Warning: the data were collected with another vehicle.xml.\n"
    )


@pytest.mark.parametrize(
    "arguments, sentence",
    [
        (("--data", "none.parquet"), "There is no data file 'none.parquet'"),
        (("--epochs", 0), "--epochs is 0, but must be from 1 to"),
        (("--seeds", 0), "--seeds is 0"),
        (("--preset", "big"), "--preset"),
        (("--out", "w.pt"), "--out is 'w.pt', but must be a file name ending in .safetensors"),
    ],
)
def test_bad_options_are_one_sentence(run, arguments, sentence):
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("Error: ") and err.count("\n") == 1 and sentence in err


def test_an_unwritable_place_is_one_sentence(run, file, tmp_path):
    (tmp_path / "file").write_text("")
    code, out, err = run("--data", file, "--out", "file/w.safetensors")
    assert (code, out) == (2, "")
    assert "Cannot write into 'file'" in err and err.count("\n") == 1


def test_a_missing_torch_is_one_sentence(run, file, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "lpvmpc.learn.train")
    monkeypatch.delattr(learn, "train")
    code, out, err = run("--data", file)
    assert code == 2 and err == (
        "Error: Training needs torch; pip install 'lpvmpc[train]' brings it.\n"
    )


def test_ctrl_c_leaves_a_checkpoint_to_resume(file, tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-m", "lpvmpc", "train", "--data", str(file), "--out", "w.safetensors",
         "--epochs", "5000", "--seeds", "1"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )
    checkpoint = tmp_path / "w.safetensors.checkpoint"
    deadline = time.monotonic() + 240.0
    while not checkpoint.exists():
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (130, "")
    assert err == "Interrupted; --resume goes on from here.\n"
    arrays, _ = safetensors.read(checkpoint)
    assert 0 < arrays["progress"][0] < 5000
    assert not (tmp_path / "w.safetensors").exists()
