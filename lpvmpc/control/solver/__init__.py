"""Quadratic programs solved and checked: what every controller on a QP trusts."""
