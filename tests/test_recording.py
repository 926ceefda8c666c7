"""Recordings match the samples that they were made from."""

import gc
import socket
from collections.abc import Callable
from time import monotonic, sleep

import numpy as np
import pytest
import rerun as rr
import trimesh
from rerun.chunk import RrdReader
from scenes import CUBE, WAVES, afloat, model

from independent import MODELS, ROUND_OFF
from sim import Recorder, Scene, Sea, Tally, Wave, hydrostatics, read_series, simulate
from sim.geometry import rotation_matrix
from sim.methods import METHODS, Method
from sim.recording.colours import HUE_STEP, with_hue_shifted
from sim.recording.display_mesh import DisplayMeshes, shaded_corners
from sim.recording.frame import WATER_RESOLUTION, Artist, thinned
from sim.recording.look import side_by_side_blueprint
from sim.recording.output import Output
from sim.recording.recorder import SceneWriter
from sim.recording.sea_surface import SeaSurface
from sim.recording.waterline_curves import heads, waterlines
from sim.runs.motions import motion
from sim.runs.series import Series
from viewer_process import end_viewer, start_viewer

FLOAT32 = 1e-6
"""Relative error of positions, which Rerun keeps in single precision."""


def arrays(strips: list) -> list[np.ndarray]:
    """Strips of different lengths as arrays (N, 3)."""
    return [np.array(strip) for strip in strips]


def read(path, entity: str, component: str, convert=np.array) -> tuple[np.ndarray, list]:
    """Times [s] and converted values of a component, in order of time. Static data has time NaN."""
    rows = []
    for chunk in RrdReader(path).stream().filter(content=f"/{entity}"):
        batch = chunk.to_record_batch()
        if component not in batch.schema.names:
            continue
        times = [np.nan] * batch.num_rows
        if "time" in batch.schema.names:
            times = batch.column("time").cast("int64").to_numpy() * 1e-9
        for time, value in zip(times, batch.column(component).to_pylist(), strict=True):
            rows.append((time, convert(value)))
    rows.sort(key=lambda row: row[0])
    return np.array([time for time, _ in rows]), [value for _, value in rows]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Two seconds of the trio: scene, samples and path of the recording."""
    path = tmp_path_factory.mktemp("recording") / "deep" / "trio.rrd"
    scene = Scene.load(MODELS / "trio.xml")
    samples = []
    with Recorder(path, scene) as recorder:
        for sample in simulate(scene, 2.0, rate=30.0):
            recorder.log(sample)
            samples.append(sample)
    return scene, samples, path


def test_time_series_match_the_samples(run):
    scene, samples, path = run
    weights = scene.model.body_mass[scene.buoyancy.bodies] * 9.81
    rest_heights = Scene.load(MODELS / "trio.xml").rest_heights
    motions = [motion(s, scene.buoyancy.sea, rest_heights) for s in samples]
    expected = {
        "plots/height/{}": [s.centres[:, 2] for s in samples],
        "plots/height/{}/water": [s.elevations for s in samples],
        "plots/tilt/{}": [np.degrees(s.tilts) for s in samples],
        "plots/submerged/{}": [s.submerged_fractions for s in samples],
        "plots/force/{}": [s.body_wrenches[:, 2] / weights for s in samples],
        "plots/surge/{}": [s.positions[:, 0] - samples[0].positions[:, 0] for s in samples],
        "plots/heave/{}": [m.heave for m in motions],
        "plots/heave/{}/water": [s.elevations for s in samples],
        "plots/heel/{}": [m.heel_deg for m in motions],
        "plots/trim/{}": [m.trim_deg for m in motions],
    }
    for i, body in enumerate(scene.buoyancy.body_names):
        for entity, values in expected.items():
            times, scalars = read(path, entity.format(body), "Scalars:scalars")
            np.testing.assert_allclose(times, [s.time for s in samples], atol=1e-9)
            np.testing.assert_array_equal(np.ravel(scalars), np.array(values)[:, i])


def test_bodies_have_the_poses_of_the_samples(run):
    scene, samples, path = run
    for i, body in enumerate(scene.buoyancy.body_names):
        entity = f"world/bodies/{body}"
        _, translations = read(path, entity, "Transform3D:translation")
        _, quaternions = read(path, entity, "Transform3D:quaternion")
        positions = [s.positions[i] for s in samples]
        np.testing.assert_allclose(np.squeeze(translations), positions, atol=FLOAT32)
        rolled = [np.roll(s.quaternions[i], -1) for s in samples]  # Rerun puts w last
        np.testing.assert_allclose(np.squeeze(quaternions), rolled, atol=FLOAT32)


def test_hulls_have_their_own_surface_and_outward_normals(run):
    """The surface is in the hull's frame, and its transform places it in its body."""
    scene, _, path = run
    for f in scene.buoyancy.floats:
        entity = f"world/bodies/{f.name}/{f.name}"
        _, (vertices,) = read(path, entity, "Mesh3D:vertex_positions")
        _, (normals,) = read(path, entity, "Mesh3D:vertex_normals")
        _, (faces,) = read(path, entity, "Mesh3D:triangle_indices")
        hull = f.method.hull
        drawn = trimesh.Trimesh(vertices, faces)  # merges the corners of sharp edges
        assert drawn.is_watertight
        single_precision = 1e-4
        assert drawn.volume == pytest.approx(hull.volume, rel=single_precision)
        np.testing.assert_allclose(drawn.bounds, hull.bounds, atol=FLOAT32)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=FLOAT32)
        flat = np.cross(*np.moveaxis(vertices[faces][:, 1:] - vertices[faces][:, :1], 1, 0))
        along = np.einsum("fi,fci->fc", flat, normals[faces])
        assert (along > 0.5 * np.linalg.norm(flat, axis=1)[:, None]).mean() > 0.99
        _, (translation,) = read(path, entity, "Transform3D:translation")
        position = scene.model.geom(f.name).pos
        np.testing.assert_allclose(np.ravel(translation), position, atol=FLOAT32)


def test_the_drawn_water_is_the_surface_around_the_bodies_and_flat_at_its_edge(run):
    scene, samples, path = run
    _, frames = read(path, "world/water", "Mesh3D:vertex_positions")
    _, horizons = read(path, "world/horizon", "Transform3D:translation")
    assert len(frames) == len(samples)
    sea, surface = scene.buoyancy.sea, drawn(Scene.load(MODELS / "trio.xml")).surface
    for points, horizon, sample in zip(frames, horizons, samples, strict=True):
        middle = sample.centres[:, :2].mean(axis=0)
        distance = np.hypot(*(points[:, :2] - middle).T)
        near = distance < surface.inner - sea.amplitude
        x, y, z = points[near].astype(float).T
        np.testing.assert_allclose(z, sea.elevation(x, y, sample.time), atol=10 * FLOAT32)
        assert np.hypot(*(sample.centres[:, :2] - middle).T).max() + 0.5 < surface.inner
        edge = points[distance > 0.999 * surface.radius]
        assert len(edge) > 60
        np.testing.assert_allclose(edge[:, 2], 0.0, atol=FLOAT32)
        np.testing.assert_allclose(np.ravel(horizon), [*middle, 0.0], atol=10 * FLOAT32)


def drawn(scene: Scene) -> Artist:
    """The artist of a recording of a scene."""
    return Artist(scene, DisplayMeshes(scene.buoyancy), None, WATER_RESOLUTION)


def test_the_sea_reaches_the_horizon_without_a_gap(run):
    """The far sea begins where the water ends, and ends where the sky meets it."""
    *_, path = run
    _, (sea,) = read(path, "world/horizon/sea", "Mesh3D:vertex_positions")
    _, (sky,) = read(path, "world/horizon/sky", "Mesh3D:vertex_positions")
    surface, far = drawn(Scene.load(MODELS / "trio.xml")).surface, np.hypot(*sea[:, :2].T)
    assert far.min() == pytest.approx(surface.radius, rel=FLOAT32)
    assert far.max() == pytest.approx(np.linalg.norm(sky, axis=1).min(), rel=1e-5)
    assert far.max() > 100.0 * surface.radius
    np.testing.assert_array_equal(sea[:, 2], 0.0)


def test_particles_that_are_pinched_are_foam_and_slopes_to_the_light_are_light():
    sea = Sea([Wave(0.31, 2.0, 0.0, 0.0)])  # steepness 0.97
    surface = SeaSurface(sea, 2.0, 8.0, 48)
    water = surface.at(np.zeros(2), 0.0)
    red, inside = water.colours >> 24, np.hypot(*water.points[:, :2].T) < 2.0
    heights = water.points[inside, 2]
    assert (red[inside][heights > 0.3] > 235).all()
    assert (red[inside][heights < 0.2] < 200).all()
    gentle = SeaSurface(Sea([Wave(0.05, 4.0, 0.0, 0.0)]), 2.0, 8.0, 48).at(np.zeros(2), 0.0)
    inside = np.hypot(*gentle.points[:, :2].T) < 1.5
    slope = Sea([Wave(0.05, 4.0, 0.0, 0.0)]).surface(*gentle.points[:, :2].T, 0.0).gradient[:, 0]
    order = np.argsort(slope[inside])
    red = (gentle.colours[inside] >> 24).astype(int)[order]
    assert (np.diff(red) <= 1).all()  # the light is on the side of +x
    assert red[0] > red[-1] + 15


def test_the_waterline_lies_on_the_sea_and_on_the_hulls(run):
    """It touches both from outside: its middle is its radius above the water and beside a side of
    the cube."""
    scene, samples, path = run
    _, frames = read(path, "world/waterline", "LineStrips3D:strips", arrays)
    _, (radius,) = read(path, "world/waterline", "LineStrips3D:radii", np.max)
    assert len(frames) == len(samples)
    b, above, beside = scene.buoyancy.body_names.index("cube"), [], []
    for strips, sample in zip(frames, samples, strict=True):
        for strip in strips:
            x, y, z = strip.astype(float).T
            np.testing.assert_array_equal(strip[0], strip[-1])
            from_cube = strip - sample.positions[b]
            if np.linalg.norm(from_cube, axis=1).max() < 1.0:  # the others are 2 m away
                in_cube = from_cube @ rotation_matrix(sample.quaternions[b])
                above.append(z - scene.buoyancy.sea.elevation(x, y, sample.time))
                beside.append(np.abs(in_cube).max(axis=1) - 0.5)
    for gaps in (np.concatenate(above), np.concatenate(beside)):
        assert len(gaps) > 40 * 30  # four sides of about 10 points in half of the frames
        # The line is beside level water and smoothed edges, while the sea slopes by up to 0.45.
        assert gaps.min() > -0.5 * radius
        assert gaps.max() < 2.0 * radius
        assert np.median(np.abs(gaps - radius)) < 0.2 * radius


def test_wet_vertices_are_darker_than_dry_ones(run):
    scene, samples, path = run
    entity = "world/bodies/cube/cube"
    _, (corners,) = read(path, entity, "Mesh3D:vertex_positions")
    _, colours = read(path, entity, "Mesh3D:vertex_colors")
    assert len(colours) == len(samples)
    sea, b = scene.buoyancy.sea, scene.buoyancy.body_names.index("cube")
    for packed, sample in zip(colours, samples, strict=True):
        rotation = rotation_matrix(sample.quaternions[b])
        x, y, z = (corners @ rotation.T + sample.positions[b]).T
        head = sea.elevation(x, y, sample.time) - z
        red = packed >> 24
        assert (red[head > 0.06] < 160).all()
        assert (red[head < -0.06] > 230).all()


def test_the_drawn_water_meets_the_hull_where_the_sea_does():
    """At the hull the drawn triangles are within 1 mm of the waterline's points, on the sea."""
    scene = Scene.load(MODELS / "cube.xml")
    artist = drawn(scene)
    for sample in simulate(scene, 2.0, rate=2.0):
        frame = artist.frame(sample, sample.time)
        points, areas = artist.meshes.placed(sample)
        depths = heads(scene.buoyancy.sea, points, sample.time)
        surfaces = artist.meshes.faces, artist.meshes.across
        curves = waterlines(scene.buoyancy.sea, sample.time, points, areas, *surfaces, depths)
        for x, y, z in (point for curve in curves for point in curve):
            a, b, c = np.moveaxis(frame.water.points[artist.surface.faces].astype(float), 1, 0)
            (u, v), (p, q) = (b - a)[:, :2].T, (c - a)[:, :2].T
            dx, dy = x - a[:, 0], y - a[:, 1]
            s = (dx * q - dy * p) / (u * q - v * p)
            t = (dy * u - dx * v) / (u * q - v * p)
            (face,) = np.flatnonzero((s >= 0.0) & (t > 0.0) & (s + t <= 1.0))[:1]
            height = a[face, 2] + s[face] * (b - a)[face, 2] + t[face] * (c - a)[face, 2]
            assert abs(height - z) < 1e-3


def test_the_camera_and_trails_follow_the_bodies(run):
    _, samples, path = run
    _, focus = read(path, "world/focus", "Transform3D:translation")
    for position, sample in zip(focus, samples, strict=True):
        x, y, z = sample.centres.mean(axis=0)
        np.testing.assert_allclose(np.ravel(position)[:2], [x, y], atol=FLOAT32)
        assert 0.0 <= position.item(2) <= max(z, 0.0)  # they fall from 0.7 m
    _, trails = read(path, "world/trail", "LineStrips3D:strips", arrays)
    for i, trail in enumerate(trails):
        for body, strip in enumerate(trail):
            centres = [s.centres[body] for s in samples[: i + 1]]
            np.testing.assert_allclose(strip, centres, atol=FLOAT32)


def test_the_overview_describes_the_scene_and_at_the_end_the_means(run):
    scene, samples, path = run
    _, texts = read(path, "overview", "TextDocument:text")
    before, after = (str(text[0]) for text in texts)
    for expected in ("trio", "2 ms", "amplitude 0.1, 0.06", "bunny: 3,674 faces", "patches"):
        assert expected in before
    assert after.startswith(before)
    tally = Tally(scene)
    for sample in samples:
        tally.add(sample)
    assert f"| dragon | {tally.bodies()['dragon']['mean_height']:.3f} |" in after


def test_frames_have_the_recording_rate_and_water_its_size(tmp_path):
    scene, path = Scene.load(MODELS / "cube.xml"), tmp_path / "cube.rrd"
    scene.data.time = 7.0
    with Recorder(path, scene, rate=10.0, water_size=4.0, water_resolution=9) as recorder:
        for sample in simulate(scene, 1.0, rate=30.0):
            recorder.log(sample)
    times, frames = read(path, "world/water", "Mesh3D:vertex_positions")
    one_step = 0.002
    np.testing.assert_allclose(times, 7.0 + np.arange(11) / 10.0, atol=one_step)
    for points in frames:
        assert 0.8 * 9**2 < len(points) < 1.4 * 9**2
        middle = points.mean(axis=0)[:2]
        assert np.hypot(*(points[:, :2] - middle).T).max() == pytest.approx(2.0, rel=0.02)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        (dict(rate=0.0), "recording rate is 0.0"),
        (dict(water_size=np.nan), "size of the water is nan"),
        (dict(water_resolution=1), "resolution is 1,"),
        (dict(path=None), "would go nowhere: give the path of an .rrd file, or view=True"),
    ],
)
def test_impossible_numbers_are_refused(numbers, message, tmp_path):
    options = {"path": tmp_path / "a.rrd"} | numbers
    with pytest.raises(ValueError, match=message):
        Recorder(scene=Scene.load(MODELS / "cube.xml"), **options)
    assert not list(tmp_path.iterdir())


def balls(count: int) -> Scene:
    """A scene with separate balls of 642 vertices, half submerged."""
    names = tuple(f"ball{i}" for i in range(count))
    bodies = "".join(
        f'<body name="{name}" pos="{2 * i} 0 0"><freejoint/>'
        f'<geom name="{name}" size="0.5" density="512.5"/></body>'
        for i, name in enumerate(names)
    )
    return Scene.from_model(model(bodies, names, option='<option solver="CG"/>'))


@pytest.mark.parametrize(("count", "is_shaded"), [(8, True), (32, False)])
def test_only_the_first_of_many_bodies_are_plotted_and_shading_stops_at_very_many(
    count, is_shaded, tmp_path
):
    scene, path = balls(count), tmp_path / "many.rrd"
    with Recorder(path, scene) as recorder:
        for sample in simulate(scene, 0.1):
            recorder.log(sample)
    _, colours = read(path, "world/bodies/ball0/ball0", "Mesh3D:vertex_colors")
    assert len(colours) == (4 if is_shaded else 0)
    _, (albedo,) = read(path, "world/bodies/ball0/ball0", "Mesh3D:albedo_factor")
    assert albedo.item() == (0xFFFFFFFF if is_shaded else 0x808080FF)  # MuJoCo's default grey
    _, waterline = read(path, "world/waterline", "LineStrips3D:strips", arrays)
    assert len(waterline[0]) == count
    _, trails = read(path, "world/trail", "LineStrips3D:strips", arrays)
    assert trails == []
    _, (text, _) = read(path, "overview", "TextDocument:text")
    assert f"and {count - 6} more" in str(text)
    (_, names), (_, rows) = (
        read(path, "others/height/water", component)
        for component in ("SeriesLines:names", "Scalars:scalars")
    )
    assert names[0].tolist() == [f"ball{i}" for i in range(6, count)]
    assert np.shape(rows) == (4, count - 6)
    _, envelope = read(path, "envelope/height", "Scalars:scalars")
    np.testing.assert_allclose(envelope, 0.0, atol=0.1)
    assert (np.diff(envelope, axis=1) <= ROUND_OFF).all()


class WholeVolume(Method):
    """A method from outside that lifts the hull by its whole volume."""

    def wrench(self, position, rotation, time):
        lift = self.sea.density * self.sea.gravity * self.hull.volume
        return np.array([0.0, 0.0, lift, 0.0, 0.0, 0.0])


class Tolerant(WholeVolume):
    tolerance = 0.25


@pytest.mark.parametrize(
    ("method", "text"),
    [
        (WholeVolume, "1 m³, wholevolume\n"),
        (Tolerant, "1 m³, tolerant to 0.25 m of water height\n"),
    ],
    ids=["without a tolerance", "with a tolerance"],
)
def test_methods_from_outside_are_recorded(method, text, tmp_path, monkeypatch):
    monkeypatch.setitem(METHODS, "own", method)
    scene = afloat(load={"settings": {"buoyancy_method": "own"}})
    path = tmp_path / "a.rrd"
    with Recorder(path, scene) as recorder:
        for sample in simulate(scene, 0.1):
            recorder.log(sample)
    assert text in read(path, "overview", "TextDocument:text")[1][-1][0]


def test_the_rest_of_a_scene_is_computed_once(tmp_path, monkeypatch):
    scene, searches = Scene.load(MODELS / "cube.xml"), []

    def search(*arguments, **options):
        searches.append(arguments)
        return hydrostatics(*arguments, **options)

    monkeypatch.setattr("sim.scenes.scene.hydrostatics", search)
    series = Series(scene)
    with Recorder(tmp_path / "a.rrd", scene, water_resolution=2) as recorder:
        for sample in simulate(scene, 0.1):
            series.add(sample)
            recorder.log(sample)
    assert len(searches) == 1
    heave = read_series(tmp_path / "a.rrd")["heave/cube"][1]
    np.testing.assert_array_equal(series.columns()["heave"], heave)


def test_many_waterlines_are_thinned_and_stay_closed():
    share = np.linspace(0.0, 1.0, 101)
    long = np.column_stack([share, share * (1.0 - share), 0.0 * share])
    long[-1] = long[0]
    short = np.concatenate([long[:14], long[:1]])
    assert thinned([short], 40)[0] is short
    first, second = thinned([long, short], 40)
    np.testing.assert_array_equal(first, np.concatenate([long[:100:3], long[:1]]))
    np.testing.assert_array_equal(second, short)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_viewing_without_a_screen_is_refused_and_leaves_no_file(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    scene = Scene.load(MODELS / "cube.xml")
    with pytest.raises(OSError, match="there is no screen for the viewer"):
        Recorder(tmp_path / "a.rrd", scene, view=True, port=free_port())
    assert not list(tmp_path.iterdir())


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_an_open_viewer_receives_the_run(tmp_path):
    """Rerun itself listens in place of the viewer and writes the data to a file."""
    port, path = free_port(), tmp_path / "arrived.rrd"
    listener = start_viewer("--bind", "127.0.0.1", "--port", str(port), "--save", str(path))
    try:
        wait_until(lambda: listens(port))
        scene, samples = Scene.load(MODELS / "cube.xml"), []
        with Recorder(None, scene, view=True, port=port, water_resolution=9) as recorder:
            for sample in simulate(scene, 0.5):
                recorder.log(sample)
                samples.append(sample)
        wait_until(lambda: path.is_file() and "mean of" in last_overview(path))
    finally:
        end_viewer(listener)
        listener.wait()
    _, heights = read(path, "plots/height/cube", "Scalars:scalars")
    np.testing.assert_array_equal(np.ravel(heights), [s.centres[0, 2] for s in samples])
    assert len(read(path, "world/water", "Mesh3D:vertex_positions")[0]) == len(samples)


def listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def last_overview(path) -> str:
    """The last text of the overview; empty if there is none yet."""
    try:
        _, texts = read(path, "overview", "TextDocument:text")
    except RuntimeError:  # the file is incomplete
        return ""
    return str(texts[-1]) if texts else ""


def wait_until(holds: Callable[[], bool]) -> None:
    deadline = monotonic() + 60.0
    while not holds():
        assert monotonic() < deadline
        sleep(0.05)


def test_sharp_edges_are_drawn_sharp_and_smooth_ones_smooth():
    box = trimesh.creation.box()
    vertex, faces, normals = shaded_corners(np.array(box.vertices), np.array(box.faces))
    np.testing.assert_allclose(np.abs(normals).max(axis=1), 1.0)
    assert len(vertex) == 36
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertex, faces, normals = shaded_corners(np.array(ball.vertices), np.array(ball.faces))
    np.testing.assert_array_equal(vertex[faces], ball.faces)
    facets = 0.02  # facets of about 8 degrees
    np.testing.assert_allclose(normals, ball.vertices[vertex], atol=facets)


def test_twins_of_grey_bodies_have_different_colours():
    grey = np.array([0.5, 0.5, 0.5, 1.0])
    assert with_hue_shifted(grey, 0.0) is grey
    red, blue = (np.array([*rgb, 0.3]) for rgb in ((1.0, 0.2, 0.2), (0.2, 0.2, 1.0)))
    np.testing.assert_allclose(with_hue_shifted(red, 2.0 / 3.0), blue, atol=ROUND_OFF)
    twins = np.array([with_hue_shifted(grey, i * HUE_STEP)[:3] for i in range(5)])
    apart = np.linalg.norm(twins[:, None] - twins, axis=2)[~np.eye(5, dtype=bool)]
    assert apart.min() > 0.3


def test_arrows_are_forces_and_buoyancy_starts_on_its_line_of_action(run):
    scene, samples, path = run
    _, buoyancy = read(path, "world/forces/buoyancy", "Arrows3D:vectors")
    _, (weight,) = read(path, "world/forces/weight", "Arrows3D:vectors")
    _, origins = read(path, "world/forces/buoyancy", "Arrows3D:origins")
    weights = scene.model.body_mass[scene.buoyancy.bodies] * 9.81
    scale = -weight[:, 2] / weights
    for up, origin, sample in zip(buoyancy, origins, samples, strict=True):
        force, torque = np.split(sample.body_wrenches, 2, axis=1)
        turning = np.cross(origin - sample.centres, force)
        about = np.linalg.norm(force, axis=1).max()
        np.testing.assert_allclose(turning[:, :2], torque[:, :2], atol=10 * FLOAT32 * about)
        expected = sample.body_wrenches[:, :3] * scale[:, None]
        np.testing.assert_allclose(up, expected, atol=10 * FLOAT32)


def test_the_blueprint_is_in_the_file(run):
    *_, path = run
    assert len(RrdReader(path).blueprints()) == 1


def test_a_recording_is_readable_after_the_run_fails(tmp_path):
    scene, path = Scene.load(MODELS / "cube.xml"), tmp_path / "cut.rrd"

    def record() -> None:
        with Recorder(path, scene) as recorder:
            for sample in simulate(scene, 10.0):
                recorder.log(sample)
                if sample.time > 0.499:
                    raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record()
    times, heights = read(path, "plots/height/cube", "Scalars:scalars")
    assert times[-1] == pytest.approx(0.5, abs=ROUND_OFF * 1e3)
    assert len(heights) == 16


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # as after a killed run
@pytest.mark.parametrize(("frame_seconds", "most_lost"), [(0.001, 30), (0.1, 7), (5.0, 0)])
def test_a_killed_run_loses_less_than_a_second(tmp_path, frame_seconds, most_lost):
    """After each frame, the file on the disk is the file that SIGKILL would leave. It lacks at most
    the last second of simulated time and of a clock that the test sets."""
    time = [100.0]
    scene, path, lost = Scene.load(MODELS / "cube.xml"), tmp_path / "cut.rrd", []
    artist = Artist(scene, DisplayMeshes(scene.buoyancy), None, water_resolution=2)
    output = Output(path, "cut", side_by_side_blueprint({"cut": scene}, 1.0))
    writer = SceneWriter(scene, output, artist, clock=lambda: time[0])
    for frame, sample in enumerate(simulate(scene, 1.4), start=1):
        time[0] += frame_seconds
        writer.log(sample)
        lost.append(frame - len(read(path, "world/water", "Mesh3D:vertex_positions")[0]))
    output.close()
    assert max(lost) == most_lost


class DeadStream:
    """A recording stream whose writer has died. Freeing or disconnecting it would wait forever."""

    freed: list[int] = []  # noqa: RUF012

    def __init__(self, name: str) -> None:
        self.log = self.send_columns = self.set_sinks = lambda *arguments, **options: None
        self.set_log_time_enabled = self.set_log_tick_enabled = self.send_recording_name = self.log

    def flush(self, timeout_sec: float) -> None:
        raise RuntimeError("Flush timed out")

    def disconnect(self) -> None:
        pytest.fail("disconnect waits for the dead writer")

    def __del__(self) -> None:
        self.freed.append(1)


def test_nothing_waits_for_a_writer_that_has_died(tmp_path, monkeypatch):
    """The recorder, the garbage collector and Rerun's exit handler do not wait."""
    unregistered = []
    monkeypatch.setattr("rerun.RecordingStream", DeadStream)
    monkeypatch.setattr("atexit.unregister", unregistered.append)
    with pytest.raises(OSError, match=r"a\.rrd cannot be written \(Flush timed out"):
        Recorder(tmp_path / "a.rrd", Scene.load(MODELS / "cube.xml"))
    gc.collect()
    assert DeadStream.freed == []
    assert unregistered == [rr.rerun_shutdown]
    assert not (tmp_path / "a.rrd").exists()  # an empty recording is removed


def test_an_unwritable_path_is_refused_at_once(tmp_path):
    scene = Scene.load(MODELS / "cube.xml")
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"):
        Recorder(tmp_path / "file" / "cube.rrd", scene)
    with pytest.raises(OSError, match="is no file but a folder or a device"):
        Recorder(tmp_path, scene)


def test_names_with_spaces_and_slashes_are_one_body(tmp_path):
    scene = Scene.from_model(model(CUBE.replace('body name="cube"', 'body name="my cube/1"')))
    path = tmp_path / "names.rrd"
    with Recorder(path, scene) as recorder:
        for sample in simulate(scene, 0.1):
            recorder.log(sample)
    entities = {chunk.entity_path for chunk in RrdReader(path).stream()}
    assert r"/world/bodies/my\ cube\/1" in entities


def test_unnamed_and_united_geoms_are_recorded(tmp_path):
    """The tuple names the body of two overlapping boxes and a separate one, all unnamed."""
    boxes = "".join(
        f'<geom type="box" size="0.5 0.2 0.2" pos="{position}" density="300" rgba="0.8 0.2 0.2 1"/>'
        for position in ("0 0 0", "0.4 0.1 0", "0 3 0")
    )
    listed = '<custom><tuple name="buoyant"><element objtype="body" objname="b"/></tuple></custom>'
    bodies = f'<body name="b"><freejoint/>{boxes}</body>'
    scene = Scene.from_model(model(bodies, (), WAVES, extra=listed))
    assert len(scene.buoyancy.floats) == 2
    path = tmp_path / "united.rrd"
    with Recorder(path, scene) as recorder:
        for sample in simulate(scene, 0.2):
            recorder.log(sample)
    assert len(read_series(path)["height/b"][0]) == 7


def test_hulls_may_be_coloured_by_the_pressure(tmp_path):
    """Dry vertices are grey, and wet ones are redder with a higher head. The overview has a
    legend."""
    scene, path = Scene.load(MODELS / "cube.xml"), tmp_path / "p.rrd"
    artist = Artist(scene, DisplayMeshes(scene.buoyancy), None, 8, "pressure")
    *_, sample = simulate(scene, 3.0)
    frame = artist.frame(sample, sample.time)
    points, _ = artist.meshes.placed(sample)
    heads = scene.buoyancy.sea.head(*points.T, sample.time)
    assert ((frame.wetness == 0) == (heads <= 0.0)).all()
    wet = heads > 0.0
    order = np.argsort(heads[wet])
    assert (np.diff(frame.wetness[wet][order].astype(int)) >= 0).all()
    assert frame.wetness.max() > 100
    with Recorder(path, scene, colour="pressure") as recorder:
        recorder.log(sample)
    assert "dark red at 1 m and more" in last_overview(path)
    with pytest.raises(ValueError, match="the colour is 'heat'; expected wet or pressure"):
        Recorder(path, scene, colour="heat")
