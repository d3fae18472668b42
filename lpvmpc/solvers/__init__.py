"""Other solvers on the QPs of our laps: recorded, solved, and checked by us."""
