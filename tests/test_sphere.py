import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from lpvmpc.tune import sphere, sphere_report
from lpvmpc.tune.sphere import OPTIMUM, Runs, Study, Variant

COMMAND = "tune"


@pytest.fixture(scope="module")
def short():
    """A study of a few short runs."""
    return sphere.run(seed=3, seeds=4, settings=replace(sphere.SETTINGS, generations=12))


def invented(key="ours", **finals):
    """An algorithm with these distances at the end, one run each."""
    some = [
        Runs(selection=name, crossover="blend", seeds=tuple(range(len(values))),
             distances=np.column_stack([np.ones(len(values)), values]))
        for name, values in finals.items()
    ]
    settings = replace(sphere.SETTINGS, generations=1)
    return Variant(key=key, settings=settings, selections=tuple(some))


def test_the_optimum_is_exactly_25_and_on_a_bound():
    assert OPTIMUM == 25.0 == sphere.sphere(np.array([0.0, 0.0, 0.0, 0.0, 5.0]))
    rng = np.random.default_rng(0)
    points = rng.uniform(sphere.LOWER, sphere.UPPER, (1000, 5))
    assert min(map(sphere.sphere, points)) > OPTIMUM


def test_the_budget_is_that_of_the_papers_figure():
    assert sphere.SETTINGS.generations == 100 and sphere.SETTINGS.population == 10
    defaults = replace(sphere.SETTINGS, generations=15, population=20)
    assert defaults == type(defaults)()  # all else is Table 1


def test_the_median_run_comes_as_near_as_the_bar():
    """The bar, on ten seeds that are neither reported nor used to choose."""
    runs = sphere.search("mixed", sphere.SETTINGS, tuple(range(500, 510)))
    assert np.median(runs.final) <= sphere.BAR


def test_runs_only_come_nearer(short):
    for runs in (*short.ours.selections, *short.crossovers):
        assert runs.distances.shape == (4, 13)
        assert (np.diff(runs.distances, axis=1) <= 0.0).all()
        assert (runs.distances >= 0.0).all()
        assert (runs.nearest == runs.final).all()


def test_as_printed_the_best_is_lost_again(short):
    """Nobody keeps the best: what the last population holds is farther than what was once seen."""
    runs = short.printed.selections
    assert any((np.diff(r.distances, axis=1) > 0.0).any() for r in runs)
    assert sum((r.nearest < r.final).sum() for r in runs) > 0


def test_all_departures_from_the_paper_are_taken_back_one_by_one(short):
    ours, printed = (vars(short.variant(key).settings) for key in ("ours", "printed"))
    apart = {name for name in ours if ours[name] != printed[name]}
    alone = set()
    for variant in short.variants[2:]:
        changed = {n for n, value in vars(variant.settings).items() if value != ours[n]}
        assert len(changed) == 1
        name = changed.pop()
        assert vars(variant.settings)[name] == printed[name]
        alone.add(name)
    assert alone == apart == {"survival", "scale", "step"}


def test_the_crossover_is_chosen_on_other_seeds(short):
    assert [runs.crossover for runs in short.crossovers] == ["blend", "exchange"]
    assert {runs.selection for runs in short.crossovers} == {"mixed"}
    assert short.ours.of("mixed").seeds == (3, 4, 5, 6)
    assert short.crossovers[0].seeds == (1003, 1004, 1005, 1006)


def test_the_same_seed_gives_the_same_study(short):
    again = sphere.run(seed=3, seeds=4, settings=short.ours.settings)
    assert sphere_report.as_csv(again) == sphere_report.as_csv(short)


def test_equal_selections_are_not_told_apart():
    same = np.linspace(1.0, 2.0, 30)
    study = invented(mixed=same, roulette=same, tournament=same)
    assert sphere.difference(study) == pytest.approx(1.0)
    assert all(c.nearer == 0.5 and c.p == 1.0 for c in sphere.compare(study))
    assert sphere.verdict_on(study) == (
        "Our version, 30 seeds: no difference between the three selections can be told "
        "(Kruskal-Wallis p = 1). The paper's advantage of the mixed selection over both others is "
        "not confirmed."
    )


def test_runs_that_all_end_at_one_place_are_not_told_apart():
    study = invented(mixed=[0.5] * 5, roulette=[0.5] * 5, tournament=[0.5] * 5)
    assert sphere.difference(study) == 1.0
    assert "no difference" in sphere.verdict_on(study)


def test_all_is_said_of_all_alone():
    shares = (0.0, 0.0004, 0.05, 0.994, 896 / 900, 1.0)
    assert [sphere.share_text(share) for share in shares] == [
        "0%", "0.04%", "5%", "99%", "99.56%", "100%"]


def test_a_better_selection_is_named():
    low = np.linspace(1.0, 2.0, 30)
    study = invented(mixed=low, roulette=low + 5.0, tournament=low + 2.0)
    assert sphere.difference(study) < 1e-10
    found = {(c.one, c.other): c for c in sphere.compare(study)}
    assert found["mixed", "roulette"].nearer == 1.0
    assert found["roulette", "tournament"].nearer == 0.0
    text = sphere.verdict_on(study)
    assert "mixed ends nearer than roulette in 100% of the pairs of runs" in text
    assert "tournament ends nearer than roulette in 100% of the pairs of runs" in text
    assert text.endswith("over both others is confirmed.")
    worse = invented(mixed=low + 5.0, roulette=low, tournament=low)
    assert "roulette ends nearer than mixed" in sphere.verdict_on(worse)
    assert sphere.verdict_on(worse).endswith(
        "is not confirmed, and roulette and tournament are ahead of it."
    )
    between = invented(key="printed", mixed=low + 2.0, roulette=low + 5.0, tournament=low)
    text = sphere.verdict_on(between)
    assert text.startswith("Algorithm 1 as printed, 30 seeds: the three selections differ")
    assert text.endswith("is confirmed over roulette alone, and tournament is ahead of it.")


def test_the_verdict_follows_from_both_algorithms():
    low = np.linspace(1.0, 2.0, 30)
    ours = invented(mixed=low, roulette=low, tournament=low)
    printed = invented(key="printed", mixed=low, roulette=low + 5.0, tournament=low + 2.0)
    study = Study(variants=(ours, printed), crossovers=())
    text = sphere.verdict(study)
    assert sphere.verdict_on(ours) in text and sphere.verdict_on(printed) in text


def test_p_is_adjusted_for_three_comparisons():
    from scipy.stats import mannwhitneyu

    rng = np.random.default_rng(1)
    study = invented(mixed=rng.random(20), roulette=rng.random(20) + 0.2,
                     tournament=rng.random(20) + 0.5)
    pairs = [(0, 1), (0, 2), (1, 2)]
    raw = [mannwhitneyu(study.selections[i].final, study.selections[j].final).pvalue
           for i, j in pairs]
    order = np.argsort(raw)
    expected = np.maximum.accumulate(np.array(raw)[order] * [3, 2, 1]).clip(max=1.0)
    assert np.array([c.p for c in sphere.compare(study)])[order] == pytest.approx(expected)


def test_the_script_prints_and_saves_the_report(run, tmp_path):
    code, out, err = run("--sphere", "--generations", 3, "--seed", 7, "--json", "copy/values.json")
    assert (code, err) == (0, "")
    folder = tmp_path / "docs" / "results"
    saved = "Saved docs/results/ (sphere.md, sphere.csv, sphere.json, sphere.png)\n"
    assert out == (folder / "sphere.md").read_text() + saved
    values = json.loads((folder / "sphere.json").read_text())
    assert values == json.loads((tmp_path / "copy" / "values.json").read_text())
    rows = list(csv.DictReader((folder / "sphere.csv").read_text().splitlines()))
    assert len(rows) == 30 * (5 * 3 + 2) and rows[0]["seed"] == "7"
    own = [r for r in rows if (r["part"], r["selection"]) == ("ours", "mixed")]
    mixed = [float(r["distance_3"]) for r in own]
    # 1e-5: the CSV has six digits.
    told = values["algorithms"]["ours"]["selections"]["mixed"]["median"]
    assert told == pytest.approx(np.median(mixed), rel=1e-5)
    assert values["bars"]["mixed_median"] == {"limit": sphere.BAR, "ok": False}
    assert "Seeds 7 to 36" in out and "MISSED" in out and values["verdict"] in out
    assert (folder / "sphere.png").read_bytes().startswith(b"\x89PNG")
    tables = [line for line in out.splitlines() if line.startswith("|")]
    assert max(map(len, tables)) <= 80


def test_the_picture_has_the_same_bytes_twice(short, tmp_path):
    pictures = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        pictures.append(sphere_report.save(short, tmp_path / name)[-1].read_bytes())
    assert pictures[0] == pictures[1]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--resume"], "--resume is True, but must be left out with --sphere."),
        (["--jobs", "2"], "--jobs is 2, but must be left out with --sphere."),
        (["--controller", "lmpc"], "--controller is 'lmpc', but must be left out with --sphere."),
        (["--generations", "0"], "--generations is 0, but must be from 1 to 10000."),
        (["--population", "1"], "--population is 1, but must be from 2 to 10000."),
        (["--seed", "-1"], "--seed is -1, but must be from 0 to 4611686018427387904."),
    ],
)
def test_bad_options_are_one_sentence(run, arguments, sentence):
    assert run("--sphere", *arguments) == (2, "", f"Error: {sentence}\n")


def test_a_folder_that_cannot_be_written_is_one_sentence(run, tmp_path):
    (tmp_path / "file").write_text("")
    code, _, err = run("--sphere", "--out", tmp_path / "file" / "below")
    assert code == 2
    assert err.startswith("Error: Cannot write into") and err.count("\n") == 1
