import numpy as np


def ay_peak(scenario):
    """Largest lateral acceleration vx^2 kappa of a scenario's reference [m/s2]."""
    return float(np.abs(scenario.speed.vx**2 * scenario.path.kappa).max())
