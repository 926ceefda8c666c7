"""Coefficients of a panel code: the fit of the memory, bodies at rest, panels, the script."""

import numpy as np
import pytest

import coefficients
import memory_fit
import panel_code
from independent import DENSITY, GRAVITY
from memory_fit import fit_memory, memory_force
from panel_code import Coefficients, Water
from resting import resting_bodies
from sim import Scene, hydrostatics
from sim.hulls.primitives import box as box_hull
from sim.hulls.solids import solid_of
from sim.resistance.hydrodynamics import Hydrodynamics

ROUND_OFF = 1e-9

FINITE_DIFFERENCES = 1e-6
"""Relative error of a stiffness from central differences."""

OMEGA = np.geomspace(0.1, 6.0, 36)

POLES = np.array(
    [
        [0.5, 0.6, 1.0, 0.0, 0.0, 0.0, 3.0, 0.0],
        [2.0, 1.5, 0.7, 0.0, 0.0, 0.0, -2.0, 0.0],
        [1.2, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        [4.0, 1.2, 0.0, 0.0, 0.6, 0.0, 0.0, 0.0],
    ]
)  # fmt: skip
"""A memory that couples surge with pitch; sway, roll and yaw make no waves."""

HULME = np.array(
    [
        [0.1, 0.8627, 0.1816], [0.2, 0.7938, 0.2793], [0.4, 0.6452, 0.3410],
        [0.6, 0.5381, 0.3271], [1.0, 0.4284, 0.2484], [2.0, 0.3884, 0.1031],
        [5.0, 0.4471, 0.0116],
    ]
)  # fmt: skip
"""Heaving hemisphere: k a, added mass and damping over omega, in displaced masses (Hulme 1982)."""


def matrices(memory, omega=OMEGA, added_inf=None):
    """A, B (F, 6, 6) and A_inf of a memory."""
    added_inf = np.eye(6) if added_inf is None else added_inf
    K = memory_force(memory, omega)
    return added_inf + K.imag / omega[:, None, None], K.real.copy(), added_inf


# The fit


def test_the_fit_finds_the_oscillators_that_made_the_numbers():
    fit = fit_memory(OMEGA, *matrices(POLES), length=5.0)
    found = fit.memory[np.argsort(fit.memory[:, 0])]
    known = POLES[np.argsort(POLES[:, 0])]
    signs = np.sign(np.sum(found[:, 2:] * known[:, 2:], axis=1))  # of a column either is right
    found[:, 2:] *= signs[:, None]
    np.testing.assert_allclose(found, known, rtol=1e-6, atol=1e-6)  # least squares stop early
    assert fit.errors.max() < ROUND_OFF


def test_few_columns_describe_a_hemisphere():
    """Within a tenth of the largest value, though seven frequencies tell little of widths."""
    omega = np.sqrt(GRAVITY * HULME[:, 0] / 5.0)
    added, damping = np.full((7, 1, 1), 0.5) * np.eye(6), np.zeros((7, 6, 6))
    added[:, 2, 2], damping[:, 2, 2] = HULME[:, 1], HULME[:, 2] * omega
    fit = fit_memory(omega, added, damping, 0.5 * np.eye(6), length=10.0)
    assert fit.worst[0] < 0.1
    assert fit.worst[1] == "heave"
    assert 1 <= len(fit.memory) <= memory_fit.MOST_COLUMNS
    assert np.count_nonzero(fit.memory[:, 2:]) == len(fit.memory)  # all in heave


def test_every_fit_takes_energy_at_every_frequency():
    """Also one of numbers that do not come from oscillators, below and above their band."""
    root = np.zeros((6, 6))
    root[[0, 0, 4, 4], [0, 4, 0, 4]] = 1.0, 0.5, -0.3, 0.8
    square = root @ root.T
    shape = (OMEGA**3 * np.exp(-OMEGA))[:, None, None]
    added = np.eye(6) + 0.3 * np.exp(-OMEGA)[:, None, None] * square
    fit = fit_memory(OMEGA, added, shape * square, np.eye(6), length=1.0)
    assert (fit.memory[:, :2] > 0.0).all()
    damping = memory_force(fit.memory, np.geomspace(1e-3, 1e3, 50)).real
    assert np.linalg.eigvalsh(damping).min() > -ROUND_OFF * np.abs(damping).max()
    assert fit.worst[0] > 0.01


def spoilt(which, index, amount):
    arrays = [np.array(a) for a in matrices(POLES)]
    arrays[which][index] += amount
    return arrays


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        (spoilt(0, (5, 0, 2), 5.0), "added mass is not symmetric"),
        (spoilt(1, (5, 2, 2), -5.0), "damping has a negative eigenvalue"),
        (spoilt(2, (1, 1), -2.0), "A_inf has a negative eigenvalue"),
        (spoilt(1, (0, 0, 0), np.nan), "damping has a number that is not finite"),
    ],
)
def test_numbers_of_no_body_are_refused(arrays, words):
    with pytest.raises(ValueError, match=words):
        fit_memory(OMEGA, *arrays, length=5.0)


# Bodies at rest

BARGE = """<body name="barge" pos="3 2 1" euler="0 0 40"><freejoint/>
  <inertial pos="0 0 -0.1" mass="20500" diaginertia="29000 172000 198000"/>
  <geom name="hull" type="box" size="5 2 0.5"/></body>"""

FLAP = """<body name="flap" pos="0 0 -1.5"><joint type="hinge" axis="0 1 0" pos="0 0 -1.5"
  damping="7" stiffness="11" armature="3"/>
  <inertial pos="0 0 -0.4" mass="3000" diaginertia="9000 8000 2000"/>
  <geom name="hull" type="box" size="0.25 3 2"/></body>"""

BUOY = """<body name="buoy" pos="0 0 9"><joint type="slide" axis="0 0 1"/>
  <geom type="box" size="1 1 1" density="512.5"/></body>"""


def scene_file(tmp_path, *bodies, custom=""):
    names = "".join(
        f'<element objtype="body" objname="{b.split(chr(34))[1]}" prm="0"/>' for b in bodies
    )
    path = tmp_path / "scene.xml"
    path.write_text(
        f'<mujoco><custom>{custom}<numeric name="water_density" data="{DENSITY}"/>'
        f'<tuple name="buoyant">{names}</tuple></custom>'
        f"<worldbody>{''.join(bodies)}</worldbody></mujoco>"
    )
    return path


def at_rest(tmp_path, body):
    scene = Scene.load(scene_file(tmp_path, body))
    return scene, next(resting_bodies(scene, scene.buoyancy.body_names))


def test_a_free_body_rests_with_its_bow_along_x(tmp_path):
    scene, body = at_rest(tmp_path, BARGE)
    draught = 20500.0 / (DENSITY * 40.0)
    low, high = np.reshape(body.solid.bounding_box(), (2, 3))
    np.testing.assert_allclose(low, [-5.0, -2.0, -draught], atol=1e-7)
    np.testing.assert_allclose(high, [5.0, 2.0, 1.0 - draught], atol=1e-7)
    np.testing.assert_allclose(body.position, [0.0, 0.0, -0.1], atol=ROUND_OFF)
    np.testing.assert_allclose(body.rotation, np.eye(3), atol=1e-7)
    assert body.freedoms.titles == coefficients.FREEDOMS
    np.testing.assert_allclose(body.freedoms.motions, np.eye(6), atol=ROUND_OFF)
    expected = hydrostatics(scene, with_gz=False)["barge"].rest.stiffness
    scale = np.abs(expected).max()
    np.testing.assert_allclose(body.freedoms.stiffness, expected, atol=FINITE_DIFFERENCES * scale)


def test_a_flap_on_a_hinge_stays_where_it_starts(tmp_path):
    """Its draught is 3.5 m. Waterplane and buoyancy hold it upright about the hinge; its weight
    upsets it."""
    _, body = at_rest(tmp_path, FLAP)
    area, lever = 0.5 * 6.0, 3.0 - 1.75  # of the centre of buoyancy, above the hinge at -3 m
    water = DENSITY * GRAVITY * (area * 0.5**2 / 12.0 + area * 3.5 * lever)
    stiffness = water - 3000.0 * GRAVITY * 1.1 + 11.0
    found = body.freedoms
    assert found.titles == ("pitch",)
    assert found.stiffness[0, 0] == pytest.approx(stiffness, rel=FINITE_DIFFERENCES)
    assert found.mass[0, 0] == pytest.approx(8000.0 + 3000.0 * 1.1**2 + 3.0, rel=ROUND_OFF)
    assert found.damping[0, 0] == 7.0
    np.testing.assert_allclose(found.motions[:, 0], [1.1, 0, 0, 0, 1, 0], atol=ROUND_OFF)
    assert body.height == pytest.approx(-1.9)


def test_a_body_on_a_slide_rests_where_it_floats(tmp_path):
    _, body = at_rest(tmp_path, BUOY)
    assert body.height == pytest.approx(0.0, abs=ROUND_OFF)
    assert body.freedoms.titles == ("heave",)
    expected = DENSITY * GRAVITY * 4.0
    assert body.freedoms.stiffness[0, 0] == pytest.approx(expected, rel=FINITE_DIFFERENCES)


@pytest.mark.parametrize("count", [60, 400])
@pytest.mark.parametrize("size", [1.0, 50.0])
def test_panels_cover_the_wetted_surface(count, size):
    """Their area vectors add up to the waterplane's, whatever the hull's own triangles are."""
    hull = box_hull(5.0 * size, 2.0 * size, 0.75 * size)
    solid = solid_of((hull.vertices - [0.0, 0.0, 0.25 * size], hull.faces))
    vertices, faces = panel_code.panels(solid, count)
    assert 0.6 * count < len(faces) < 1.5 * count
    assert vertices[:, 2].max() == pytest.approx(0.0, abs=ROUND_OFF * size)
    a, b, c = vertices[faces].transpose(1, 0, 2)
    vectors = 0.5 * np.cross(b - a, c - a)
    np.testing.assert_allclose(
        vectors.sum(axis=0), [0.0, 0.0, -40.0 * size**2], atol=ROUND_OFF * size**2
    )
    area = np.linalg.norm(vectors, axis=1).sum()
    assert area == pytest.approx((40.0 + 28.0) * size**2, rel=ROUND_OFF)


# The panel code's numbers


def made_up(vertices, faces, centre, water, frequencies, headings, advance=lambda: None):
    """What `solve` returns, of known oscillators and of a force of stiffness times amplitude."""
    size = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    memory = POLES.copy()
    memory[:, 2:] *= 100.0 * size
    added, damping, added_inf = matrices(memory, frequencies, 1e4 * np.diag(size**2))
    shape = (len(frequencies), len(headings), 6)
    incident = np.zeros(shape, dtype=complex)
    incident[:, :, 2] = water.density * water.gravity * 40.0
    advance()
    return Coefficients(
        frequencies, added, damping, added_inf, headings, np.full(shape, 1.0j), incident, water
    )


@pytest.fixture
def no_panel_code(monkeypatch):
    """The script without Capytaine: it gets the numbers of `made_up`."""
    monkeypatch.setattr(coefficients, "solve", made_up)
    monkeypatch.setattr(coefficients, "check_installed", lambda *modules: None)


def run(*arguments):
    return coefficients.main([str(argument) for argument in arguments])


def test_the_script_writes_what_a_scene_needs(tmp_path, no_panel_code, capsys):
    custom = '<numeric name="water_depth" data="30"/>'
    scene = scene_file(tmp_path, BARGE, custom=custom)
    assert run(scene) == 0
    output = tmp_path / "scene_barge.npz"
    found = Hydrodynamics.load(output)
    printed = capsys.readouterr().out
    assert '<text name="hydrodynamics_barge" data="scene_barge.npz"/>' in printed
    assert "worst error of the fit: 0.0%" in printed
    np.testing.assert_allclose(found.position, [0.0, 0.0, -0.1], atol=ROUND_OFF)
    np.testing.assert_allclose(found.rotation, np.eye(3), atol=1e-7)
    assert (found.density, found.gravity, found.depth) == (DENSITY, GRAVITY, 30.0)
    K = memory_force(found.memory, found.frequencies)
    memory = POLES * np.array([1.0, 1.0] + 3 * [100.0] + 3 * [200.0])
    damping = memory_force(memory, found.frequencies).real
    np.testing.assert_allclose(found.added_mass, 1e4 * np.diag([1, 1, 1, 4, 4, 4]), rtol=ROUND_OFF)
    np.testing.assert_allclose(K.real, damping, atol=1e-6 * damping.max())
    rows = [line.split() for line in printed.splitlines() if line[:1].isdigit()]
    for _, *pairs in rows:
        assert pairs[::2] == pairs[1::2]  # the fit's responses and the panel code's
    longest = rows[-1]
    assert float(longest[1]) == pytest.approx(1.0, rel=0.05)  # heave in long waves

    before = output.read_bytes()
    assert run(scene) == 2
    assert f"to replace it, give --output {output}" in capsys.readouterr().err
    assert output.read_bytes() == before
    scene.write_text(
        scene.read_text().replace(
            custom, f'{custom}<text name="hydrodynamics_barge" data="scene_barge.npz"/>'
        )
    )
    output.unlink()  # the scene names a file that is still to be made
    assert run(scene) == 0
    assert output.is_file()


def test_responses_solve_the_equation_of_motion(tmp_path):
    """K holds A and B: the equation has -omega^2 A - i omega B, for motions e^(-i omega t)."""
    _, body = at_rest(tmp_path, BARGE)
    water = Water(DENSITY, GRAVITY, np.inf)
    found = made_up(None, None, None, water, OMEGA, np.array([0.0]))
    K = found.damping + 1j * OMEGA[:, None, None] * (found.added - found.added_inf)
    moved = coefficients.responses(body.freedoms, found, found.added_inf, K)[:, 0]
    force = (found.diffraction + found.incident)[:, 0]
    for omega, added, damping, motion, wanted in zip(
        OMEGA, found.added, found.damping, moved, force, strict=True
    ):
        mass = body.freedoms.mass + added
        left = body.freedoms.stiffness - omega**2 * mass - 1j * omega * damping
        np.testing.assert_allclose(left @ motion, wanted, atol=1e-6 * np.abs(wanted).max())


def test_several_bodies_get_a_file_each(tmp_path, no_panel_code, capsys):
    scene = scene_file(tmp_path, BARGE, BUOY)
    assert run(scene, "--output", tmp_path / "one.npz") == 2
    assert "--output is for one body; add --body NAME: barge, buoy" in capsys.readouterr().err
    assert run(scene, "--body", "boat") == 2
    assert "no body 'boat' floats; the scene has barge, buoy" in capsys.readouterr().err
    assert run(scene) == 0
    assert "waves between the bodies are not modelled" in capsys.readouterr().err
    assert {p.name for p in tmp_path.glob("*.npz")} == {"scene_barge.npz", "scene_buoy.npz"}
    assert run(scene, "--body", "buoy", "--output", tmp_path / "one.npz") == 0
    assert (tmp_path / "one.npz").read_bytes()


def test_what_cannot_be_done_is_one_line(tmp_path, monkeypatch, capsys):
    scene = scene_file(tmp_path, BARGE)
    monkeypatch.setattr(panel_code.importlib.util, "find_spec", lambda name: None)
    assert run(scene) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "capytaine is not installed; run: pip install '.[bem]'" in told
    monkeypatch.undo()
    monkeypatch.setattr(coefficients, "check_installed", lambda *modules: None)
    monkeypatch.setattr(coefficients, "solve", made_up)
    heavy = scene_file(tmp_path, BUOY.replace("512.5", "2000"))
    assert run(heavy) == 2
    assert "body 'buoy' finds no rest on its joints" in capsys.readouterr().err
    shallow = scene_file(tmp_path, BARGE, custom='<numeric name="water_depth" data="0.3"/>')
    assert run(shallow) == 2
    assert "body 'barge' reaches 0.5 m down where it rests and" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.npz"))


def test_water_of_another_kind_is_refused(tmp_path):
    ours = Water(DENSITY, GRAVITY, np.inf)
    coefficients.check_water(Water(DENSITY * 1.004, GRAVITY, np.inf), ours, tmp_path)
    for other in (Water(1000.0, GRAVITY, np.inf), Water(DENSITY, GRAVITY, 50.0)):
        with pytest.raises(ValueError, match="the scene has"):
            coefficients.check_water(other, ours, tmp_path)


def test_a_dataset_in_any_order_is_read(tmp_path):
    """Frequencies, headings and motions in other orders, about a point away from the origin."""
    xarray = pytest.importorskip("xarray")
    water = Water(DENSITY, GRAVITY, np.inf)
    omega, headings = np.array([0.5, 1.0, 2.0]), np.radians([0.0, 90.0, 200.0])
    found = made_up(None, None, None, water, omega, headings)
    centre = np.array([3.0, -1.0, -0.5])
    phases = np.exp(
        1j * omega[:, None] ** 2 / GRAVITY * (3.0 * np.cos(headings) - np.sin(headings))
    )
    names = list(panel_code.MOTIONS)
    backwards = np.array(names)[::-1]
    force = found.diffraction * phases[:, :, None]
    dataset = xarray.Dataset(
        {
            "added_mass": (
                ("omega", "radiating_dof", "influenced_dof"),
                np.concatenate([found.added, found.added_inf[None]]),
            ),
            "radiation_damping": (
                ("omega", "radiating_dof", "influenced_dof"),
                np.concatenate([found.damping, np.zeros((1, 6, 6))]),
            ),
            "diffraction_force": (
                ("complex", "omega", "wave_direction", "influenced_dof"),
                np.array(
                    [
                        np.concatenate([part, np.full((1, 3, 6), np.nan)])
                        for part in (force.real, force.imag)
                    ]
                ),
            ),
        },
        coords={
            "omega": [*omega, np.inf], "wave_direction": headings, "influenced_dof": names,
            "radiating_dof": names, "complex": ["re", "im"], "rho": DENSITY, "g": GRAVITY,
            "water_depth": np.inf, "rotation_center": ("space", centre),
        },
    )  # fmt: skip
    shuffled = dataset.sel(influenced_dof=backwards, radiating_dof=backwards[::-1]).isel(
        omega=[3, 1, 0, 2], wave_direction=[2, 0, 1]
    )
    read = panel_code.from_dataset(shuffled)
    for name in ("frequencies", "added", "damping", "added_inf", "headings", "diffraction"):
        np.testing.assert_allclose(getattr(read, name), getattr(found, name), atol=ROUND_OFF)
    assert np.isnan(read.incident).all()
    for change, words in (
        (lambda d: d.drop_vars("radiation_damping"), "it has no radiation_damping"),
        (lambda d: d.isel(omega=[0, 1]), "no added mass at infinite frequency"),
        (lambda d: d.isel(influenced_dof=[2]), "it has the motions Heave; expected Surge"),
    ):
        with pytest.raises(ValueError, match=words):
            panel_code.from_dataset(change(dataset))
    with pytest.raises(FileNotFoundError, match="there is no file"):
        panel_code.read(tmp_path / "none.nc")
    (tmp_path / "bad.nc").write_text("no netCDF")
    with pytest.raises(ValueError, match=r"bad\.nc"):
        panel_code.read(tmp_path / "bad.nc")


def test_capytaine_finds_the_hemisphere(tmp_path):
    """A coarse one, a study's numbers (Hulme 1982) within 5 %. Its own file holds the same."""
    capytaine = pytest.importorskip("capytaine")
    import manifold3d

    solid = manifold3d.Manifold.sphere(5.0, 36)
    solid = solid.scale([(4.0 / 3.0 * np.pi * 125.0 / solid.volume()) ** (1.0 / 3.0)] * 3)
    vertices, faces = panel_code.panels(solid, 320)
    water, centre = Water(1000.0, GRAVITY, np.inf), (0.0, 0.0, -2.0)
    row = HULME[4]
    omega, headings = np.sqrt(GRAVITY * row[:1] / 5.0), np.array([0.0, 2.0])
    found = panel_code.solve(vertices, faces, centre, water, omega, headings)
    mass = 1000.0 * 2.0 / 3.0 * np.pi * 125.0
    assert found.added[0, 2, 2] / mass == pytest.approx(row[1], rel=0.05)
    assert found.damping[0, 2, 2] / mass / omega[0] == pytest.approx(row[2], rel=0.05)
    assert found.added_inf[2, 2] / mass == pytest.approx(0.5, rel=0.05)
    aside = vertices + [4.0, 1.0, 0.0], (4.0, 1.0, -2.0)
    moved = panel_code.solve(aside[0], faces, aside[1], water, omega, headings)
    scale = np.abs(found.incident).max()
    np.testing.assert_allclose(moved.incident, found.incident, atol=1e-4 * scale)
    np.testing.assert_allclose(moved.diffraction, found.diffraction, atol=1e-4 * scale)

    pytest.importorskip("h5py")
    body = panel_code._body(vertices + [4.0, 1.0, 0.0], faces, aside[1])
    problems = [
        capytaine.RadiationProblem(body=body, radiating_dof=m, omega=w, rho=1000.0, g=GRAVITY)
        for m in panel_code.MOTIONS
        for w in (omega[0], np.inf)
    ] + [
        capytaine.DiffractionProblem(
            body=body, wave_direction=h, omega=omega[0], rho=1000.0, g=GRAVITY
        )
        for h in headings
    ]
    dataset = capytaine.assemble_dataset(capytaine.BEMSolver(method="direct").solve_all(problems))
    capytaine.export_dataset(tmp_path / "sphere.nc", dataset)
    read = panel_code.read(tmp_path / "sphere.nc")
    for name in ("frequencies", "added", "damping", "added_inf", "headings"):
        np.testing.assert_allclose(getattr(read, name), getattr(moved, name), rtol=1e-6)
    for name in ("diffraction", "incident"):
        np.testing.assert_allclose(getattr(read, name), getattr(moved, name), atol=1e-6 * scale)
