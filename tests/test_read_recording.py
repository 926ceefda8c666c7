"""scripts/read_recording.py and the series that it reads."""

from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
import read_recording
import rerun as rr
from rerun.chunk import RrdReader
from scenes import CUBE, WAVES, model

from independent import MODELS
from sim import Recorder, Scene, read_series, simulate


def test_series_match_the_samples_and_are_written_as_arrays(tmp_path, capsys):
    path = tmp_path / "cube.rrd"
    scene, samples = Scene.load(MODELS / "cube.xml"), []
    with Recorder(path, scene) as recorder:
        for sample in simulate(scene, 2.5):
            recorder.log(sample)
            samples.append(sample)
    series = read_series(path)
    names = {"height/cube", "height/cube/water", "tilt/cube", "submerged/cube", "force/cube"}
    names |= {"heave/cube", "heave/cube/water", "surge/cube", "heel/cube", "trim/cube"}
    assert set(series) == names
    expected = {
        "height/cube": [s.centres[0, 2] for s in samples],
        "height/cube/water": [s.elevations[0] for s in samples],
        "tilt/cube": [np.degrees(s.tilts[0]) for s in samples],
    }
    for name, values in expected.items():
        np.testing.assert_array_equal(series[name][1], values)
        np.testing.assert_allclose(series[name][0], [s.time for s in samples], atol=1e-9)
    assert read_recording.main([str(path), "--output", str(tmp_path / "cube.npz")]) == 0
    assert "height/cube: 76 values from 0.000 to 2.500 s" in capsys.readouterr().out
    arrays = np.load(tmp_path / "cube.npz")
    assert set(arrays.files) == names
    np.testing.assert_array_equal(arrays["tilt/cube"], np.stack(series["tilt/cube"]))


def test_series_of_bodies_without_plots_are_read_too(tmp_path):
    names = tuple(f"cube{i}" for i in range(8))
    bodies = "".join(
        CUBE.replace('"cube"', f'"{name}"').replace("0 0 0", f"{2 * i} 0 {0.1 * i}")
        for i, name in enumerate(names)
    )
    scene, samples = Scene.from_model(model(bodies, names, WAVES)), []
    with Recorder(tmp_path / "cubes.rrd", scene, water_resolution=2) as recorder:
        for sample in simulate(scene, 0.3):
            recorder.log(sample)
            samples.append(sample)
    series = read_series(tmp_path / "cubes.rrd")
    assert len(series) == 8 * 10
    for i, body in enumerate(names):
        elevations = [s.elevations[i] for s in samples]
        np.testing.assert_array_equal(series[f"height/{body}/water"][1], elevations)
        fractions = [s.submerged_fractions[i] for s in samples]
        np.testing.assert_array_equal(series[f"submerged/{body}"][1], fractions)


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_a_cut_recording_is_read_up_to_the_cut(tmp_path):
    path = tmp_path / "cube.rrd"
    scene = Scene.load(MODELS / "cube.xml")
    with Recorder(path, scene) as recorder:
        for sample in simulate(scene, 2.5):
            recorder.log(sample)
    times, heights = read_series(path)["height/cube"]
    content, found = path.read_bytes(), []
    for share in np.linspace(0.6, 1.0, 10):
        path.write_bytes(content[: round(share * len(content))])
        read_times, read_heights = read_series(path)["height/cube"]
        np.testing.assert_array_equal(read_times, times[: len(read_times)])
        np.testing.assert_array_equal(read_heights, heights[: len(read_times)])
        found.append(len(read_times))
    assert found == sorted(found)
    assert found[0] < found[-1] == len(times)
    path.write_bytes(content[: len(content) * 4 // 5])
    with pytest.raises(RuntimeError, match="exceeds file size"):
        RrdReader(path).recordings()
    before = path.read_bytes()
    assert read_recording.main([str(path), "--mend"]) == 0
    mended = tmp_path / "cube_mended.rrd"
    assert len(RrdReader(mended).recordings()) == 1
    assert path.read_bytes() == before
    assert len(read_series(mended)["height/cube"][0]) == len(read_series(path)["height/cube"][0])
    middle = len(content) // 2
    path.write_bytes(content[:middle] + bytes(100) + content[middle + 100 :])
    another = tmp_path / "another.rrd"
    assert read_recording.main([str(path), "--mend", "--output", str(another)]) == 0
    assert len(read_series(another)["height/cube"][0]) > 0.8 * len(times)
    assert read_recording.main([str(path), "--mend", "--output", str(path)]) == 2


NAMES = ("deep sea", "a/b", "x.y-z", "Möwe", "船", "{u}", "tab\tbed", "back\\slash", "'quoted'")


def test_bodies_keep_their_names(tmp_path):
    """Names may have any characters, and one body has no name."""
    bodies = "".join(
        f'<body {f"name={quoteattr(name)}" if name else ""} pos="{3 * i} 0 0"><freejoint/>'
        f'<geom name="g{i}" type="box" size="0.5 0.5 0.5" density="500"/></body>'
        for i, name in enumerate([*NAMES, ""])
    )
    scene = Scene.from_model(model(bodies, tuple(f"g{i}" for i in range(len(NAMES) + 1))))
    path = tmp_path / "names.rrd"
    with Recorder(path, scene) as recorder:
        for sample in simulate(scene, 0.1):
            recorder.log(sample)
    series = read_series(path)
    last = f"body {scene.model.nbody - 1}"
    for name in (*NAMES, last):
        assert f"height/{name}" in series
        assert f"height/{name}/water" in series


def test_a_file_that_is_not_a_recording_is_not_repaired(tmp_path, capsys):
    path = tmp_path / "notes.txt"
    path.write_text("not a recording")
    assert read_recording.main([str(path), "--mend"]) == 2
    assert "is not a recording; it was not changed" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]
    assert path.read_text() == "not a recording"


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "there is no recording"), (b"junk", "is no recording that can be read")],
)
def test_unusable_files_give_one_line_and_status_2(content, message, tmp_path, capsys):
    path = tmp_path / "a.rrd"
    if content is not None:
        path.write_bytes(content)
    assert read_recording.main([str(path)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_recording_by_another_program_is_not_ours(tmp_path, capsys):
    path = tmp_path / "a.rrd"
    stream = rr.RecordingStream("another_program")
    stream.save(path)
    stream.set_time("time", duration=1.0)
    stream.log("plots/height/cube", rr.Scalars(1.0))
    stream.flush(timeout_sec=5)
    stream.disconnect()
    assert read_recording.main([str(path)]) == 2
    assert f"{path} is a recording by another_program, not by Waterline" in capsys.readouterr().err
