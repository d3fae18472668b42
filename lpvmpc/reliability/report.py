"""The report of what happens when things go wrong: a section for each kind of trial."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lpvmpc.kit.findings import Finding, Limit, promises_sentence, promises_table
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import machine
from lpvmpc.kit.report import at_a_time, csv_text, finite, record, versions_line
from lpvmpc.reliability import misbehaving
from lpvmpc.reliability.damage import FAULTS, WAYS, Damaged
from lpvmpc.reliability.inputs import NO_COMMANDS, Answer
from lpvmpc.reliability.loops import BESIDE, CONTROLLER, GRIP, LATENCY, WHOLE, Driven


@dataclass(frozen=True, kw_only=True)
class Section:
    """What one kind of trial has given."""

    key: str
    """Its name in files and options."""
    title: str
    """Its heading."""
    tried: int
    """How many were tried."""
    about: str
    """What was tried, what counts as right, how many and from which seed."""
    header: tuple[str, ...]
    """Columns of its table."""
    rows: tuple[tuple[object, ...], ...]
    """Rows of its table."""
    findings: tuple[Finding, ...]
    """Its promises."""
    faults: tuple[str, ...] = ()
    """Every single fault, and every run that did not complete, with its cause."""
    not_held: str = ""
    """What does not hold beside its promises, in a clause."""


def section_of(told: Mapping[str, Any]) -> Section:
    """A section from what `dataclasses.asdict` made of it.

    Raises:
        ValueError, TypeError, KeyError: It is none.
    """
    findings = tuple(
        Finding(**{**one, "limit": one["limit"] and Limit(**one["limit"])})
        for one in told["findings"]
    )
    rows = tuple(tuple(row) for row in told["rows"])
    return Section(**{**told, "header": tuple(told["header"]), "rows": rows, "findings": findings,
                      "faults": tuple(told["faults"])})


def _none(key: str, figure: str, count: int, why: str) -> Finding:
    """A promise that there is none of something."""
    return Finding(key=key, figure=figure, value=float(count), limit=Limit.at_most(0), why=why)


def inputs_section(answers: Sequence[Answer]) -> Section:
    """Wrong command lines and files."""
    tried, bad = Counter[str](), Counter[str]()
    slowest: dict[str, float] = {}
    for answer in answers:
        first = answer.wrong.words[0]
        name = "no command" if answer.wrong.words in NO_COMMANDS else first
        tried[name] += 1
        bad[name] += bool(answer.fault)
        slowest[name] = max(slowest.get(name, 0.0), answer.seconds)
    faults = [a for a in answers if a.fault]
    return Section(
        key="inputs",
        title="Wrong inputs",
        tried=len(answers),
        about=(
            f"{len(answers)} wrong command lines and files, a fixed list "
            "(lpvmpc/reliability/inputs.py): words that are no numbers, values outside their "
            "domain, options that exclude each other, files that are empty, damaged, of another "
            "kind, nested deeply, longer than memory, pipes, devices and folders. Each must be "
            "refused in one printable sentence with exit code 2, at once. No seed."
        ),
        header=("given to", "tried", "refused", "faults", "slowest [s of CPU]"),
        rows=tuple((name, n, n - bad[name], bad[name], f"{slowest[name]:.1f}")
                   for name, n in sorted(tried.items())),
        findings=(
            Finding(key="inputs_tried", figure="wrong inputs tried", value=float(len(answers)),
                    limit=Limit.at_least(400), why="the list that issue 13 asks for"),
            _none("inputs_faults", "wrong inputs not refused in one sentence", len(faults),
                  "a user needs to know what is wrong, and nothing else"),
        ),
        faults=tuple(f"{' '.join(a.wrong.words)[:80]}: {a.fault}" for a in faults),
    )


def files_section(found: Sequence[Damaged], count: int, seed: int) -> Section:
    """Damaged files."""
    kinds = ("refused", "told", "harmless", *FAULTS)
    wrong = {kind: sum(one.outcomes[kind] for one in found) for kind in FAULTS}
    return Section(
        key="files",
        title="Damaged files",
        tried=sum(sum(one.outcomes.values()) for one in found),
        about=(
            f"Each kind of file that the package writes and reads again, damaged {count} times "
            f"from seed {seed} ({', '.join(WAYS)}: lpvmpc/reliability/damage.py) and read. "
            "Refused: a sentence, or a kept result that is driven again. Told: read, with a "
            "warning that it has no checksum. Harmless: the same content was read. Silent: other "
            "content was taken for good. Raised: an exception that is no sentence."
        ),
        header=("file", "damaged", *kinds),
        rows=tuple((one.name, sum(one.outcomes.values()), *(one.outcomes[k] for k in kinds))
                   for one in found),
        findings=(
            _none("files_silent", "damaged files taken for whole ones", wrong["silent"],
                  "a result from damaged data is no result"),
            _none("files_raised", "damaged files that ended in a traceback", wrong["raised"],
                  "a user needs to know what is wrong, and nothing else"),
        ),
        faults=tuple(f"{one.name}, damage {text}" for one in found for text in one.examples),
    )


def controllers_section(found: misbehaving.Trials) -> Section:
    """Controllers that do wrong."""
    rows = []
    for what in (*misbehaving.ENDS, *misbehaving.RAISES, *misbehaving.ANSWERS, *misbehaving.TOLD):
        row: list[object] = [what]
        for mode in ("here", "isolated"):
            row += [found.tried[what, mode], found.told[what, mode]]
        rows.append(tuple(row))
    n = sum(found.tried.values())
    return Section(
        key="controllers",
        title="Controllers that do wrong",
        tried=n,
        about=(
            f"{n} runs from seed {found.seed} of controllers that raise, hang, die, hoard memory "
            "or answer what is no command, in their constructor, in `reset` or after 0 to "
            f"{misbehaving.LATEST} commands (lpvmpc/reliability/misbehaving.py): in this process "
            "what it survives, and everything in processes of their own. Told: ended in one "
            "printable sentence, with all that was measured until then, and no process left "
            f"behind. Limits: {misbehaving.STEP_TIMEOUT:g} s a call, {misbehaving.START_TIMEOUT:g} "
            f"s to start, {misbehaving.MEMORY} MiB; the longest run took {found.longest_s:.1f} s."
        ),
        header=("what it does", "here", "told", "isolated", "told there"),
        rows=tuple(rows),
        findings=(
            Finding(key="controllers_faults", figure="controllers whose failure is not told",
                    value=float(len(found.faults)), limit=Limit.at_most(0),
                    why="a controller's failure is its result, and nobody else's"),
        ),
        faults=tuple(found.faults),
    )


def loops_section(driven: Driven) -> Section:
    """Random closed loops."""
    worlds = [(name, *counts, counts[0] + counts[2] - counts[1] - counts[3])
              for name, counts in driven.by_world.items()]
    lost = driven.runs - driven.completed
    ends = ", ".join(f"{n} {what}" for what, n in driven.causes.most_common())
    return Section(
        key="loops",
        title="Random roads",
        tried=driven.runs,
        about=(
            f"{driven.runs} runs of `{CONTROLLER}`, run i (also its seed) on a road with at least "
            f"one hairpin of 9.5 to 14 m: whole roads, `random-i`, below {WHOLE}, then short ones, "
            "`hairpin-i`, a hairpin and little else; a run drives for "
            f"{driven.seconds[0]:.0f} s (median), all together for "
            f"{driven.seconds[1] / 3600.0:.1f} h. In all worlds in turn, planned for "
            f"{100 * GRIP[0]:.0f} to {100 * GRIP[1]:.0f} % of the grip that road and tires have, "
            f"with an untold latency of 0 to {LATENCY} ms in place of the world's, started up to "
            f"{BESIDE:g} m beside the line (lpvmpc/reliability/loops.py). "
            "`lpvmpc track --scenario random-i` drives such a road alone. Each run that did not "
            "complete was driven again with one hardship less at a time, all else drawn alike, to "
            "find its cause (lpvmpc/reliability/causes.py). Of the completed ones "
            f"{driven.left_road} left the road for a while; lateral RMSE, the start beside the "
            f"line included: median {driven.rmse_mm[0]:.0f} mm, 95th percentile "
            f"{driven.rmse_mm[1]:.0f} mm; {driven.fallbacks} control instants of all used the "
            f"fallback; the slowest step took {driven.slowest_step_us / 1000.0:.1f} ms of CPU, the "
            f"longest run {driven.longest_wall_s:.0f} s."
        ),
        header=("world", "whole roads", "completed", "short ones", "of these completed",
                "not completed"),
        rows=tuple(worlds),
        not_held=(f"{lost} of {driven.runs} random runs did not complete ({ends}); each is below "
                  "with what lets it complete" if lost else ""),
        findings=(
            _none("loops_exceptions", "random runs that raised", driven.exceptions,
                  "a run ends with a verdict"),
            _none("loops_nan", "random runs with a result that is no number", driven.not_finite,
                  "a result is a number"),
            _none("loops_late", "random runs with a step above 33 ms of CPU", driven.late,
                  "the control period"),
        ),
        faults=tuple(
            f"{run.scenario} in {run.world}, grip {run.scenario_options['grip']:g}, latency "
            f"{1000 * (run.latency or 0.0):.0f} ms, started at {run.start_offset[0]:g} m: {why}"
            for run, why in driven.lost
        ),
    )


def qps_section(found: Mapping[str, Any]) -> Section:
    """Random quadratic programs, as `bench.fuzz.qps` gives them."""
    keys = ("count", "solvable", "refused", "wrong", "answered", "slow", "second")
    solvable = max(found["solvable"], 1)
    return Section(
        key="qps",
        title="Quadratic programs",
        tried=found["count"],
        about=(
            f"{found['count']} random problems from seed {found['seed']} against the solver of "
            "the controllers; whether one has a solution is known from how it is made, whether an "
            "answer is it is judged without the solver (lpvmpc/bench/fuzz.py). Wrong: further than "
            "1e-3 of its size from the solution; answered: though it has none; slow: more than "
            f"5 ms of CPU; second: by the second method. Median {found['p50_us']:.0f} us, 99th "
            f"percentile {found['p99_us']:.0f} us, worst {found['worst_ms']:.1f} ms of CPU."
        ),
        header=("kind", *keys, "worst [ms]"),
        rows=tuple((name, *(one[key] for key in keys), f"{one['worst_ms']:.2f}")
                   for name, one in found["kinds"].items()),
        findings=(
            Finding(key="qps_refused", figure="solvable problems refused, per 10,000",
                    value=1e4 * found["refused"] / solvable, limit=Limit.at_most(1),
                    why="issue 13"),
            _none("qps_wrong", "answers that are not the solution", found["wrong"],
                  "an accepted answer is the optimum"),
            _none("qps_answered", "answers to problems without a solution", found["answered"],
                  "a problem without a solution is refused"),
            _none("qps_slow", "problems that took more than 5 ms of CPU", found["slow"],
                  "issue 13"),
        ),
    )


def report(
    sections: Sequence[Section], *, quick: bool, jobs: int, left_out: Sequence[str] = ()
) -> str:
    """The whole report as Markdown, beginning with what does not hold and what was left out."""
    found = [finding for section in sections for finding in section.findings]
    lines = [
        "# What happens when things go wrong", "",
        f"Written by `lpvmpc reliability{' --quick' if quick else ''}` on {machine()}, "
        f"{at_a_time(jobs)}. {versions_line()}", "",
        " ".join([
            promises_sentence(found), *(f"{s.not_held}." for s in sections if s.not_held),
            *([f"Not tried in this report: {', '.join(left_out)}."] if left_out else []),
        ]),
        "",
        promises_table("Promises", found, "{:.0f}".format),
        "No limit was set after a result had been seen.", "",
    ]
    for section in sections:
        lines += [f"## {section.title}", "", section.about, "",
                  markdown_table(section.title, section.header, section.rows)]
        if section.faults:
            lines += ["One by one:", "", *(f"- {_code(text)}" for text in section.faults), ""]
    return "\n".join(lines).rstrip() + "\n"


def _code(text: str) -> str:
    """Text that Markdown leaves alone."""
    return f"`{text.replace('`', chr(39))}`"


def as_csv(sections: Sequence[Section]) -> str:
    """Every number of the tables."""
    rows = [
        (section.key, row[0], name, cell)
        for section in sections
        for row in section.rows
        for name, cell in zip(section.header[1:], row[1:], strict=True)
    ]
    return csv_text(("trial", "of", "what", "value"), rows)


def as_json(sections: Sequence[Section], *, quick: bool, jobs: int) -> dict[str, Any]:
    """The same with the promises and every fault, for JSON."""
    return {
        "sections": [
            {
                "key": s.key,
                "about": s.about,
                "rows": [dict(zip(s.header, row, strict=True)) for row in s.rows],
                "findings": [
                    {"key": f.key, "figure": f.figure, "value": finite(f.value),
                     "limit": f.limit.text if f.limit else None, "ok": f.ok} for f in s.findings
                ],
                "faults": list(s.faults),
            }
            for s in sections
        ],
        "record": record(quick=quick, jobs=jobs),
    }
