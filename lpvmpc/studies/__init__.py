"""Fidelity studies: how far the car can be trusted, one file per study.

`study.py` is the frame: what a study gets (a `CarUnderTest`) and what it gives (a `StudyResult`).
No measured car stands behind them. They are verification (the simulation against closed forms
and other people's code) and a cross-model check, not validation.
"""
