"""Every figure in README.md and docs/*.md stands in a stored result, or in the list of givens.

A number is a *figure* where somebody measured it. Such a sentence is listed in `MEASURED` with what
makes it from docs/results, so that it fails here as soon as the results say something else. All
other numbers are *given*: conditions, constants, sources, what the paper prints. Each of these
stands in given_figures.txt with the words around it, so that no number slips in unseen.

A number that fails: print it from a stored result (MEASURED), or, if nobody measures it, add its
phrase with `python tests/test_docs_figures.py`, which lists what is missing, and look at it there.
"""

import csv
import json
import math
import re
import statistics
import tomllib
from pathlib import Path

import pytest

from lpvmpc.control.registry import CORE
from lpvmpc.published import TRACKING

ROOT = Path(__file__).parents[1]
GIVEN = Path(__file__).with_name("given_figures.txt")
FILES = ["README.md", *sorted(f"docs/{file.name}" for file in (ROOT / "docs").glob("*.md"))]
NUMBER = re.compile(r"(?<![\w.])\d[\d,]*(?:\.\d+)?(?:e-?\d+)?")


def words(text):
    """The prose of a page in one line: without code, addresses and markup of links."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)
    text = re.sub(r"^(?: {4}|\t).*$", "", text, flags=re.M)
    text = re.sub(r"^\d+\. ", "", text, flags=re.M)  # numbered lists
    text = re.sub(r"`[^`]*`", "`", text)
    text = re.sub(r"\]\([^)]*\)", "]", text)
    return " ".join(text.split())


def table(name):
    with open(ROOT / "docs" / "results" / name, newline="") as file:
        return list(csv.DictReader(file))


# What is measured ---------------------------------------------------------------------------------


def short(value, ideal=False):
    """Two digits, no exponent; in the ideal world, where the step resolves no more, one below 1."""
    if ideal and value < 1.0:
        return f"{value:.1g}"
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"


def cell(runs, ideal):
    """Median RMSE and worst largest error [mm] over all seeds; a lost car is the worst there is."""
    done = [run for run in runs if run["completed"] == "True"]
    lost = [math.inf] * (len(runs) - len(done))
    rmse = sorted(1e3 * float(run["lateral_rmse_m"]) for run in done) + lost
    median = rmse[(len(runs) - 1) // 2]  # as worlds.md: the smallest that half do not exceed
    if math.isinf(median):
        return f"lost, {len(done)} of {len(runs)} arrive"
    if lost:
        return f"{short(median, ideal)} / lost, {len(done)} of {len(runs)} arrive"
    largest = 1e3 * max(float(run["lateral_max_m"]) for run in done)
    return f"{short(median, ideal)} / {short(largest, ideal)}"


COLUMNS = (("ideal", "paper"), ("ideal", "circuit-65"), ("rtk", "circuit-65"),
           ("fleet", "circuit-65"), ("production", "circuit-65"))


def headline():
    """The README's table, and how many seeds stand behind it."""
    rows = [row for row in table("worlds.csv") if row["part"] == "worlds"]
    for name in CORE:
        cells = []
        for where in COLUMNS:
            own = [r for r in rows if (r["case"], r["road"], r["controller"]) == (*where, name)]
            cells.append(cell(own, where[0] == "ideal"))
        yield f"| {name} | " + " | ".join(cells) + " |"
    seeds = {row["seed"] for row in rows if (row["case"], row["road"]) == ("rtk", "circuit-65")}
    yield f"error over {len(seeds)} seeds"


def speeds():
    runs = json.loads((ROOT / "docs" / "results" / "paper.json").read_text())["runs"]
    ours, theirs, plain = (
        next(r["speed_rmse_mps"] for r in runs
             if (r["group"], r["line"], r["road"]) == ("tuned", name, "paper"))
        for name in ("lpv-mpc", "lmpc-pso-pid", "lpv-mpc-paper")
    )
    yield (f"the speed's RMSE is {ours:.2g} m/s, that of `lmpc-pso-pid` {theirs:.2g}, that of "
           f"`lpv-mpc-paper` {plain:.2g}")


def near():
    """What the leaderboard says of the rival that is nearest, against us first of all."""
    found = json.loads((ROOT / "docs" / "results" / "benchmark.json").read_text())
    ratio, = (p["ratio"] for p in found["pairs"]
              if (p["world"], p["second"]) == ("all worlds", "lqr") and p["first"] == "lpv-mpc")
    rank, = (r for r in found["ranks"] if r["over"] == "all drawn worlds")
    assert ["lpv-mpc", "lqr"] in rank["groups"]
    largest = {(s["world"], s["controller"]): s["largest_p95_m"] for s in found["scores"]
               if (s["cells"], s["course"]) == ("full", "all")}
    others = {name for _, name in largest} - {"lpv-mpc"}
    ahead = [(world, name) for world in ("ideal", "rtk", "production", "fleet") for name in others
             if (largest[world, name] or 9.0) < largest[world, "lpv-mpc"]]
    assert ahead == [("fleet", "lqr")]
    yield f"its RMSE is {ratio:.2f} times that of `lpv-mpc` (median of the paired runs)"
    ours, theirs = (1e3 * largest["fleet", name] for name in ("lpv-mpc", "lqr"))
    yield f"(95th percentile {theirs:.0f} mm against {ours:.0f})"


def resolution():
    rows = table("fidelity/numerics-resolution.csv")
    apart = max(abs(float(r["RMSE at 1 ms"]) - float(r["at 0.25 ms"])) for r in rows)
    yield f"changes the ideal errors by up to {apart:.1g} mm"


def losses():
    """Where ours loses the car in the sampled worlds, also in those that the table leaves out."""
    own = [row for row in table("worlds.csv")
           if (row["part"], row["controller"]) == ("worlds", "lpv-mpc")]
    lost = {}
    for row in own:
        runs = lost.setdefault((row["case"], row["road"]), [0, 0])
        runs[0] += row["completed"] != "True"
        runs[1] += 1
    places = [f"`{case}` on {road.replace('circuit-', 'circuit ')}{' %' * ('-' in road)} "
              f"({bad} of {n})" for (case, road), (bad, n) in lost.items() if bad]
    yield (f"In the sampled worlds it loses the car in {', '.join(places)}" if places
           else f"In the sampled worlds it completes all {len(own)} runs")


def shortcomings():
    """Where a rival bears more than ours, and which promises are missed."""
    found = json.loads((ROOT / "docs" / "results" / "worlds.json").read_text())
    missed = [bar for bar in found["bars"].values() if not bar["ok"]]
    assert [bar["text"] for bar in missed] == ["rtk, paper: median RMSE"]
    yield (f"One of its {len(found['bars'])} promises is missed: `rtk` on `paper` has "
           f"{missed[0]['value']:.2f} mm, not {missed[0]['limit']:g}")
    bears, = (line for line in found["sentences"] if "rival bears more" in line)
    assert bears.count(" of noise of ") == 3 == bears.count("(to ")
    held = {(m["kind"], m["controller"]): m["held"] for m in found["margins"]}
    others = [held["noise", name] for name in ("lmpc-pso-pid", "stanley", "pure-pursuit")]
    yield (f"the noise of bad sensors, {held['noise', 'lpv-mpc']:.3g} times `rtk` on the circuit, "
           f"where `lmpc-pso-pid`, `stanley` and `pure-pursuit` bear {min(others):.0f} times and "
           "more")


def printed():
    yield (f"prints {1e3 * TRACKING['lateral_rmse_m']:g} / "
           f"{1e3 * TRACKING['lateral_max_m']:g} mm")


SPLITS = (
    ("training rows", "runs", "train"),
    ("a quarter of the runs held out", "runs", "test"),
    ("random samples held out", "random", "test"),
    ("braking in a turn held out", "without brake-in-turn", "test"),
    ("multi-sine held out", "without multi-sine", "test"),
    ("sine sweep held out", "without sine-sweep", "test"),
    ("friction 0.4-1.0, which neither was trained on; told to `network`, by similarity", "runs",
     "also"),
)


def fits():
    """The table of R2."""
    for text, split, part in SPLITS:
        cells = []
        for kind, digits in (("network", 4), ("network-secant", 3)):
            rows = [r for r in table(f"{kind}/r2.csv") if (r["split"], r["set"]) == (split, part)]
            assert len(rows) == 5  # seeds
            for axle in ("C_f", "C_r"):
                values = [float(row[axle]) for row in rows]
                cells.append(f"{statistics.median(values):.{digits}f} ({min(values):.{digits}f})")
        yield f"| {text} | " + " | ".join(cells) + " |"


def searched():
    """What was taken from the search for weights, and what was not."""
    weights = tomllib.loads(
        (ROOT / "lpvmpc" / "control" / "weights" / "lpv-mpc.toml").read_text())["weights"]
    history = [row for row in table("tuning/lpv-mpc/history.csv") if row["search"] == "genetic"]
    best = min(history, key=lambda row: abs(float(row["q_epsi"]) - weights["q_epsi"]))
    yield f"r_ax is {weights['r_ax']:g}. slip_cap is {weights['slip_cap']:g} for"
    yield f"for {float(history[-1]['slip_cap']):.2g}, so"
    yield f"q_epsi is the {weights['q_epsi']:g} of"
    yield f"as much ({float(best['best']):.3f} and {float(history[-1]['best']):.3f})"


MEASURED = {
    "docs/derivations.md": (searched,),
    "README.md": (headline, speeds, near, losses, shortcomings, resolution, printed),
    "docs/dataset.md": (fits,),
}


@pytest.mark.parametrize("file", MEASURED)
def test_what_is_measured_stands_in_a_stored_result(file):
    text = " ".join((ROOT / file).read_text().split())
    for source in MEASURED[file]:
        for sentence in source():
            assert sentence in text, f"{file} must say, after {source.__name__}: {sentence}"


# What is given ------------------------------------------------------------------------------------


def givens():
    """Phrases by file, each in the list as often as it stands in the page."""
    found, file = {}, ""
    for line in GIVEN.read_text().splitlines():
        if line.startswith("== "):
            file = line.removeprefix("== ")
        elif line and not line.startswith("#"):
            found.setdefault(file, []).append(line)
    return found


def unlisted(file, phrases):
    """Numbers in the prose of a page that are neither measured nor given; stale phrases."""
    text = (ROOT / file).read_text()
    for source in MEASURED.get(file, ()):
        for sentence in source():
            # as it stands in the page: broken over lines
            pattern = r"\s+".join(re.escape(word) for word in sentence.split())
            text = re.sub(pattern, " ", text)
    text, stale = words(text), []
    for phrase in sorted(phrases, key=len, reverse=True):
        if phrase in text:
            text = text.replace(phrase, "~", 1)
        else:
            stale.append(phrase)
    return [around(text, m) for m in NUMBER.finditer(text)], stale


def around(text, number):
    """A number with the two words on either side of it, but for those that are listed already."""
    before = text[: number.start()].split("~")[-1].split(" ")[-3:]
    after = text[number.end() :].split("~")[0].split(" ")[:3]
    return f"{' '.join(before)}{number[0]}{' '.join(after)}".strip()


@pytest.mark.parametrize("file", FILES)
def test_every_other_number_is_a_given_one(file):
    numbers, stale = unlisted(file, givens().get(file, []))
    assert not numbers, f"{file}: no result and no given stands behind {numbers}; see above"
    assert not stale, f"{file} says no more: {stale}; take it out of {GIVEN.name}"


def test_a_new_number_a_stale_one_and_code_are_told_apart(tmp_path, monkeypatch):
    monkeypatch.setattr("test_docs_figures.ROOT", tmp_path)
    (tmp_path / "page.md").write_text("It needs 3 tires\nand `x = 4` of 5 m.\n\n    y = 6\n")
    assert unlisted("page.md", ["needs 3 tires", "of 5 m"]) == ([], [])
    assert unlisted("page.md", ["needs 3 tires"])[0] == ["` of 5 m."]
    assert unlisted("page.md", ["needs 3 tires", "of 5 m", "of 7 m"]) == ([], ["of 7 m"])


def main():
    """Print the list anew: what is there and still stands, and what is missing."""
    known = givens() if GIVEN.exists() else {}
    for file in FILES:
        phrases = known.get(file, [])
        _, stale = unlisted(file, phrases)
        kept = [phrase for phrase in phrases if phrase not in stale]
        print(f"== {file}")
        print("\n".join(kept), end="\n" if kept else "")
        while numbers := unlisted(file, kept)[0]:
            print(numbers[0])
            kept.append(numbers[0])


if __name__ == "__main__":
    main()
