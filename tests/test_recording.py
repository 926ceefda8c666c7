"""Recordings, read back and held against the samples."""

import numpy as np
import pytest
from rerun.chunk import RrdReader

from independent import MODELS, ROUND_OFF
from sim import Recorder, Scene, simulate

FLOAT32 = 1e-6
"""Relative error of positions: Rerun keeps them in single precision."""


def read(path, entity: str, component: str) -> tuple[np.ndarray, list[np.ndarray]]:
    """Times [s] and values of a component, in order of time; static data has no times."""
    rows = []
    for chunk in RrdReader(path).stream().filter(content=f"/{entity}"):
        batch = chunk.to_record_batch()
        if component not in batch.schema.names:
            continue
        times = [np.nan] * batch.num_rows
        if "time" in batch.schema.names:
            times = batch.column("time").cast("int64").to_numpy() * 1e-9
        for time, value in zip(times, batch.column(component).to_pylist(), strict=True):
            rows.append((time, np.array(value)))
    rows.sort(key=lambda row: row[0])
    return np.array([time for time, _ in rows]), [value for _, value in rows]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The trio for two seconds: scene, samples and the recording's path."""
    path = tmp_path_factory.mktemp("recording") / "deep" / "trio.rrd"
    scene = Scene.load(MODELS / "trio.xml")
    samples = []
    with Recorder(path, scene) as recorder:
        for sample in simulate(scene, 2.0, rate=30.0):
            recorder.log(sample)
            samples.append(sample)
    return scene, samples, path


def test_time_series_are_the_samples(run):
    scene, samples, path = run
    expected = {
        "plots/height/{}": [s.centres[:, 2] for s in samples],
        "plots/height/{}/water": [s.elevations for s in samples],
        "plots/tilt/{}": [np.degrees(s.tilts) for s in samples],
        "plots/submerged/{}": [s.submerged_fractions for s in samples],
        "plots/force/{}": [s.body_wrenches[:, 2] for s in samples],
    }
    for i, body in enumerate(scene.buoyancy.body_names):
        for entity, values in expected.items():
            times, scalars = read(path, entity.format(body), "Scalars:scalars")
            np.testing.assert_allclose(times, [s.time for s in samples], atol=1e-9)
            np.testing.assert_array_equal(np.ravel(scalars), np.array(values)[:, i])


def test_bodies_are_where_the_samples_say(run):
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
    """In the body frame, and placed so that vertices land where MuJoCo's geoms have them."""
    scene, _, path = run
    for f in scene.buoyancy.floats:
        entity = f"world/bodies/{f.name}/{f.name}"
        _, (vertices,) = read(path, entity, "Mesh3D:vertex_positions")
        _, (normals,) = read(path, entity, "Mesh3D:vertex_normals")
        _, (faces,) = read(path, entity, "Mesh3D:triangle_indices")
        hull = f.method.hull
        np.testing.assert_allclose(vertices, hull.vertices, atol=FLOAT32)
        np.testing.assert_array_equal(faces, hull.faces)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=FLOAT32)
        outward = np.einsum("fi,fi->f", hull.area_vectors, normals[faces].mean(axis=1))
        assert outward.sum() > 0.5 * np.linalg.norm(hull.area_vectors, axis=1).sum()
        _, (place,) = read(path, entity, "Transform3D:translation")
        body = scene.model.body(f.body)
        np.testing.assert_allclose(np.ravel(place), body.ipos, atol=FLOAT32)


def test_water_is_the_surface_that_pushes_and_stays_around_the_bodies(run):
    scene, samples, path = run
    _, frames = read(path, "world/water", "Mesh3D:vertex_positions")
    assert len(frames) == len(samples)
    for points, sample in zip(frames, samples, strict=True):
        x, y, z = points.astype(float).T
        heights = scene.buoyancy.sea.elevation(x, y, sample.time)
        np.testing.assert_allclose(z, heights, atol=10 * FLOAT32)
        low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
        assert (sample.centres[:, :2] > low + 1.0).all()
        assert (sample.centres[:, :2] < high - 1.0).all()


def test_arrows_are_forces_at_the_centres_of_mass(run):
    scene, samples, path = run
    _, buoyancy = read(path, "world/forces/buoyancy", "Arrows3D:vectors")
    _, weight = read(path, "world/forces/weight", "Arrows3D:vectors")
    _, origins = read(path, "world/forces/buoyancy", "Arrows3D:origins")
    weights = scene.model.body_mass[scene.buoyancy.bodies] * 9.81
    for up, down, origin, sample in zip(buoyancy, weight, origins, samples, strict=True):
        np.testing.assert_allclose(origin, sample.centres, atol=FLOAT32)
        scale = -down[:, 2] / weights
        expected = sample.body_wrenches[:, :3] * scale[:, None]
        np.testing.assert_allclose(up, expected, atol=10 * FLOAT32)


def test_blueprint_is_inside_the_file(run):
    *_, path = run
    assert len(RrdReader(path).blueprints()) == 1


def test_recording_is_readable_when_the_run_fails_half_way(tmp_path):
    scene, path = Scene.load(MODELS / "cube.xml"), tmp_path / "cut.rrd"
    with pytest.raises(KeyboardInterrupt):
        _record_and_fail(path, scene)
    times, heights = read(path, "plots/height/cube", "Scalars:scalars")
    assert times[-1] == pytest.approx(0.5, abs=ROUND_OFF * 1e3)
    assert len(heights) == 16


def _record_and_fail(path, scene) -> None:
    with Recorder(path, scene) as recorder:
        for sample in simulate(scene, 10.0):
            recorder.log(sample)
            if sample.time > 0.499:
                raise KeyboardInterrupt


def test_a_path_that_cannot_be_written_is_refused_at_once(tmp_path):
    scene = Scene.load(MODELS / "cube.xml")
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"):
        Recorder(tmp_path / "file" / "cube.rrd", scene)
    with pytest.raises(IsADirectoryError):
        Recorder(tmp_path, scene)


def test_names_with_blanks_and_slashes_stay_one_body(tmp_path):
    from scenes import CUBE, model

    scene = Scene.from_model(model(CUBE.replace('body name="cube"', 'body name="my cube/1"')))
    path = tmp_path / "names.rrd"
    with Recorder(path, scene) as recorder:
        for sample in simulate(scene, 0.1):
            recorder.log(sample)
    entities = {chunk.entity_path for chunk in RrdReader(path).stream()}
    assert r"/world/bodies/my\ cube\/1" in entities
