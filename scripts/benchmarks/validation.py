"""Validation: checks of this package against published results and closed forms.

The numbers of the Wigley hull, the barge and the sphere below that come from a panel code were
computed with Capytaine; `validate.py --panel-code` computes them again. The checks run without it.
"""

from collections.abc import Callable, Iterator
from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks import wide_bodies
from benchmarks.checks import (
    CLOSED_FORM,
    DENSITY,
    GRAVITY,
    LINEAR_METHOD,
    PANEL_CODE,
    Check,
    Once,
    about,
    amplitudes,
    numeric,
    scene_of,
)
from benchmarks.wide_bodies import OES_SPHERE, SHALLOW, SHALLOW_PHASES
from sim.hulls.hull import Hull
from sim.hulls.primitives import box
from sim.methods import Linear, Method, Patches
from sim.runs.simulation import simulate
from sim.scenes.hydrostatics import hydrostatics
from sim.scenes.scene import Scene
from sim.statics.report import Rest
from sim.water.sea import Sea
from sim.water.wave import Wave

Array = NDArray[np.float64]

SMALL_AMPLITUDE = 0.01
"""Amplitude [m] of waves so small that first-order theory holds to 1e-3."""

WIGLEY_MASS, WIGLEY_CENTRE = 2847.22, (0.0, 0.0, -0.2)
WIGLEY_INERTIA = (455.6, 17795.0, 17795.0)

WIGLEY_ADDED_MASS = ((52.41, 0.0, 550.85), (0.0, 1850.94, 0.0), (550.85, 0.0, 10532.25))
WIGLEY_DAMPING = ((149.17, 0.0, 1803.0), (0.0, 6583.69, 0.0), (1803.0, 0.0, 22235.06))
"""Added mass [kg, kg m, kg m^2] and damping [N s/m, N s, N m s] of the Wigley hull in surge, heave
and pitch about its centre of mass, in a wave of its own length; used for all wavelengths."""

WIGLEY_RESPONSES = {
    3.0: (0.901, 0.984), 2.0: (0.783, 0.918), 1.5: (0.629, 0.819), 1.2: (0.462, 0.693),
    1.0: (0.304, 0.550), 0.9: (0.216, 0.452),
}  # fmt: skip
"""By wavelength over hull length: heave [m/m] and pitch [rad over k a] of a hull free in both."""

BARGE_FORCES = (
    (57515.5, 334628.7, 478877.7), (71287.4, 191682.5, 657127.5), (11367.97, 12438.2, 302751.1),
)  # fmt: skip
"""Froude-Krylov forces on the barge in surge [N/m], heave [N/m] and pitch [N m/m] in these
waves."""


def checks(wigley: Hull, quick: bool = False) -> Iterator[Check]:
    """Yield all checks, given the Wigley hull with its waterline at z = 0.

    quick: fewer heights, periods and wavelengths.
    """
    yield from _hydrostatics(wigley)
    yield from _pressures(wigley)
    yield from _pressures_above_a_bottom(quick)
    yield from _speeds()
    yield from _resistances()
    yield from _responses(wigley, (3.0, 1.0) if quick else tuple(WIGLEY_RESPONSES))
    yield from wide_bodies.checks(quick)


def wigley_scene(wigley: Hull, is_free: bool, custom: str = "", timestep: float = 0.002) -> Scene:
    """A scene in which the Wigley hull floats, freely or with joints for heave and pitch only.
    timestep [s]."""
    spec = mujoco.MjSpec.from_string(
        f'<mujoco><option timestep="{timestep}"/><custom>{custom}'
        '<tuple name="buoyant"><element objtype="geom" objname="hull"/></tuple></custom></mujoco>'
    )
    spec.add_mesh(
        name="wigley", uservert=wigley.vertices.ravel(), userface=wigley.faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT,
    )  # fmt: skip
    own = spec.worldbody.add_body(
        name="wigley", mass=WIGLEY_MASS, ipos=WIGLEY_CENTRE, inertia=WIGLEY_INERTIA,
        explicitinertial=True,
    )  # fmt: skip
    kinds = mujoco.mjtJoint
    if is_free:
        own.add_freejoint()
    else:
        own.add_joint(type=kinds.mjJNT_SLIDE, axis=[0, 0, 1], pos=WIGLEY_CENTRE)
        own.add_joint(type=kinds.mjJNT_HINGE, axis=[0, 1, 0], pos=WIGLEY_CENTRE)
    own.add_geom(name="hull", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="wigley", contype=0)
    return Scene.load(spec)


# Still water


def _hydrostatics(wigley: Hull) -> Iterator[Check]:
    def at_rest(name: str, scene: Scene) -> Callable[[], Rest]:
        return lambda: hydrostatics(scene, with_gz=False)[name].rest

    box = at_rest("box", scene_of(_box("1 0.5 0.2", 0.6)))
    ship = at_rest("wigley", wigley_scene(wigley, True))
    sphere = at_rest("sphere", scene_of(OES_SPHERE.format("<freejoint/>")))
    facets = 0.005
    for what, unit, found, key, value in (
        ("box 2 x 1 x 0.4 m: GM", "m", box, "gmt_m", 0.267222),
        ("box: heave period", "s", box, "heave_period_s", 0.982768),
        ("box: roll period", "s", box, "roll_period_s", 1.206556),
        ("Wigley 10 m: displacement", "m^3", ship, "displacement_m3", 2.777778),
        ("Wigley: draught", "m", ship, "draught_m", 0.625),
        ("Wigley: GMt", "m", ship, "gmt_m", 0.102768),
        ("Wigley: GMl", "m", ship, "gml_m", 11.966),
        ("Wigley: heave period", "s", ship, "heave_period_s", 1.2949),
        ("sphere 10 m: displacement", "m^3", sphere, "displacement_m3", 261.799),
        ("sphere: GM", "m", sphere, "gmt_m", 2.0),
    ):
        share = 1e-4 if found is box else 2.0 * facets if "GMt" in what else facets
        yield Check(
            "hydrostatics", what, unit, CLOSED_FORM, *about(value, share),
            lambda found=found, key=key: getattr(found(), key),
        )  # fmt: skip
    yield from _bound_bodies()
    for density, heel in ((0.22, 13.67), (0.24, 23.49), (0.27, 33.69)):
        bar = at_rest("box", scene_of(_box("5 0.5 0.5", density)))
        yield Check(
            "hydrostatics", f"square bar of relative density {density}: heel", "deg", CLOSED_FORM,
            heel - 0.01, heel + 0.01, lambda bar=bar: abs(bar().heel_deg),
        )  # fmt: skip


def _bound_bodies() -> Iterator[Check]:
    """A flap on a hinge at the bed, and a neutral vehicle under water."""
    height, draught, thickness, breadth, density = 9.0, 7.0, 1.0, 6.0, 300.0
    mass = density * breadth * thickness * height
    stiffness = DENSITY * GRAVITY * breadth * thickness * (draught**2 + thickness**2 / 6.0) / 2.0
    stiffness -= mass * GRAVITY * height / 2.0
    inertia = mass * (height**2 / 3.0 + thickness**2 / 12.0)
    flap = Once(lambda: hydrostatics(scene_of(FLAP), with_gz=False)["flap"].rest.joints[0])
    vehicle = Once(lambda: hydrostatics(scene_of(VEHICLE), with_gz=False)["vehicle"].submerged)
    weight = VEHICLE_MASS * GRAVITY
    for what, unit, value, found in (
        ("flap on a hinge: stiffness", "N m/rad", stiffness, lambda: flap()["stiffness"]),
        ("flap on a hinge: period", "s", 2.0 * np.pi * np.sqrt(inertia / stiffness),
         lambda: flap()["period_s"]),
        ("neutral vehicle, weight 0.02 m below its buoyancy: GM", "m", 0.02,
         lambda: vehicle().gmt_m),
        ("neutral vehicle: roll period", "s", 2.0 * np.pi * np.sqrt(0.4 / (0.02 * weight)),
         lambda: vehicle().roll_period_s),
    ):  # fmt: skip
        yield Check("hydrostatics", what, unit, CLOSED_FORM, *about(value, 0.005), found)


FLAP = """<body name="base" pos="0 0 -7"><body name="flap"><joint axis="0 1 0"/>
  <geom name="hull" type="box" pos="0 0 4.5" size="0.5 3 4.5" density="300"/></body></body>"""
VEHICLE_MASS = DENSITY * 4.0 / 3.0 * np.pi * 0.8 * 0.1 * 0.1  # [kg]
VEHICLE = f"""<body name="vehicle" pos="0 0 -3"><freejoint/>
  <geom name="hull" type="ellipsoid" size="0.8 0.1 0.1" mass="0"/>
  <inertial pos="0 0 -0.02" mass="{VEHICLE_MASS:.9g}" diaginertia="0.4 3 3"/></body>"""


def _box(size: str, density: float) -> str:
    return (
        f'<body name="box"><freejoint/><geom name="hull" type="box" size="{size}" '
        f'density="{density * DENSITY}"/></body>'
    )


# Pressure under small waves

BALL = '<body><freejoint/><geom name="hull" size="1"/></body>'


def first_harmonic(method: Method, wave: Wave, position: Array, depth: float = np.inf) -> Array:
    """Amplitude (6,) of the wrench's first harmonic, per metre of wave amplitude. depth [m]: of the
    water."""
    omega = np.sqrt(GRAVITY * wave.wavenumber * np.tanh(wave.wavenumber * depth))
    phases = 2.0 * np.pi * np.arange(16) / 16.0
    wrenches = [method.wrench(position, np.eye(3), phase / omega) for phase in phases]
    return np.abs(2.0 / 16.0 * np.exp(1j * phases) @ np.array(wrenches)) / wave.amplitude


def _pressures(wigley: Hull) -> Iterator[Check]:
    box, sphere = (
        scene_of(body).buoyancy.floats[0].method.hull for body in (_box("2 0.5 0.5", 0.5), BALL)
    )

    def pressed(hull: Hull, length: float, position: Array, axis: int) -> Callable[[], float]:
        wave = Wave(SMALL_AMPLITUDE, length)
        patches = partial(Patches, tolerance=1e-3 * SMALL_AMPLITUDE)
        fine = patches if len(hull.faces) < 100 else Linear
        return lambda: float(first_harmonic(fine(hull, Sea([wave])), wave, position)[axis])

    centre = np.array(WIGLEY_CENTRE)
    ship = Hull(wigley.vertices - centre, wigley.faces)
    origin, deep = np.zeros(3), np.array([0.0, 0.0, -2.0])
    for what, unit, source, value, share, found in (
        ("box 4 x 1 m, draught 0.5 m, waves of 8 m: heave", "N/m", CLOSED_FORM, 17289.64, 0.002,
         pressed(box, 8.0, origin, 2)),
        ("box: surge", "N/m", CLOSED_FORM, 8315.84, 0.002, pressed(box, 8.0, origin, 0)),
        ("sphere of 1 m, 2 m deep, waves of 8 m: heave", "N/m", CLOSED_FORM, 6876.749, 0.005,
         pressed(sphere, 8.0, deep, 2)),
        ("sphere: surge", "N/m", CLOSED_FORM, 6876.749, 0.005, pressed(sphere, 8.0, deep, 0)),
        ("Wigley, waves of 10 m: heave", "N/m", PANEL_CODE, 15775.0, 0.01,
         pressed(ship, 10.0, centre, 2)),
        ("Wigley, waves of 10 m: pitch", "N m/m", PANEL_CODE, 75160.0, 0.01,
         pressed(ship, 10.0, centre, 4)),
        ("Wigley, waves of 20 m: heave", "N/m", PANEL_CODE, 45575.0, 0.01,
         pressed(ship, 20.0, centre, 2)),
        ("Wigley, waves of 20 m: pitch", "N m/m", PANEL_CODE, 77053.0, 0.01,
         pressed(ship, 20.0, centre, 4)),
    ):  # fmt: skip
        yield Check("linear Froude-Krylov", what, unit, source, *about(value, share), found)


def _pressures_above_a_bottom(is_quick: bool) -> Iterator[Check]:
    """The barge's, at small amplitude."""
    hull = box(5.0, 2.0, 0.75).moved(np.eye(3), np.array([0.0, 0.0, 0.1]))
    position = np.array([0.0, 0.0, -0.35])  # of the centre of mass at rest

    def pressed(phase: float) -> tuple[float, ...]:
        wave = Wave(SMALL_AMPLITUDE, 2.0 * np.pi * SHALLOW / phase)
        method = Patches(hull, Sea([wave], depth=SHALLOW), tolerance=1e-3 * SMALL_AMPLITUDE)
        return tuple(first_harmonic(method, wave, position, SHALLOW))

    for phase, forces in zip(SHALLOW_PHASES, BARGE_FORCES, strict=True):
        if is_quick and phase != SHALLOW_PHASES[1]:
            continue
        found = Once(partial(pressed, phase))
        for axis, name, unit, force in zip(
            (0, 2, 4), ("surge", "heave", "pitch"), ("N/m", "N/m", "N m/m"), forces, strict=True
        ):
            yield Check(
                "linear Froude-Krylov", f"barge above a bottom, k H {phase:g}: {name}", unit,
                PANEL_CODE, *about(force, 0.01), lambda found=found, axis=axis: found()[axis],
            )  # fmt: skip


# Speeds


def _speeds() -> Iterator[Check]:
    """A ball with form drag only: half of its coefficient comes from the front, half from the
    back."""
    radius, coefficient = 0.1, 0.47
    for what, density, depth in (("light ball rises", 0.5, -60.0), ("heavy ball sinks", 2.0, -5.0)):
        push = abs(1.0 - density) * 4.0 / 3.0 * np.pi * radius**3 * GRAVITY
        speed = np.sqrt(2.0 * push / (coefficient * np.pi * radius**2))
        yield Check(
            "terminal speed", f"{what}: 0.2 m, relative density {density:g}, C 0.47", "m/s",
            CLOSED_FORM, *about(speed, 0.02),
            lambda density=density, depth=depth: _terminal_speed(radius, density, depth),
        )  # fmt: skip


def _terminal_speed(radius: float, density: float, depth: float) -> float:
    body = (
        f'<body pos="0 0 {depth}"><joint type="slide" axis="0 0 1"/>'
        f'<geom name="hull" size="{radius}" density="{density * DENSITY}"/></body>'
    )
    scene = scene_of(body, '<numeric name="drag" data="0.2 0.94 0"/>', 'timestep="0.005"')
    for _ in simulate(scene, 5.0, 1.0):
        pass
    return abs(float(scene.data.qvel[0]))


# Resistance


def _resistances() -> Iterator[Check]:
    for integrator in ("Euler", "implicitfast", "RK4"):
        yield Check(
            "resistance", f"added mass alone, ball let go at its radius, {integrator}: swing after "
            "60 s at 10 ms", "of it", CLOSED_FORM, *about(1.0, 0.001), partial(swing, integrator),
        )  # fmt: skip
    k, radius, draught = 2.0 * np.pi / 20.0, 0.15, 3.0
    acceleration = GRAVITY * k * (1.0 - np.exp(-k * draught)) / (k * draught)
    force = 2.0 * DENSITY * np.pi * radius**2 * draught * acceleration
    yield Check(
        "resistance", "cylinder of 0.3 m, draught 3 m, freeboard 1 m, waves of 20 m: surge", "N/m",
        "Morison 1950", *about(force, 0.01), cylinder_force,
    )  # fmt: skip
    speed = np.sqrt(GRAVITY * DRIFT_WAVE.wavenumber) * DRIFT_WAVE.wavenumber
    yield Check(
        "resistance", "strongly dragged ball of a 40th of the wavelength: Stokes drift", "m/s",
        "Stokes 1847", *about(speed * DRIFT_WAVE.amplitude**2, 0.05), drift_speed,
    )  # fmt: skip


def swing(integrator: str) -> float:
    """Distance between highest and lowest place of a ball over that at the start, after a minute.
    In each swing it leaves the water and enters it, which doubles its inertia."""
    body = '<body pos="0 0 0.5"><freejoint/><geom name="hull" size="0.5" density="512.5"/></body>'
    custom = numeric("added_mass", 0.5, 0.5, 0.5, 0, 0, 0)
    scene = scene_of(body, custom, f'timestep="0.01" integrator="{integrator}"')
    mujoco.mj_step(scene.model, scene.data, nstep=5700)
    heights = [s.positions[0, 2] for s in simulate(scene, 3.0, 100.0)]
    return float(np.ptp(heights))


def cylinder_force(amplitude: float = 0.05) -> float:
    """Force [N/m] of waves of 20 m along x on a cylinder that is held. amplitude [m]: of the
    waves."""
    body = (
        '<body pos="0 0 -1"><freejoint/><body/>'
        '<geom name="hull" type="cylinder" size="0.15 2" density="768.75"/></body>'
    )
    custom = numeric("added_mass", 1, 1, 0, 0, 0, 0) + numeric("wave_a", amplitude, 20, 0, 0)
    scene = scene_of(body, custom)
    count, period = 8, 2.0 * np.pi / np.sqrt(GRAVITY * 2.0 * np.pi / 20.0)
    forces = []
    for scene.data.time in np.arange(count) * period / count:
        mujoco.mj_forward(scene.model, scene.data)
        forces.append(scene.data.xfrc_applied[1, 0])
    return float(2.0 / count * np.abs(np.fft.fft(forces)[1]) / amplitude)


DRIFT_WAVE = Wave(0.1, 4.0)


def drift_speed() -> float:
    """Drift [m/s] of a ball's label in the waves, which drifts steadily, unlike its place."""
    a, k = DRIFT_WAVE.amplitude, DRIFT_WAVE.wavenumber
    omega = np.sqrt(GRAVITY * k)
    custom = numeric("wave_a", a, DRIFT_WAVE.wavelength, 0, 0) + numeric("water_stokes", 1)
    body = '<body><freejoint/><geom name="hull" size="0.05" density="512.5"/></body>'
    option = 'timestep="0.01" integrator="implicitfast"'
    scene = scene_of(body, custom + numeric("drag", 5, 50, 0), option)
    track = []
    for sample in simulate(scene, 9.0, 20.0):
        x = label = sample.positions[0, 0]
        for _ in range(30):
            label = x - a * np.cos(k * label - omega * sample.time)
        track.append((sample.time, label))
    return float(np.polyfit(*np.transpose(track[-120:]), 1)[0])


# Response in waves


def _responses(wigley: Hull, ratios: tuple[float, ...]) -> Iterator[Check]:
    for ratio in ratios:
        found = Once(lambda ratio=ratio: wigley_response(wigley, ratio))
        for which, (name, unit) in enumerate((("heave", "m/m"), ("pitch", "rad/ka"))):
            yield Check(
                "response in head waves", f"Wigley, wavelength {ratio:g} lengths: {name}", unit,
                PANEL_CODE, *about(WIGLEY_RESPONSES[ratio][which], 0.05),
                lambda found=found, which=which: found()[which],
            )  # fmt: skip


def wigley_stiffness(wigley: Hull) -> Array:
    """Hydrostatic stiffness (2, 2) [N/m, N, N m] in heave and pitch about the centre of mass."""
    found = hydrostatics(wigley_scene(wigley, True), with_gz=False)["wigley"].rest
    return np.array(found.stiffness)[2:5:2, 2:5:2]


def wigley_response(wigley: Hull, ratio: float, amplitude: float = 0.02) -> tuple[float, float]:
    """Heave [m/m] and pitch [rad over k a] in head waves.

    ratio: wavelength over the hull's length. amplitude [m]: of the waves. The hull is free in heave
    and pitch only and has WIGLEY_ADDED_MASS and WIGLEY_DAMPING.
    """
    wave = Wave(amplitude, ratio * float(np.ptp(wigley.bounds[:, 0])), heading=np.pi)
    omega = np.sqrt(GRAVITY * wave.wavenumber)
    matrices = np.zeros((2, 6, 6))
    matrices[:, [[0], [2], [4]], [0, 2, 4]] = WIGLEY_ADDED_MASS, WIGLEY_DAMPING
    custom = (
        LINEAR_METHOD
        + numeric("wave_head", amplitude, wave.wavelength, 180, 0)
        + numeric("added_mass", matrices[0])
        + numeric("damping", matrices[1])
    )
    scene = wigley_scene(wigley, False, custom, 0.01)
    period = 2.0 * np.pi / omega
    track = np.array(
        [(s.time, *scene.data.qpos[:2]) for s in simulate(scene, 14.0 + 3.0 * period, 30.0)]
    )
    settled = track[track[:, 0] > 14.0]
    heave, pitch = amplitudes(settled, omega) / amplitude
    return float(heave), float(pitch / wave.wavenumber)
