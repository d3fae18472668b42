"""Vectors of three as plain tuples, in compiled code."""

from numba import njit


@njit(cache=True)
def vector(p, i):
    """Vector i of an array of them."""
    return p[3 * i], p[3 * i + 1], p[3 * i + 2]


@njit(cache=True)
def cross(a, b):
    """Cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def dot(a, b):
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def add(a, b):
    """Sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit(cache=True)
def subtract(a, b):
    """Difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(cache=True)
def clip(x, limit):
    """A number cut to +-limit."""
    return min(max(x, -limit), limit)
