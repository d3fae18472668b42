import re

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from lpvmpc.errors import ModelError
from lpvmpc.plant import callbacks
from lpvmpc.plant.mjcf import WHEELS, check_model, compile_model, model_path


@pytest.fixture(scope="module")
def model():
    return compile_model()


@pytest.fixture
def text():
    return model_path("vehicle").read_text()


def compile_text(tmp_path, text):
    path = tmp_path / "car.xml"
    path.write_text(text)
    return compile_model(path)


def test_the_model_has_17_coordinates_and_16_velocities(model):
    assert (model.nq, model.nv, model.nu, model.na) == (17, 16, 5, 10)


def test_everything_is_named(model):
    kinds = {
        mujoco.mjtObj.mjOBJ_BODY: model.nbody,
        mujoco.mjtObj.mjOBJ_JOINT: model.njnt,
        mujoco.mjtObj.mjOBJ_GEOM: model.ngeom,
        mujoco.mjtObj.mjOBJ_SITE: model.nsite,
        mujoco.mjtObj.mjOBJ_CAMERA: model.ncam,
        mujoco.mjtObj.mjOBJ_TENDON: model.ntendon,
        mujoco.mjtObj.mjOBJ_ACTUATOR: model.nactuator,
        mujoco.mjtObj.mjOBJ_SENSOR: model.nsensor,
        mujoco.mjtObj.mjOBJ_KEY: model.nkey,
    }
    for kind, count in kinds.items():
        assert all(mujoco.mj_id2name(model, kind, i) for i in range(count)), kind


def test_the_settled_pose_carries_the_mass_properties_of_the_whole_car(model):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("rest").id)
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    # 1e-6 of the largest moment, the digits typed in the file; products of inertia are zero
    assert M[:3, :3] == pytest.approx(1575.0 * np.eye(3), abs=1e-5)
    assert M[3:6, 3:6] == pytest.approx(np.diag([560.0, 2700.0, 2875.0]), abs=1e-5)
    assert M[:3, 3:6] == pytest.approx(np.zeros((3, 3)), abs=1e-5)
    assert data.subtree_com[model.body("chassis").id] == pytest.approx([0, 0, 0.53], abs=1e-6)


def test_contact_sites_lie_on_the_road_below_the_wheels(model):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for wheel in WHEELS:
        site, centre = data.site(f"contact_{wheel}").xpos, data.body(f"wheel_{wheel}").xpos
        assert site[:2] == pytest.approx(centre[:2], abs=1e-9)
        assert site[2] == pytest.approx(0.0, abs=1e-9)


def test_what_is_drawn_has_no_mass_and_no_contact(model):
    assert model.body_mass.sum() == pytest.approx(1575.0)
    touching = [model.geom(i).name for i in range(model.ngeom) if model.geom_contype[i]]
    assert sorted(touching) == ["ground", "lower_body", "upper_body"]


def test_the_drawing_does_not_change_the_motion():
    ends = []
    for visual in (False, True):
        callbacks.install()
        model = compile_model(visual=visual)
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key("straight_15").id)
        data.ctrl[:2] = 0.05, 0.5
        mujoco.mj_step(model, data, nstep=500)
        ends.append(data.qpos.copy())
    assert (ends[0] == ends[1]).all()


def test_one_second_of_random_control_gives_no_warning(model):
    callbacks.install()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("straight_15").id)
    rng = np.random.default_rng(0)
    for _ in range(30):
        data.ctrl[:4] = rng.normal(size=4) * [0.2, 4.0, 20.0, 20.0]
        mujoco.mj_step(model, data, nstep=33)
    assert data.warning.number.sum() == 0
    assert np.isfinite(data.qpos).all()


def test_sensors_show_the_wheel_speeds(model):
    callbacks.install()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("straight_15").id)
    mujoco.mj_forward(model, data)
    for wheel in WHEELS:
        assert data.sensor(f"wheel_speed_{wheel}").data[0] == pytest.approx(15 / 0.303, rel=1e-6)
    # at rest on its tires the sensor feels gravity upward, as a real one does
    mujoco.mj_resetDataKeyframe(model, data, model.key("rest").id)
    mujoco.mj_forward(model, data)
    assert data.sensor("imu_acceleration").data == pytest.approx([0, 0, 9.81], abs=1e-6)


@pytest.mark.parametrize(
    "lamp, outwards",
    [("taillight_left", (-4, 5, 0)), ("taillight_right", (-4, -5, 0)),
     ("headlight_left", (4, 4, 1)), ("headlight_right", (4, -4, 1))],
)
def test_the_body_does_not_come_through_the_lamps(text, lamp, outwards):
    def hull(name):
        vertices = re.search(rf'<mesh name="{name}" class="shape" vertex="(.*?)"', text, re.DOTALL)
        return ConvexHull(np.array(vertices.group(1).split(), dtype=float).reshape(-1, 3))

    def reach(hull, points):
        """How far outwards of the points a convex body ends [mm]."""
        slope = hull.equations[:, :3] @ outwards
        ahead = slope > 1e-9
        height = points @ hull.equations[ahead, :3].T + hull.equations[ahead, 3]
        return (-height / slope[ahead]).min(axis=1)

    outwards = np.array(outwards) / np.linalg.norm(outwards)
    rng, tub, shape = np.random.default_rng(0), hull("tub"), hull(lamp)
    corners = shape.points[shape.vertices]
    inside = rng.dirichlet(np.full(len(corners), 0.1), 2000) @ corners
    # made 12 mm; MuJoCo's depth buffer tells a millimetre from 10 m
    assert (reach(shape, inside) - reach(tub, inside)).min() > 8.0


def test_the_header_warns_that_the_tires_need_the_callbacks(text):
    assert "WITHOUT THE CALLBACKS" in text[:1000]


def test_a_foreign_model_is_refused_by_name_of_what_differs(tmp_path):
    with pytest.raises(ModelError, match="not a car of this package: its joints must be chassis"):
        compile_text(tmp_path, "<mujoco/>")


@pytest.mark.parametrize(
    "old, new, message",
    [
        ('"susp_fl"', '"strut_fl"', "joints"),
        ('name="aero"', 'name="air"', "custom numerics"),
        ('data="0.303"', 'data="0.303 1"', "custom numerics"),
        ('nuserdata="56"', 'nuserdata="8"', "nuserdata"),
        ('name="wind_x"', 'name="gust"', "actuators"),
        ('name="lpvmpc_vehicle" data="1"', 'name="lpvmpc_vehicle" data="7"', "layout version 7"),
    ],
)
def test_a_changed_layout_is_refused(tmp_path, text, old, new, message):
    assert old in text
    with pytest.raises(ModelError, match=message):
        compile_text(tmp_path, text.replace(old, new))


def test_a_broken_file_is_one_sentence(tmp_path, text):
    for broken in (text[:-200], text.replace('type="slide"', 'type="slip"'), "not xml"):
        with pytest.raises(ModelError, match="no valid MJCF file") as error:
            compile_text(tmp_path, broken)
        assert "\n" not in str(error.value)


def test_other_masses_and_tires_are_allowed(tmp_path, text):
    model = compile_text(tmp_path, text.replace('mass="1449.0"', 'mass="1549.0"'))
    check_model(model)
    assert model.body_subtreemass[model.body("chassis").id] == pytest.approx(1675.0)
