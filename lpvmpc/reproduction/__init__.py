"""The paper's results beside ours: what is driven, what follows, the report.

`plan` says what is driven, `printed` is the controller of the printed formulas, `evidence` gathers
what was measured, `findings` puts it beside the paper's numbers and the promises, `figures` and
`report` show it. "The paper" is Kebbati et al., Autonomous driving using an optimized neural
network based adaptive LPV-MPC controller.
"""
