import mujoco
import numpy as np
from fake_log import fake_path

from lpvmpc.picture.video import scenery
from lpvmpc.plant.mjcf import model_path
from lpvmpc.road.path import Path


def test_the_scene_keeps_the_vehicles_coordinates():
    scene = scenery.build(fake_path(100.0), width=64, height=36)
    car = mujoco.MjModel.from_xml_path(str(model_path("vehicle.xml")))
    assert scene.model.nq == car.nq
    names = [scene.model.joint(j).name for j in range(scene.model.njnt)]
    assert names == [car.joint(j).name for j in range(car.njnt)]


def test_only_near_tiles_are_drawn():
    scene = scenery.build(fake_path(600.0), width=64, height=36)
    scene.place(mujoco.MjData(scene.model), 0.0, 0.0, 0.0, 100.0)
    shown = scene.model.geom_group[scene.tiles] != scenery.HIDDEN
    distance = np.hypot(*scene.centres.T)
    assert shown[distance < 100.0].all() and not shown[distance > 200.0].any()


def test_second_laps_do_not_lay_the_road_twice():
    s = np.arange(0.0, 400.0)  # twice around a circle of 200 m
    x, y = 200 / (2 * np.pi) * np.array((np.cos(s * 2 * np.pi / 200), np.sin(s * 2 * np.pi / 200)))
    fresh = scenery._not_repeated(x, y, s * 2 * np.pi / 200 + np.pi / 2, s)
    assert fresh[:199].all() and not fresh[201:].any()


def test_a_crossing_road_is_laid_twice():
    s = np.arange(0.0, 200.0)
    x = np.where(s < 100, s - 50, 0.0)
    y = np.where(s < 100, 0.0, s - 150)
    psi = np.where(s < 100, 0.0, np.pi / 2)
    assert scenery._not_repeated(x, y, psi, s).all()


def test_trees_stand_clear_of_a_winding_road():
    path = fake_path(400.0, closed=True)
    spec = mujoco.MjSpec()
    spec.add_material(name="plants")
    scenery._roadside(spec, path, np.random.default_rng(0))
    road = np.stack(path.at(np.arange(0.0, 400.0, 0.5))[:2], axis=1)
    for mesh in spec.meshes:
        points = np.reshape(mesh.uservert, (-1, 3))
        low = points[points[:, 2] < 0.5]  # trunks and posts
        gap = np.sqrt(((low[:, None, :2] - road[None]) ** 2).sum(-1)).min(axis=1)
        assert gap.min() > path.width_left.max() + 0.4  # posts stand 1.1 m beyond the edge


def test_a_skidpad_of_many_laps_builds():
    path = Path(np.full(2001, 1 / 30.0), 400.0)  # two laps of a circle of 30 m
    scene = scenery.build(path, width=64, height=36)
    assert sum("road_" in scene.model.geom(g).name for g in scene.tiles) <= 8


def test_cones_stand_where_they_are_told():
    places = np.array([(20.0, 1.5), (40.0, -1.5)])
    model = scenery.build(fake_path(100.0), width=64, height=36, cones=places).model
    mesh = model.mesh("cones")
    first = int(mesh.vertadr[0])
    vertices = model.mesh_vert[first : first + int(mesh.vertnum[0])]
    # MuJoCo moves a mesh to its middle and turns it; the distance between the cones remains
    assert np.ptp(vertices, axis=0).max() > np.hypot(20.0, 3.0) - 0.5
    bare = scenery.build(fake_path(100.0), width=64, height=36).model
    assert model.ngeom == bare.ngeom + 1
