"""The paper's numbers, figures and printed formulas beside ours."""
