"""The section of the report on commands that were killed and resumed."""

from __future__ import annotations

from collections.abc import Sequence

from lpvmpc.kit.findings import Finding, Limit
from lpvmpc.reliability.kills import LEFT, Killed
from lpvmpc.reliability.report import Section


def kills_section(found: Sequence[Killed], seed: int) -> Section:
    """Kills and resumes of each command.

    Args:
        found: What came of each job.
        seed: Seed of the first; the others have the next ones.
    """
    rows = []
    for one in found:
        struck = [kill for kill in one.kills if not kill.done]
        by_name = [sum(kill.signal == name for kill in struck) for name in ("SIGKILL", "SIGTERM")]
        again = sum(kill.resumed for kill in struck)
        rows.append((one.job, len(struck), *by_name, again, one.compared, len(one.differing),
                     sum(bool(kill.wrong) for kill in one.kills)))
    differing = sum(len(one.differing) for one in found)
    wrong = sum(bool(kill.wrong) for one in found for kill in one.kills)
    return Section(
        key="kills",
        title="Kills and resumes",
        tried=sum(not kill.done for one in found for kill in one.kills),
        about=(
            "Small runs of the commands, each killed at moments drawn evenly over the time that it "
            "takes uninterrupted, by SIGKILL and SIGTERM in turn, and resumed; a kill may strike a "
            "resumed run. Each run that reached its end is compared with the uninterrupted one, "
            "byte by byte: Parquet, weights, tables and pictures; of JSON all but times and "
            "machine; of a video, which shows how long each step took, the number of its pictures. "
            "Wrong is a kill after which earlier results are gone, more than a line is printed, or "
            f"a process stays for more than {LEFT:g} s. `track` has no --resume: the same command "
            f"drives again over its own results. Seeds {seed} to {seed + len(found) - 1} "
            "(lpvmpc/reliability/kills.py)."
        ),
        header=("command", "kills", "SIGKILL", "SIGTERM", "of resumed runs", "runs compared",
                "files that differ", "wrong kills"),
        rows=tuple(rows),
        findings=(
            Finding(key="kills_differing", figure="files that differ after kills and resumes",
                    value=float(differing), limit=Limit.at_most(0),
                    why="what is resumed is what was never interrupted"),
            Finding(key="kills_wrong", figure="kills that lost, said or left something",
                    value=float(wrong), limit=Limit.at_most(0), why="nothing measured is lost"),
        ),
        faults=tuple(f"{one.job}, {what}" for one in found for what in one.wrong),
    )
