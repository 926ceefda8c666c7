"""What a recording shows: the whole model, in the frame, with its episodes apart."""

import mujoco
import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from scenes import WATER, WAVES, afloat, model
from test_recording import FLOAT32, drawn, read

from independent import MODELS
from sim import Recorder, Scene, observe, read_series, simulate
from sim.recording.episodes import EPISODE_GAP
from sim.recording.framing import EYE_DIRECTION, VIEW_ANGLE, VIEW_ASPECT

ROBOT = f"""
<mujoco>
  {WATER}
  <option timestep="0.005"/>
  <custom>
    <numeric name="water_density" data="1025"/>{WAVES}
    <tuple name="buoyant"><element objtype="geom" objname="torso" prm="0"/></tuple>
  </custom>
  <asset>
    <texture name="checker" type="2d" builtin="checker" width="8" height="8" rgb1="1 0 0"/>
    <texture name="cube" type="cube" builtin="flat" width="8" height="8"
      rgb1="0 .5 1" rgb2="0 .5 1"/>
    <material name="tiles" texture="checker" texrepeat="2 3"/>
    <material name="paint" texture="cube"/>
    <material name="steel" rgba="0.2 0.4 0.6 1"/>
    <mesh name="wedge" vertex="0 0 0  1 0 0  0 1 0  0 0 1" texcoord="0 0  1 0  0 1  1 1"/>
    <hfield name="bed" nrow="3" ncol="4" size="2 1 0.5 0.1" elevation="0 0 0 0 0 1 1 0 0 0 0 0"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" pos="0 0 -0.9" material="tiles"/>
    <geom name="bed" type="hfield" hfield="bed" pos="0 9 -1"/>
    <site name="post" pos="1 0 1"/>
    <body name="pier" pos="3 0 0"><geom name="pier" type="cylinder" size="0.2 1" group="2"/></body>
    <body name="robot">
      <freejoint/>
      <geom name="torso" type="box" size="0.3 0.2 0.1" density="300" material="steel"/>
      <geom name="wedge" type="mesh" mesh="wedge" pos="0 0 0.5" material="tiles" mass="0.1"/>
      <geom name="hidden" type="box" size="0.1 0.1 0.1" group="3" mass="0.1"/>
      <geom name="clear" size="0.1" rgba="1 1 1 0" mass="0.1"/>
      <site name="hook" pos="0.3 0 0.1" rgba="1 0 0 1"/>
      <body name="leg" pos="0.2 0 -0.1">
        <joint axis="0 1 0"/>
        <geom type="capsule" size="0.05 0.2" pos="0 0 -0.2" material="paint" density="2000"/>
      </body>
    </body>
    <body name="stone" pos="-2 0 -0.7"><freejoint/><geom name="stone" size="0.2"/></body>
  </worldbody>
  <tendon><spatial name="line"><site site="post"/><site site="hook"/></spatial></tendon>
</mujoco>"""


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """Half a second of a robot: states at the samples and the path of the recording."""
    path = tmp_path_factory.mktemp("picture") / "robot.rrd"
    scene, states = Scene.from_model(mujoco.MjModel.from_xml_string(ROBOT)), []
    with Recorder(path, scene) as recorder:
        for sample in simulate(scene, 0.5):
            recorder.log(sample)
            data = scene.data
            states.append((data.xpos.copy(), data.site_xpos.copy(), data.ncon))
    return scene.model, states, path


def test_every_visible_geom_and_site_is_drawn(robot):
    _, _, path = robot
    entities = {chunk.entity_path for chunk in RrdReader(path).stream()}
    bodies = "/world/bodies/"
    below = {e.removeprefix(bodies) for e in entities if e.startswith(bodies) and e.count("/") > 3}
    assert {e for e in below if "sites" not in e} == {
        "world/floor", "world/bed", "pier/pier", "robot/torso", "robot/wedge", r"leg/leg\/geom\ 0",
        "stone/stone",
    }  # fmt: skip
    assert {e for e in below if "sites" in e} == {"world/sites/post", "robot/sites/hook"}


def test_all_bodies_move_and_tendons_run_between_their_sites(robot):
    model, states, path = robot
    for body in ("robot", "leg", "stone"):
        _, places = read(path, f"world/bodies/{body}", "Transform3D:translation")
        expected = [positions[model.body(body).id] for positions, *_ in states]
        np.testing.assert_allclose(np.squeeze(places), expected, atol=FLOAT32)
    _, (place,) = read(path, "world/bodies/pier", "Transform3D:translation")
    np.testing.assert_allclose(np.ravel(place), [3.0, 0.0, 0.0])
    _, lines = read(path, "world/tendons/line", "LineStrips3D:strips")
    np.testing.assert_allclose(np.squeeze(lines), [sites for _, sites, _ in states], atol=1e-5)


def test_contacts_are_arrows_that_carry_the_stone(robot):
    """The stone of 2000 kg/m^3 rests on the floor; the force on it points up."""
    _, states, path = robot
    _, vectors = read(path, "world/contacts", "Arrows3D:vectors")
    _, origins = read(path, "world/contacts", "Arrows3D:origins")
    assert [len(v) for v in vectors] == [count for *_, count in states]
    assert (vectors[-1][:, 2] > 0.0).all()
    np.testing.assert_allclose(origins[-1][:, 2], -0.9, atol=0.01)


def test_colours_and_textures_are_those_of_the_materials(robot):
    _, _, path = robot

    def albedo(entity: str) -> int:
        return read(path, f"world/bodies/{entity}", "Mesh3D:albedo_factor")[1][0].item()

    assert albedo(r"leg/leg\/geom\ 0") == 0x007FFFFF
    assert albedo("robot/sites/hook") == 0xFF0000FF
    assert albedo("pier/pier") == 0x808080FF
    _, (dry, *_) = read(path, "world/bodies/robot/torso", "Mesh3D:vertex_colors")
    assert 0x336699FF in dry
    for entity, most in (("world/floor", [2.0, 3.0]), ("robot/wedge", [1.0, 1.0])):
        _, (texcoords,) = read(path, f"world/bodies/{entity}", "Mesh3D:vertex_texcoords")
        np.testing.assert_allclose(texcoords.max(axis=0), most)
        _, (texels,) = read(path, f"world/bodies/{entity}", "Mesh3D:albedo_texture_buffer")
        assert np.size(texels) == 8 * 8 * 3


def test_surfaces_face_outward_and_up(robot):
    _, _, path = robot
    for entity in ("world/floor", "world/bed", "pier/pier", "robot/wedge", "stone/stone"):
        _, (points,) = read(path, f"world/bodies/{entity}", "Mesh3D:vertex_positions")
        _, (normals,) = read(path, f"world/bodies/{entity}", "Mesh3D:vertex_normals")
        _, (faces,) = read(path, f"world/bodies/{entity}", "Mesh3D:triangle_indices")
        a, b, c = np.moveaxis(points[faces].astype(float), 1, 0)
        along = np.einsum("fi,fci->fc", np.cross(b - a, c - a), normals[faces])
        assert (along > 0.0).all()
    assert points[:, 2].max() == pytest.approx(0.2, rel=0.01)
    _, (bed,) = read(path, "world/bodies/world/bed", "Mesh3D:vertex_positions")
    assert np.ptp(bed, axis=0) == pytest.approx([4.0, 2.0, 0.5])


def test_hulls_that_are_hidden_are_drawn_only_if_nothing_else_shows_their_body():
    def scene(visual: str) -> Scene:
        hull = '<geom name="hull" type="box" size="0.3 0.3 0.3" density="500" group="3"/>'
        return afloat(f'<body name="b"><freejoint/>{hull}{visual}</body>', ("hull",))

    (mesh,) = drawn(scene("")).meshes
    assert mesh.is_drawn
    (mesh,) = drawn(scene('<geom name="skin" size="0.2" group="2" mass="1"/>')).meshes
    assert not mesh.is_drawn


@pytest.mark.parametrize("name", ["cube", "wigley", "spheres", "articulated"])
def test_the_bodies_fill_about_a_third_of_the_view_and_stay_in_it(name):
    scene = Scene.load(MODELS / f"{name}.xml")
    artist = drawn(scene)
    right = np.cross([0.0, 0.0, 1.0], EYE_DIRECTION) / np.hypot(*EYE_DIRECTION[:2])
    up, half = np.cross(EYE_DIRECTION, right), np.tan(0.5 * VIEW_ANGLE)
    for i, sample in enumerate(simulate(scene, 1.0, rate=2.0)):
        frame = artist.frame(sample, sample.time)
        points, _ = artist.meshes.placed(sample)
        from_eye = points - frame.focus - artist.framing.distance * EYE_DIRECTION
        depth = -from_eye @ EYE_DIRECTION * half
        across, along = from_eye @ right / depth / VIEW_ASPECT, from_eye @ up / depth
        assert (depth > 0.0).all()
        assert max(np.abs(across).max(), np.abs(along).max()) < 0.9
        if i == 0:
            share = 0.5 * max(np.ptp(across), np.ptp(along))
            assert 0.25 < share < 0.5


def test_the_camera_follows_a_body_that_sinks():
    stone = (
        '<body name="s" pos="0 0 -9"><freejoint/><geom name="s" size="0.1" density="3000"/></body>'
    )
    scene = afloat(stone, ("s",))
    framing = drawn(scene).framing
    sunk = framing.focus(scene.data.xipos[scene.buoyancy.bodies], 0.0)
    assert sunk == pytest.approx([0.0, 0.0, -9.0], abs=0.2 * framing.distance)
    assert framing.focus(np.zeros((1, 3)), 0.0) == [0.0, 0.0, 0.0]


def test_buoyancy_starts_at_the_centre_of_the_submerged_volume():
    scene = afloat()  # a cube of 1 m, half under
    artist = drawn(scene)
    sample = observe(scene)
    centre = artist.frame(sample, 0.0).upward
    lumped = 0.02  # m, from the area vectors of vertices on the waterline
    np.testing.assert_allclose(centre, [[0.0, 0.0, -0.25]], atol=lumped)


def test_episodes_are_apart(tmp_path):
    """After a reset the recording goes on after a gap, also at a lower rate, and says where."""
    path, scene = tmp_path / "episodes.rrd", afloat()
    with Recorder(path, scene, rate=10.0, water_resolution=4) as recorder:
        for _ in range(2):
            mujoco.mj_resetData(scene.model, scene.data)
            for sample in simulate(scene, 0.5, rate=20.0):
                recorder.log(sample)
    times, _ = read_series(path)["height/cube"]
    episode = np.linspace(0.0, 0.5, 6)
    expected = np.concatenate([episode, 0.5 + EPISODE_GAP + episode])
    np.testing.assert_allclose(times, expected, atol=1e-6)
    assert "episodes start at 0.00, 1.00 s" in str(
        read(path, "overview", "TextDocument:text")[1][-1]
    )
    cleared, _ = read(path, "plots", "Clear:is_recursive")
    assert cleared == pytest.approx([0.5 + 0.5 * EPISODE_GAP])


def test_a_sample_of_another_time_than_the_state_is_refused(tmp_path):
    scene = afloat()
    with Recorder(tmp_path / "a.rrd", scene, water_resolution=2) as recorder:
        samples = list(simulate(scene, 0.2))
        with pytest.raises(ValueError, match="log each sample before the next step"):
            recorder.log(samples[0])


def test_users_add_their_own_data_to_the_stream(tmp_path):
    path, scene = tmp_path / "a.rrd", afloat()
    with Recorder(path, scene, water_resolution=2) as recorder:
        recorder.stream.log("world/mark", rr.Points3D([[1.0, 2.0, 3.0]]), static=True)
    _, (mark,) = read(path, "world/mark", "Points3D:positions")
    np.testing.assert_allclose(mark, [[1.0, 2.0, 3.0]])


def test_numbers_are_finite_for_bodies_that_are_dry_and_sunk(tmp_path):
    bodies = "".join(
        f'<body name="b{i}" pos="{2 * i} 0 {z}"><freejoint/>'
        f'<geom name="b{i}" size="0.2" density="{density}"/></body>'
        for i, (z, density) in enumerate([(5.0, 10.0), (-5.0, 3000.0), (0.2, 500.0)])
    )
    scene = Scene.from_model(model(bodies, ("b0", "b1", "b2"), WAVES))
    artist = drawn(scene)
    for sample in simulate(scene, 0.2, rate=10.0):
        frame = artist.frame(sample, sample.time)
        for array in (frame.water.points, frame.upward, frame.focus, *frame.curves):
            assert np.isfinite(array).all()


def test_a_notebook_shows_a_complete_recording(tmp_path, monkeypatch):
    """The viewer of a cell gets the blueprint and all data of the file."""
    shown, path = [], tmp_path / "a.rrd"

    class Viewer:
        def __init__(self, recording, blueprint, **size):
            recording.set_sinks(rr.FileSink(tmp_path / "cell.rrd"), default_blueprint=blueprint)
            shown.append(recording)

        def display(self) -> None:
            pass

    monkeypatch.setattr("rerun.notebook.Viewer", Viewer)
    scene = afloat()
    with Recorder(path, scene, water_resolution=2) as recorder:
        for sample in simulate(scene, 0.2):
            recorder.log(sample)
        with pytest.raises(ValueError, match="not complete: show it after its 'with' block"):
            recorder._ipython_display_()
    recorder._ipython_display_()
    shown.pop().disconnect()
    times, heights = read_series(path)["height/cube"]
    np.testing.assert_array_equal(
        read_series(tmp_path / "cell.rrd")["height/cube"], [times, heights]
    )
