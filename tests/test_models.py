"""The scenes in models/: each runs at its timestep, and some match known results."""

import warnings

import make_scenes
import mujoco
import numpy as np
import pytest

from independent import GRAVITY, MODELS, REPOSITORY
from sim import Hull, Linear, Scene, Sea, simulate

L, B, T = make_scenes.LENGTH, make_scenes.BEAM, make_scenes.DRAFT
WATER = 1025.0
VOLUME = L * B * T * 4.0 / 9.0


@pytest.mark.parametrize("path", sorted(MODELS.glob("*.xml")), ids=lambda path: path.stem)
def test_each_scene_starts_at_its_keyframe_and_runs_at_its_timestep(path):
    scene = Scene.load(path)
    assert scene.model.key("start").id == 0
    np.testing.assert_array_equal(scene.data.qpos, scene.model.key_qpos[0])
    *_, last = simulate(scene, 0.2, rate=5.0)
    assert last.time == pytest.approx(0.2, abs=scene.model.opt.timestep)
    highest = scene.buoyancy.sea.amplitude + 3.0
    assert (np.abs(last.centres[:, 2]) < highest).all()
    assert np.abs(scene.data.qvel).max() < 20.0


def test_only_the_topheavy_scene_starts_with_a_note():
    noted = {}
    for path in MODELS.glob("*.xml"):
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always")
            Scene.load(path)
        noted[path.stem] = [str(note.message) for note in notes]
    assert [name for name, notes in noted.items() if notes] == ["topheavy"]
    assert "will turn over" in noted["topheavy"][0]


@pytest.mark.parametrize("name", ["cube", "bunny", "dragon"])
def test_ballast_keeps_the_heroes_upright(name):
    scene = Scene.load(MODELS / f"{name}.xml")
    up = [scene.data.body(name).xmat[8] for _ in simulate(scene, 10.0, rate=10.0)]
    assert np.degrees(np.arccos(np.clip(up, -1.0, 1.0))).mean() < 20.0


def test_generated_files_match_the_script():
    assert (MODELS / "meshes" / "wigley.obj").read_text() == make_scenes.wigley_obj()
    assert (MODELS / "spheres.xml").read_text() == make_scenes.spheres_xml()


STATIONS = (20, 40, 80)


def orders(errors: list[float]) -> np.ndarray:
    """Orders of convergence from one number of stations to the next, which is twice as large."""
    return np.log2(np.abs(errors[:-1]) / np.abs(errors[1:]))


def wrench(stations: int, height: float = 0.0, roll: float = 0.0, pitch: float = 0.0):
    """Wrench (6,) of the Wigley hull about its position, in flat water."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    method = Linear(Hull(*make_scenes.wigley(stations)), Sea())
    return method.wrench([0.0, 0.0, height], about_y @ about_x, 0.0)


def displaced(stations: int, height: float = 0.0) -> float:
    return wrench(stations, height)[2] / (WATER * GRAVITY)


def waterplane_area(stations: int) -> float:
    return -(displaced(stations, 1e-4) - displaced(stations, -1e-4)) / 2e-4


def righting(stations: int, axis: int) -> float:
    """Torque [N m] per radian of roll (axis 0) or pitch (1), about the origin."""
    angle = 1e-4
    rotation = dict(roll=angle) if axis == 0 else dict(pitch=angle)
    return wrench(stations, **rotation)[3 + axis] / angle


KEEL_TO_BUOYANCY = 5.0 / 8.0 * T
WIGLEY = {
    "displacement": (displaced, VOLUME),
    "waterplane area": (waterplane_area, 2.0 / 3.0 * L * B),
    # About the origin, in the waterline: rho g V (BM + KB - T).
    "transverse stability": (
        lambda n: righting(n, 0) / (-WATER * GRAVITY * VOLUME),
        3.0 * B**2 / (35.0 * T) + KEEL_TO_BUOYANCY - T,
    ),
    "longitudinal stability": (
        lambda n: righting(n, 1) / (-WATER * GRAVITY * VOLUME),
        3.0 * L**2 / (40.0 * T) + KEEL_TO_BUOYANCY - T,
    ),
}


@pytest.mark.parametrize("quantity", WIGLEY)
def test_hydrostatics_of_the_wigley_hull_converge_to_the_closed_form(quantity):
    """Facets of parabolas leave an error of second order in the stations."""
    measure, exact = WIGLEY[quantity]
    errors = [measure(stations) - exact for stations in STATIONS]
    assert abs(errors[1]) < 0.02 * max(abs(exact), T)
    assert (orders(errors) > 1.8).all(), errors


@pytest.mark.parametrize("stations", [2, 4, 18, 40])
def test_wigley_hull_is_closed_and_symmetric_at_any_density(stations):
    vertices, faces = make_scenes.wigley(stations)
    hull = Hull(vertices, faces)  # refuses open surfaces
    assert len(hull.faces) == len(faces)
    np.testing.assert_allclose(hull.bounds[1], [L / 2, B / 2, make_scenes.FREEBOARD])
    np.testing.assert_allclose(hull.bounds[0], [-L / 2, -B / 2, -T])
    np.testing.assert_allclose(hull.centroid[:2], 0.0, atol=1e-12)


def test_wigley_floats_at_its_design_draft():
    scene = Scene.load(MODELS / "wigley.xml")
    body = scene.buoyancy.bodies[0]
    assert scene.model.body_mass[body] == pytest.approx(WATER * VOLUME, rel=1e-5)
    height_of_metacentre = 3.0 * B**2 / (35.0 * T) + KEEL_TO_BUOYANCY - (T - 0.2)
    assert height_of_metacentre == pytest.approx(0.10, abs=0.005)
    flat = Scene.from_model(without_waves(MODELS / "wigley.xml"))
    *_, last = simulate(flat, 5.0)
    facets = 0.01  # m; the mesh displaces 0.6 % less than the hull
    assert last.positions[0, 2] == pytest.approx(0.0, abs=facets)
    assert last.tilts[0] < np.radians(0.1)


def without_waves(path) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_file(str(path))
    for numeric in list(spec.numerics):
        if numeric.name.startswith(("wave_", "sea_")):
            spec.delete(numeric)
    return spec.compile()


def test_the_top_heavy_box_capsizes_and_stays_capsized():
    samples = list(simulate(Scene.load(MODELS / "topheavy.xml"), 6.0))
    assert samples[0].tilts[0] == 0.0
    assert all(s.tilts[0] > np.radians(80.0) for s in samples if s.time > 3.0)


def test_the_spar_floats_upright_at_its_draft_and_heaves_slowly():
    flat = Scene.from_model(without_waves(MODELS / "spar.xml"))
    flat.data.qpos[2] += 0.1
    samples = list(simulate(flat, 8.0, rate=100.0))
    heights = np.array([s.positions[0, 2] for s in samples]) + 1.0  # the draught is 3 m of 4 m
    downwards = np.flatnonzero((heights[:-1] > 0.0) & (heights[1:] <= 0.0))
    light_damping = 0.005
    period = np.diff(downwards).mean() / 100.0
    assert period == pytest.approx(2.0 * np.pi * np.sqrt(3.0 / GRAVITY), rel=light_damping)
    rough = list(simulate(Scene.load(MODELS / "spar.xml"), 10.0))
    assert max(s.tilts[0] for s in rough) < np.radians(30.0)
    relative_heights = [s.centres[0, 2] - s.elevations[0] for s in rough]
    assert np.std(relative_heights) > 0.05  # it does not follow the waves


def test_the_articulated_floats_hinge_works_and_holds():
    scene = Scene.load(MODELS / "articulated.xml")
    angles, gaps = [], []
    fore, aft = (scene.model.body(name).id for name in ("fore", "aft"))
    for _ in simulate(scene, 8.0):
        angles.append(scene.data.joint("hinge").qpos[0])
        end = scene.data.xpos[fore] - 1.1 * scene.data.xmat[fore].reshape(3, 3)[:, 0]
        gaps.append(np.linalg.norm(end - scene.data.xpos[aft]))
    assert max(angles) > np.radians(10.0)
    assert min(angles) < np.radians(-10.0)
    assert max(gaps) < 1e-12


def test_the_hundred_spheres_have_1280_faces_and_use_the_cg_solver():
    scene = Scene.load(MODELS / "spheres.xml")
    assert [len(f.method.hull.faces) for f in scene.buoyancy.floats] == [1280] * 100
    assert scene.model.opt.solver == mujoco.mjtSolver.mjSOL_CG
    assert scene.model.geom_contype.all()


def test_the_elements_of_the_readme_float_a_boat(tmp_path):
    """The elements, unchanged, with a box as the boat. It must neither drift far nor jump."""
    readme = (REPOSITORY / "README.md").read_text()
    custom = next(text for text in blocks(readme, "xml") if "<custom>" in text)
    body = (
        '<body name="boat"><freejoint/><geom type="box" size="0.5 0.3 0.2" density="500"/></body>'
    )
    (tmp_path / "my.xml").write_text(f"<mujoco>{custom}<worldbody>{body}</worldbody></mujoco>")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "my.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1000)
    assert data.time == pytest.approx(2.0)
    assert np.abs(data.qpos[:2]).max() < 0.5
    assert abs(data.qpos[2]) < 0.15
    assert np.linalg.norm(data.qvel[:3]) < 0.6


def blocks(text: str, language: str) -> list[str]:
    """The blocks of code of a Markdown text."""
    return [rest.split("```")[0] for rest in text.split(f"```{language}\n")[1:]]
