"""The solvers by name; each is optional but our own and ProxQP."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec

from lpvmpc.solvers.adapter import Adapter
from lpvmpc.solvers.condensed import (
    DAQP,
    HPIPM,
    Ours,
    OursActiveSet,
    PIQPDense,
    ProxQPDense,
    Quadprog,
)
from lpvmpc.solvers.in_stages import OSQP, Clarabel, PIQPStages, ProxQPSparse
from lpvmpc.solvers.stream import Stream

ADAPTERS: dict[str, tuple[Callable[[Stream], Adapter], str, str]] = {
    "lpvmpc": (Ours, "", "ProxQP, our checks, the active-set method as second try"),
    "active-set": (OursActiveSet, "", "our active-set method alone, our checks"),
    "proxqp-dense": (ProxQPDense, "proxsuite", "condensed"),
    "proxqp-sparse": (ProxQPSparse, "proxsuite", "in stages"),
    "piqp-dense": (PIQPDense, "piqp", "condensed"),
    "piqp-stages": (PIQPStages, "piqp", "in stages"),
    "daqp": (DAQP, "daqp", "condensed"),
    "quadprog": (Quadprog, "quadprog", "condensed"),
    "osqp": (OSQP, "osqp", "in stages"),
    "clarabel": (Clarabel, "clarabel", "in stages"),
    "hpipm": (HPIPM, "casadi", "condensed, by way of CasADi"),
}
"""Solvers by name: their adapter, the package they need, and what they are given."""


def available() -> tuple[list[str], dict[str, str]]:
    """The solvers that are installed, and the packages that the others lack, by name."""
    lacking = {name: package for name, (_, package, _) in ADAPTERS.items()
               if package and find_spec(package) is None}
    if "hpipm" not in lacking and not import_module("casadi").has_conic("hpipm"):
        lacking["hpipm"] = "casadi with HPIPM"
    return [name for name in ADAPTERS if name not in lacking], lacking
