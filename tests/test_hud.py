import numpy as np
import pytest
from fake_log import fake_path

from lpvmpc.picture.video.hud import Hud, _number


@pytest.fixture
def hud():
    road = np.stack(fake_path().at(np.linspace(0, 600, 50))[:2], axis=1)
    return Hud(1280, 720, title="paper", subtitle="lpv-mpc", road=road,
               scales={"ey_mm": 5, "steer_deg": 10, "acc_mps2": 8, "wind_mps": 60})


def values(**changes):
    names = ("t_s", "vx_mps", "vx_ref_mps", "ey_mm", "steer_deg", "ax_mps2", "ay_mps2", "wind_mps",
             "step_ms", "x_m", "y_m", "psi_rad")
    return dict.fromkeys(names, 0.0) | changes


def test_an_error_to_the_left_moves_the_gauge_to_the_left(hud):
    def marker(ey_mm):
        frame = np.zeros((720, 1280, 3), np.uint8)
        hud.draw(frame, values(ey_mm=ey_mm))
        left, right, y = hud._bar("error")
        return left + int(np.argmax(frame[y, left:right].sum(axis=1)))

    assert marker(4.0) < marker(0.0) < marker(-4.0)


def test_numbers_that_are_not_finite_are_dashes(hud):
    frame = np.zeros((720, 1280, 3), np.uint8)
    hud.draw(frame, dict.fromkeys(values(), np.nan) | {"t_s": 1.0})
    assert _number(np.nan, 2) == "–"


def test_a_rounded_zero_has_no_sign():
    assert _number(-0.004, 2, sign=True) == "0.00"
    assert _number(-0.4, 1, sign=True) == "−0.4"


def test_instruments_darken_their_panels_only(hud):
    frame = np.full((720, 1280, 3), 200, np.uint8)
    hud.draw(frame, values())
    assert np.all(frame[300:500, 200:1000] == 200)
    assert np.median(frame[640:]) < 100


def test_the_map_car_stands_on_the_path(hud):
    path = fake_path()
    frame = np.zeros((720, 1280, 3), np.uint8)
    x, y, psi, _ = (float(v) for v in path.at(300.0))
    hud.draw(frame, values(x_m=x, y_m=y, psi_rad=psi))
    u, v = hud._pixel(x, y)
    assert tuple(frame[round(float(v)), round(float(u))]) == (255, 176, 60)


def test_the_text_fits_its_cells(hud):
    """The widest numbers end before the next instrument starts."""
    width = hud._wide("88.8 ref", 15, 500)
    assert hud.cells["speed"] + 96 + width < hud.cells["error"] - 14


def test_the_clock_stands_clear_of_the_longest_title():
    road = np.stack(fake_path().at(np.linspace(0, 600, 50))[:2], axis=1)
    hud = Hud(1280, 720, title="double-lane-change", subtitle="my_module:MyController", road=road,
              scales={"ey_mm": 5, "steer_deg": 10, "acc_mps2": 8, "wind_mps": 60})
    title = 30 + hud._wide("double-lane-change", 22, 700)
    assert title < hud.clock - hud._wide("999.9 s", 22, 600)
