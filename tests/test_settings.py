"""Settings that override a scene's fields, and seas from files and Python."""

import warnings
from dataclasses import astuple

import mujoco
import numpy as np
import pytest
from scenes import CUBE, WAVES, afloat, model, xml

from independent import MODELS, status_of
from sim import Linear, ModelError, Scene, Sea, Wave
from sim.mjcf.files import model_files
from sim.water.spectrum import bretschneider, ochi_hubble, pierson_moskowitz

JONSWAP = '<numeric name="sea_jonswap" data="0.3 3 3.3 10"/>'


def sea_with(*settings: str, custom: str = WAVES) -> Sea:
    return afloat(custom=custom, load=dict(settings=settings)).buoyancy.sea


def test_settings_override_rows_single_numbers_and_texts():
    assert sea_with("wave_swell=0.2 8 0 90").waves[0] == Wave(0.2, 8.0, 0.0, np.pi / 2.0)
    swell = sea_with("wave_swell.amplitude=0.05", "wave_swell.phase=90").waves[0]
    assert swell == Wave(0.05, 4.0, 0.0, np.pi / 2.0)
    assert sea_with("water_density=1000").density == 1000.0
    assert sea_with("water_current=0.5 0").current == (0.5, 0.0, 0.0)
    assert sea_with("water_pressure=hydrostatic").pressure == "hydrostatic"
    assert len(sea_with("wave_new=0.01 1 0 0").waves) == 4
    floats = afloat(load=dict(settings=["buoyancy_method_cube=linear"])).buoyancy.floats
    assert type(floats[0].method).__name__ == "Linear"


def test_settings_reach_attached_models():
    """By their prefix, and a seed in any case."""
    parent, child = mujoco.MjSpec(), mujoco.MjSpec.from_string(xml(CUBE, custom=JONSWAP))
    parent.option.timestep = child.option.timestep
    parent.attach(child, prefix="boat/", frame=parent.worldbody.add_frame())
    settings = {"seed": 7, "boat/buoyancy_method": "linear"}
    buoyancy = Scene.load(parent, settings=settings).buoyancy
    assert buoyancy.sea.waves == Sea.jonswap(0.3, 3.0, 3.3, np.radians(10.0), seed=7).waves
    assert type(buoyancy.floats[0].method) is Linear


def test_settings_are_strings_or_a_mapping():
    strings = ["wave_swell=0.2 8 0 90", "wave_cross.phase=10", "buoyancy_method=linear"]
    mapping = {
        "wave_swell": (0.2, 8, 0, 90), "wave_cross.phase": 10, "buoyancy_method": "linear"
    }  # fmt: skip
    one, other = (afloat(custom=WAVES, load=dict(settings=s)).buoyancy for s in (strings, mapping))
    assert one.sea == other.sea
    assert type(one.floats[0].method) is type(other.floats[0].method) is Linear
    with pytest.raises(ModelError, match="field 'buoyancy_method': it takes a text, not 3"):
        afloat(load=dict(settings={"buoyancy_method": 3}))


def test_a_sea_from_python_replaces_the_water_of_the_file():
    """The waves are equal to the round-off of angles in degrees."""
    sea = Sea.jonswap(0.3, 3.0, heading=0.3, seed=5, density=1000.0, current=(0.5, 0.1, 0.0),
                      ramp=2.0, tide=[(0.0, 0.1), (5.0, 0.4)], pressure="hydrostatic")  # fmt: skip
    found = afloat(custom=WAVES, load=dict(sea=sea)).buoyancy.sea
    assert len(found.waves) == len(sea.waves)
    for wave, expected in zip(found.waves, sea.waves, strict=True):
        np.testing.assert_allclose(astuple(wave), astuple(expected), rtol=1e-14)
    others = ("density", "gravity", "current", "ramp", "tide", "pressure")
    assert all(getattr(found, name) == getattr(sea, name) for name in others)
    with pytest.raises(ValueError, match=r"the sea's gravity is 1\.62 and the model's 9.81"):
        afloat(load=dict(sea=Sea(gravity=1.62)))


def test_a_tolerance_may_belong_to_one_geom():
    other = CUBE.replace('"cube"', '"other"').replace("0 0 0", "3 0 0")
    settings = {"buoyancy_tolerance": 1e-2, "buoyancy_tolerance_other": 2e-3}
    scene = afloat(CUBE + other, ("cube", "other"), WAVES, load=dict(settings=settings))
    assert [f.method.tolerance for f in scene.buoyancy.floats] == [1e-2, 2e-3]


def test_seed_belongs_to_the_irregular_sea():
    expected = Sea.jonswap(0.3, 3.0, 3.3, np.radians(10.0), seed=7).waves
    assert sea_with("seed=7", custom=JONSWAP).waves == expected
    assert sea_with("sea_jonswap.seed=7", custom=JONSWAP).waves == expected
    longer = sea_with("sea_jonswap.peak_period=4", custom=JONSWAP).waves
    assert longer == Sea.jonswap(0.3, 4.0, 3.3, np.radians(10.0)).waves


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("wave_swell", "expected NAME=VALUE"),
        ("=1", "expected NAME=VALUE"),
        ("water_densty=1000", "unknown; expected water_density: correct"),
        ("water_density=heavy", "'heavy' is not a row of numbers"),
        ("wave_swell=1 2", "has 2 numbers; expected 4"),
        ("wave_swell.height=1", "has the numbers amplitude, wavelength, heading, phase"),
        ("wave_nobody.amplitude=1", "the scene has no numeric 'wave_nobody'; it has water_density"),
        ("wave_swell.wavelength=-1", "the wavelength is -1 m; it must be above 1e-09"),
        ("seed=3", "the scene has no irregular sea"),
        ("drag_ball=1 1 1", "names no geom of the tuple 'buoyant'"),
        ("buoyancy_method=magic", "'magic' is not a method"),
    ],
)
def test_impossible_settings_are_refused(setting, message):
    with pytest.raises(ModelError) as caught:
        sea_with(setting)
    assert message in str(caught.value)
    assert len(caught.value.faults) == 1


def test_the_command_line_has_settings_keyframes_and_seeds(tmp_path, capsys):
    keys = '<keyframe><key name="low" qpos="0 0 0 1 0 0 0"/>'
    keys += '<key name="high" qpos="0 0 2 1 0 0 0"/></keyframe>'
    path = tmp_path / "s.xml"
    path.write_text(xml(CUBE, custom=JONSWAP, extra=keys))
    scene = Scene.load(path, keyframe="high", settings=["seed=2", "drag=0.2 1 0"])
    assert scene.data.qpos[2] == 2.0
    assert scene.buoyancy.has_resistance
    short = ("--duration", "0.1", "--quiet")
    options = ("--set", "drag=0.2 1 0", "--set", "water_level=0.1", "--keyframe", "high")
    assert status_of("run.py", path, "--no-record", *short, *options, "--set", "seed=3") == 0
    assert status_of("run.py", path, "--no-record", *short, "--keyframe", "up") == 2
    assert "there is no keyframe 'up'; the scene has 'low', 'high'" in capsys.readouterr().err


def test_arguments_that_override_a_scene_are_keywords():
    """Positional numbers would be mistaken for each other."""
    with pytest.raises(TypeError):
        Scene.load(MODELS / "cube.xml", "cube")
    with pytest.raises(TypeError):
        Scene.from_model(model(), "cube", "patches", 1e-3)
    with pytest.raises(TypeError):
        Sea.jonswap(0.3, 3.0, 3.3, 0.0, 0.4, 40, 0, 1025.0)
    with pytest.raises(TypeError, match="unexpected keyword argument 'methd'"):
        Scene.load(MODELS / "cube.xml", methd="patches")


def test_densities_of_geoms_may_be_overridden(tmp_path, capsys):
    path = tmp_path / "s.xml"
    path.write_text(xml(CUBE))
    assert Scene.load(path, densities={"cube": 100.0}).model.body_mass[1] == pytest.approx(100.0)
    assert Scene.load(path).model.body_mass[1] == pytest.approx(512.5)
    short = ("--no-record", "--duration", "0.1", "--quiet")
    assert status_of("run.py", path, *short, "--density", "cube=300") == 0
    capsys.readouterr()
    assert status_of("run.py", path, *short, "--density", "ball=300") == 2
    assert "there is no geom or body 'ball'; the scene has 'cube'" in capsys.readouterr().err
    own = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    path.write_text(xml(CUBE.replace("<freejoint/>", "<freejoint/>" + own)))
    assert status_of("run.py", path, *short, "--density", "cube=300") == 2
    assert "has an <inertial> of its own" in capsys.readouterr().err


def test_the_density_of_a_body_is_that_of_its_colliding_geoms():
    ghost = '<geom name="g" size="1" mass="0" contype="0" conaffinity="0"/>'
    part = '<body><geom type="box" size="0.5 0.5 0.5" density="900" contype="1"/></body>'
    bodies = CUBE.replace('name="cube" pos', 'name="boat" pos').replace(
        "</body>", f"{ghost}{part}</body>"
    )
    scene = afloat(bodies, load=dict(densities={"boat": 100.0}))
    assert scene.model.body_mass.sum() == pytest.approx(200.0)


BANDS = 0.01
"""Relative error of m2 from waves at the middles of bands."""


def moments(waves) -> tuple[float, float, float]:
    """Spectral moments m0, m2 and m4 of waves."""
    energy = 0.5 * np.array([w.amplitude for w in waves]) ** 2
    omega = np.sqrt(9.81 * np.array([w.wavenumber for w in waves]))
    return tuple(float(energy @ omega**n) for n in (0, 2, 4))


def test_moments_of_bretschneiders_spectrum_match_the_closed_form():
    """m0 = H^2 / 16, and the mean upcrossing period is 0.7104 Tp."""
    m0, m2, _ = moments(bretschneider(2.0, 10.0).waves(waves=4000))
    assert m0 == pytest.approx(0.25, rel=1e-9)
    upcrossing = 2.0 * np.pi * np.sqrt(m0 / m2)
    expected = 10.0 * (5.0 / (4.0 * np.pi)) ** 0.25 * 0.8944  # (4/5)^(1/2)
    assert expected == pytest.approx(7.104, abs=0.01)
    assert upcrossing == pytest.approx(expected, rel=BANDS)


def test_a_pierson_moskowitz_sea_has_the_height_and_period_of_its_wind():
    """A wind of 10 m/s at a height of 19.5 m gives 2.13 m and 7.3 s."""
    waves = pierson_moskowitz(0.2092 * 100.0 / 9.81).waves(waves=2000)
    m0, m2, _ = moments(waves)
    assert 4.0 * np.sqrt(m0) == pytest.approx(2.1325, rel=1e-3)
    assert 2.0 * np.pi * np.sqrt(m0 / m2) == pytest.approx(0.7104 * 7.304, rel=BANDS)


def test_a_sea_with_two_peaks_is_the_sum_of_two_seas():
    both = ochi_hubble(0.5, 14.0, 4.0, 1.0, 6.0, 1.0).waves(waves=2000)
    m0, m2, _ = moments(both)
    assert 4.0 * np.sqrt(m0) == pytest.approx(np.hypot(0.5, 1.0), rel=1e-9)
    wind = moments(ochi_hubble(1e-6, 14.0, 4.0, 1.0, 6.0, 1.0).waves(waves=2000))
    swell = moments(ochi_hubble(0.5, 14.0, 4.0, 1e-6, 6.0, 1.0).waves(waves=2000))
    assert m2 == pytest.approx(wind[1] + swell[1], rel=2 * BANDS)
    plain = moments(bretschneider(1.0, 6.0).waves(waves=2000))
    np.testing.assert_allclose(wind[:2], plain[:2], rtol=BANDS)  # equal at a sharpness of 1
    periods = 2.0 * np.pi / np.sqrt(9.81 * np.array([w.wavenumber for w in both]))
    near = [np.count_nonzero(np.abs(periods / p - 1.0) < 0.05) for p in (14.0, 9.0, 6.0)]
    assert near[0] > near[1] < near[2]


def scene_with(folder, custom: str):
    path = folder / "s.xml"
    path.write_text(xml(CUBE, custom=custom))
    return path


def test_components_are_read_from_a_file_beside_the_scene(tmp_path):
    table = "heading [deg], Amplitude (m), period [s]\n90, 0.1, 2.0\n0, 0.05, 3.0\n"
    (tmp_path / "sea.csv").write_text(table)
    path = scene_with(tmp_path, '<text name="sea_components" data="sea.csv"/>')
    sea = Scene.load(path).buoyancy.sea
    lengths = [9.81 * 4.0 / (2.0 * np.pi), 9.81 * 9.0 / (2.0 * np.pi)]
    assert [w.amplitude for w in sea.waves] == [0.1, 0.05]
    np.testing.assert_allclose([w.wavelength for w in sea.waves], lengths)
    assert sea.waves[0].heading == pytest.approx(np.pi / 2.0)
    assert tmp_path / "sea.csv" in model_files(path)


@pytest.mark.parametrize("position", [(0.0, 0.0), (3.0, -2.0)])
def test_a_sea_from_a_record_reproduces_the_record(position, tmp_path):
    """A wind sea, in which orbits are not small compared to the wavelengths."""
    truth = Sea.jonswap(0.5, 4.0, spread=0.0, heading=0.4, waves=60, seed=3)
    times = np.arange(0.0, 300.0, 0.2)
    record = truth.elevation(*position, times)
    rows = "\n".join(f"{t:.3f},{e:.6f}" for t, e in zip(times, record, strict=True))
    (tmp_path / "record.csv").write_text("time [s],elevation [m]\n" + rows)
    x, y = position
    path = scene_with(
        tmp_path,
        '<text name="sea_record" data="record.csv"/>'
        f'<numeric name="sea_record" data="22.918312 1 60 {x} {y}"/>',
    )
    sea = Scene.load(path, settings=["buoyancy_method=linear"]).buoyancy.sea
    found = sea.elevation(*position, times)
    error = (found - found.mean()) - (record - record.mean())
    assert np.sqrt(np.mean(error**2)) < 0.02 * record.std()
    assert {round(w.heading, 6) for w in sea.waves} == {0.4}


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("sea_components", None, "there is no file"),
        ("sea_components", "", "expected a header with names from"),
        ("sea_components", "amplitude,depth\n1,2\n", "begins with 'amplitude,depth'; expected"),
        ("sea_components", "amplitude\n1\n", "has the columns amplitude; expected amplitude, wave"),
        ("sea_components", "amplitude,period\n0.1\n", "line 2: expected 2 finite numbers"),
        ("sea_components", "amplitude,period\n0.1,x\n", "line 2: expected 2 finite numbers"),
        ("sea_components", "amplitude,wavelength\n0.1,9\n-1,9\n", "line 3: wave amplitude is -1"),
        ("sea_components", "amplitude,wavelength\n2,3\n", "the waves fold"),
        ("sea_record", "time,elevation\n0,1\n1,2\n", "expected 8 or more times in rising order"),
        ("sea_record", "time,height\n0,1\n1,2\n", "expected a header with names"),
    ],
)
def test_impossible_files_are_refused(name, text, message, tmp_path, capsys):
    if text is not None:
        (tmp_path / "sea.csv").write_text(text)
    path = scene_with(tmp_path, f'<text name="{name}" data="sea.csv"/>')
    assert status_of("run.py", path, "--no-record", "--duration", "0.1") == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_notes_refer_to_the_chosen_keyframe(tmp_path):
    """The cubes overlap in one keyframe and not in the other."""
    keys = '<keyframe><key name="apart" qpos="0 0 0 1 0 0 0 3 0 0 1 0 0 0"/>'
    keys += '<key name="within" qpos="0 0 0 1 0 0 0 .3 0 0 1 0 0 0"/></keyframe>'
    other = CUBE.replace('"cube"', '"other"')
    path = tmp_path / "s.xml"
    path.write_text(xml(CUBE + other, ("cube", "other"), extra=keys))
    overlaps = {}
    for keyframe in (None, "within"):
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always")
            Scene.load(path, keyframe=keyframe)
        overlaps[keyframe] = any("hulls overlap" in str(w.message) for w in notes)
    assert overlaps == {None: False, "within": True}
