"""Wide bodies: the rows of the validation about memory, diffraction and shallow water.

All coefficients below were computed with the panel code Capytaine; `validate.py --panel-code`
computes them again.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import manifold3d
import numpy as np
from numpy.typing import NDArray

from benchmarks.checks import (
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
from sim.resistance.hydrodynamics import Hydrodynamics
from sim.runs.simulation import simulate
from sim.scenes.scene import Scene
from sim.water.wave import shortening

Array = NDArray[np.float64]

OES, WEC_SIM = "OES Task 10", "WEC-Sim"

# The sphere of OES Task 10

SPHERE_MASS = DENSITY * np.pi * 250.0 / 3.0  # [kg]
OES_SPHERE = f"""<body name="sphere">{{}}<geom name="hull" size="5"/>
  <inertial pos="0 0 -2" mass="{SPHERE_MASS:.6f}" diaginertia="1e6 1e6 1e6"/></body>"""
"""The sphere of OES Task 10, half submerged in sea water; the joint is to be filled in."""

HEAVE_JOINT = '<joint type="slide" axis="0 0 1" damping="{}"/>'

SPHERE_MEMORY = ((0.75898, 0.8709, 0.18188), (1.61706, 0.8089, 0.16193), (3.13618, 0.8813, 0.10264))
SPHERE_ADDED_MASS_INF = 0.5014
"""Heave of the sphere: columns a0 [1/s^2], a1 [1/s] and l^2 over mass of its memory, and added mass
over mass at infinite frequency."""

SPHERE_DIFFRACTION = {
    11.0: -0.0891 - 0.0284j, 10.0: -0.1037 - 0.0381j, 9.0: -0.1208 - 0.0516j,
    8.0: -0.1406 - 0.0705j, 7.0: -0.1618 - 0.0966j, 6.0: -0.1814 - 0.1305j, 5.0: -0.1922 - 0.1683j,
    4.4: -0.1883 - 0.1857j, 4.3835: -0.1880 - 0.1860j, 4.0: -0.1781 - 0.1893j,
    3.0: -0.1097 - 0.1261j,
}  # fmt: skip
"""By period [s] of the waves: diffraction force in heave over rho g times waterplane [m/m]. Waves
of three diameters have 4.3835 s."""

SPHERE_RESPONSE = 1.855
"""Heave of the sphere in waves of three diameters [m/m]."""

DECAYS = (
    (1.0, f"{OES}, linear codes", ((0, -0.895, -0.855, 2.19, 2.25), (3, 0.330, 0.375, 8.65, 8.90))),
    (3.0, f"{OES}, linear codes to CFD of 5 m", ((0, -0.892, -0.843, 2.19, 2.50),)),
    (5.0, f"{OES}, CFD", (
        (0, *about(-0.843, 0.05), *about(2.50, 0.03)), (1, *about(0.586, 0.05), *about(4.91, 0.03)),
        (2, *about(-0.418, 0.05), *about(7.19, 0.03)),
    )),
)  # fmt: skip
"""By height [m] of the sphere at the start: turning points, as their number after the start, and
bounds of their heights over that at the start and of their times [s]."""

TURN_NAMES = ("first trough", "first peak", "second trough", "second peak")

OES_WAVES = {
    3.0: (398.736, 0.0788), 4.0: (118.150, 0.5886), 4.4: (90.081, 0.9401), 5.0: (161.049, 0.8307),
    6.0: (322.292, 0.7138), 7.0: (479.669, 0.6931), 8.0: (633.980, 0.6911), 9.0: (784.083, 0.6936),
    10.0: (932.118, 0.6960), 11.0: (1077.123, 0.6982),
}  # fmt: skip
"""By period [s] of regular waves of the height 0.004 g T^2: damper [kN s/m] between the sphere and
the ground, in water of 1000 kg/m^3, and heave [m/m] by WEC-Sim."""

HULME = (
    (0.1, 0.8627, 0.1816), (0.2, 0.7938, 0.2793), (0.4, 0.6452, 0.3410), (0.6, 0.5381, 0.3271),
    (1.0, 0.4284, 0.2484), (2.0, 0.3884, 0.1031), (5.0, 0.4471, 0.0116),
)  # fmt: skip
"""Heaving hemisphere by Hulme 1982: k times radius, added mass over the displaced mass, damping
over the displaced mass and omega."""

HULME_ERROR = 0.015
"""Error of the memory that is accepted in these numbers."""

# The barge of models/barge.xml

SHALLOW, SHALLOW_PHASES, BARGE_PERIOD = 3.0, (0.5, 1.0, 2.0), 8.0
"""Depth [m] under the barge, k times depth of the waves whose pressure is compared, and the period
[s] of those in which it floats freely."""

BARGE_ADDED_MASS = ((10235.1, 0.0, 33677.0), (0.0, 110676.1, 0.0), (33677.0, 0.0, 611395.1))
BARGE_DAMPING = ((1533.2, 0.0, 10700.7), (0.0, 74668.6, 0.0), (10700.7, 0.0, 74698.9))
BARGE_RESPONSE = (2.0551, 0.1475)
"""The barge in waves of 8 s: added mass [kg, kg m, kg m^2] and damping [N s/m, N s, N m s] in
surge, heave and pitch about its centre of mass, and its surge [m/m] and pitch [rad/m]."""

# Two examples of WEC-Sim, in water of 1000 kg/m^3

FLOAT_ADDED_MASS_INF = 1.2432e6
FLOAT_MEMORY = ((0.61458, 0.81162, 3.96222e5), (1.59638, 0.81969, 2.83203e5))
FLOAT_TURNS = ((2.58, -0.7916), (5.10, 0.4532), (7.50, -0.2613), (9.96, 0.1623))
"""The float of RM3 around a spar at rest: added mass [kg] at infinite frequency, and columns a0
[1/s^2], a1 [1/s] and l^2 [kg/s^2] of its memory in heave; and times [s] and heights, over that at
the start, of its turning points when it is let go and the spar is free."""

FLAP_MASS, FLAP_INERTIA, FLAP_DEPTH, FLAP_ADDED_MASS_INF = 127e3, 1.85e6, 10.9, 1.79749e7
FLAP_MEMORY = (
    (0.586870, 0.222604, 1.87313e6), (0.976880, 0.228401, 7.10519e6),
    (1.480123, 0.278648, 1.412997e7), (2.346412, 0.472705, 1.945172e7),
    (4.959444, 1.264738, 3.016864e7),
)  # fmt: skip
FLAP_TURNS = ((9.4, -0.15417), (19.1, 0.14514), (28.7, -0.13662))
"""The flap of OSWEC: mass [kg], inertia [kg m^2], depth of the water [m]; added mass [kg m^2] at
infinite frequency, and columns with l^2 [kg m^2/s^2] about its hinge, fitted with weights
1 / (B + 2 % of the largest K), because it swings more slowly than the waves that it makes best; and
times [s] and angles [rad] of its turning points when it is let go at 10 degrees."""


def checks(quick: bool) -> Iterator[Check]:
    """Yield all checks. quick: fewer heights and periods."""
    yield from _sphere_decays((1.0, 5.0) if quick else (1.0, 3.0, 5.0))
    yield from _wec_sim_decays()
    yield from _sphere_in_waves((3.0, 4.4, 8.0) if quick else tuple(OES_WAVES))
    yield from _other_responses()


# Free decay


def _sphere_decays(heights: Sequence[float]) -> Iterator[Check]:
    for height, source, turns in DECAYS:
        if height not in heights:
            continue
        found = Once(partial(sphere_decay, height))
        for turn, low, high, earliest, latest in turns:
            title = f"sphere let go {height:g} m up: {TURN_NAMES[turn]}"
            for name, unit, bounds, which in (
                ("", "of it", (low, high), 1), (" at", "s", (earliest, latest), 0),
            ):  # fmt: skip
                yield Check(
                    "free decay with memory", title + name, unit, source, *bounds,
                    lambda found=found, turn=turn, which=which: float(found()[turn, which]),
                )  # fmt: skip


def turning_points(scene: Scene, start: float, duration: float) -> Array:
    """Times [s] and positions, over that at the start, of the turning points (N, 2) of the first
    joint, let go at a position [m or rad]."""
    scene.data.qpos[0] = start
    track = np.array(
        [(s.time, scene.data.qpos[0] / start) for s in simulate(scene, duration, 100.0)]
    )
    return track[1:-1][np.diff(np.sign(np.diff(track[:, 1]))) != 0.0]


def memory_of(columns: Sequence[Sequence[float]], motion: int, mass: float = 1.0) -> Array:
    """The numbers (N, 8) of a memory in one of the six motions. columns: a0 [1/s^2], a1 [1/s] and
    l^2 over mass."""
    memory = np.zeros((len(columns), 8))
    memory[:, [0, 1, 2 + motion]] = columns
    memory[:, 2 + motion] = np.sqrt(mass * memory[:, 2 + motion])
    return memory


def one_entry(motion: int, value: float) -> Array:
    """A matrix (6, 6) with one entry on its diagonal."""
    matrix = np.zeros((6, 6))
    matrix[motion, motion] = value
    return matrix


def sphere_decay(height: float) -> Array:
    """Turning points of the sphere, let go at a height [m]."""
    body = OES_SPHERE.format(HEAVE_JOINT.format(0))
    return turning_points(scene_of(body, sphere_memory_fields(), 'timestep="0.01"'), height, 10.0)


def sphere_memory_fields() -> str:
    """The custom elements of the sphere's added mass and memory."""
    added = numeric("added_mass", one_entry(2, SPHERE_ADDED_MASS_INF * SPHERE_MASS))
    return added + numeric("memory_sphere", memory_of(SPHERE_MEMORY, 2, SPHERE_MASS))


def _wec_sim_decays() -> Iterator[Check]:
    for title, unit, decay, turns, per_unit, shares in (
        ("RM3, float let go 0.1 m up", "of it", float_decay, FLOAT_TURNS, 1.0, (0.05, 0.02)),
        ("OSWEC, flap let go at 10 deg", "rad", flap_decay, FLAP_TURNS, np.radians(10.0),
         (0.05, 0.02)),
    ):  # fmt: skip
        found = Once(decay)
        for turn, (time, value) in enumerate(turns):
            for name, of, expected, which in (("", unit, value, 1), (" at", "s", time, 0)):
                scale = per_unit if which else 1.0
                yield Check(
                    "free decay with memory", f"{title}: {TURN_NAMES[turn]}{name}", of, WEC_SIM,
                    *about(expected, shares[1 - which]),
                    lambda found=found, turn=turn, which=which, scale=scale: (
                        scale * float(found()[turn, which])
                    ),
                )  # fmt: skip


def float_decay() -> Array:
    """Turning points of the float of RM3, let go 0.1 m up around a spar of 3 m radius, without a
    gap between them. The spar, which would move by a few hundredths of this, is left out."""
    profile = ((3.0, -3.0), (5.0, -3.0), (10.0, -2.0), (10.0, 2.0), (3.0, 2.0))
    solid = manifold3d.Manifold.revolve(manifold3d.CrossSection([profile]), 96)
    mesh, mass = solid.to_mesh64(), 1000.0 * solid.trim_by_plane((0.0, 0.0, -1.0), 0.0).volume()
    vertices = " ".join(f"{v:.6g}" for v in np.array(mesh.vert_properties)[:, :3].ravel())
    faces = " ".join(map(str, np.array(mesh.tri_verts).ravel()))
    body = (
        f'<body name="float">{HEAVE_JOINT.format(0)}<geom name="hull" type="mesh" mesh="float"/>'
        f'<inertial pos="0 0 -0.72" mass="{mass}" diaginertia="2e7 2e7 3e7"/></body>'
    )
    custom = (
        numeric("water_density", 1000)
        + numeric("added_mass", one_entry(2, FLOAT_ADDED_MASS_INF))
        + numeric("memory_float", memory_of(FLOAT_MEMORY, 2))
    )
    asset = f'<mesh name="float" inertia="exact" vertex="{vertices}" face="{faces}"/>'
    scene = scene_of(body, custom, 'timestep="0.01"', asset=asset)
    return turning_points(scene, 0.1, 11.0)


def flap_decay() -> Array:
    """Turning points of the flap of OSWEC, let go at 10 degrees: a plate of 18 x 1.8 m with a round
    lower edge, on a hinge 8.9 m deep, with its centre of mass 3.9 m deep."""
    inertia = " ".join([str(FLAP_INERTIA)] * 3)
    body = (
        '<body name="flap" pos="0 0 -8.9"><joint axis="0 1 0"/>'
        '<geom name="plate" type="box" pos="0 0 5.7" size="0.9 9 5.3"/>'
        '<geom name="edge" type="cylinder" fromto="0 -9 0.4 0 9 0.4" size="0.9"/>'
        f'<inertial pos="0 0 5" mass="{FLAP_MASS}" diaginertia="{inertia}"/></body>'
    )
    own = Hydrodynamics(
        position=np.array([0.0, 0.0, 5.0]), rotation=np.eye(3),
        added_mass=one_entry(4, FLAP_ADDED_MASS_INF), memory=memory_of(FLAP_MEMORY, 4),
        frequencies=np.zeros(0), headings=np.zeros(0), diffraction=np.zeros((0, 0, 6)),
        density=1000.0, gravity=GRAVITY, depth=FLAP_DEPTH,
    )  # fmt: skip
    with TemporaryDirectory() as folder:
        own.save(Path(folder) / "flap.npz")
        custom = (
            f'<text name="hydrodynamics_flap" data="{folder}/flap.npz"/>'
            + numeric("water_density", 1000)
            + numeric("water_depth", FLAP_DEPTH)
        )
        scene = scene_of(body, custom, 'timestep="0.02"', ("plate", "edge"))
        return turning_points(scene, np.radians(10.0), 30.0)


# Response in waves


def _sphere_in_waves(periods: Sequence[float]) -> Iterator[Check]:
    for has_diffraction, fields in ((True, "memory and diffraction"), (False, "memory alone")):
        for period in periods:
            is_scattered = not has_diffraction and period < 5.0
            yield Check(
                "response of wide bodies",
                f"sphere with a damper, waves of {period:g} s, {fields}: heave", "m/m",
                f"{WEC_SIM}, {OES}", *about(OES_WAVES[period][1], 0.12 if period == 3.0 else 0.03),
                partial(damped_response, period, has_diffraction), SCATTERED * is_scattered,
            )  # fmt: skip
    yield Check(
        "response of wide bodies", "sphere 10 m, waves of three diameters: heave", "m/m",
        PANEL_CODE, *about(SPHERE_RESPONSE, 0.05), partial(sphere_response, 30.0, 0.1),
    )  # fmt: skip


SCATTERED = "a body this wide scatters waves this short, which needs hydrodynamics_<body>"


def damped_response(period: float, has_diffraction: bool = True) -> float:
    """Heave [m/m] of the sphere in the waves of OES_WAVES."""
    wavelength = GRAVITY * period**2 / (2.0 * np.pi)
    damper = 1000.0 * OES_WAVES[period][0] * DENSITY / 1000.0
    return sphere_response(wavelength, 0.002 * GRAVITY * period**2, damper, has_diffraction)


def sphere_response(
    wavelength: float, amplitude: float, damper: float = 0.0, has_diffraction: bool = True
) -> float:
    """Heave [m/m] of the sphere. wavelength, amplitude [m]: of the waves. damper [N s/m]: between
    the sphere and the ground. Without diffraction, its memory acts on the motion relative to the
    water."""
    omega = np.sqrt(2.0 * np.pi * GRAVITY / wavelength)
    custom = numeric("wave_swell", amplitude, wavelength, 0, 0) + numeric("water_ramp", 10)
    with TemporaryDirectory() as folder:
        if has_diffraction:
            sphere_coefficients().save(Path(folder) / "sphere.npz")
            custom += f'<text name="hydrodynamics_sphere" data="{folder}/sphere.npz"/>'
        else:
            custom += sphere_memory_fields()
        body = OES_SPHERE.format(HEAVE_JOINT.format(damper))
        scene = scene_of(body, custom, 'timestep="0.02"')
        duration = 40.0 + 8.0 * np.pi / omega
        track = np.array([(s.time, *scene.data.qpos) for s in simulate(scene, duration, 20.0)])
    return float(amplitudes(track[track[:, 0] > 40.0], omega)[0] / amplitude)


def sphere_coefficients() -> Hydrodynamics:
    """The sphere's coefficients in heave, as a file has them."""
    periods = sorted(SPHERE_DIFFRACTION, reverse=True)
    forces = np.zeros((len(periods), 1, 6), dtype=complex)
    forces[:, 0, 2] = [SPHERE_DIFFRACTION[period] for period in periods]
    return Hydrodynamics(
        position=np.array([0.0, 0.0, -2.0]), rotation=np.eye(3),
        added_mass=one_entry(2, SPHERE_ADDED_MASS_INF * SPHERE_MASS),
        memory=memory_of(SPHERE_MEMORY, 2, SPHERE_MASS),
        frequencies=2.0 * np.pi / np.array(periods), headings=np.zeros(1),
        diffraction=forces * DENSITY * GRAVITY * np.pi * 25.0, density=DENSITY, gravity=GRAVITY,
    )  # fmt: skip


def _other_responses() -> Iterator[Check]:
    for ka, added, damping in HULME:
        for name, value, which in (("added mass", added, 0), ("damping", damping, 1)):
            yield Check(
                "response of wide bodies", f"heaving hemisphere, k a {ka:g}: {name} of the memory",
                "", "Hulme 1982", value - HULME_ERROR, value + HULME_ERROR,
                lambda ka=ka, which=which: sphere_memory(ka)[which],
            )  # fmt: skip
    found = Once(barge_response)
    for which, (name, unit) in enumerate((("surge", "m/m"), ("pitch", "rad/m"))):
        yield Check(
            "response of wide bodies", f"barge over 3 m of water, waves of 8 s: {name}", unit,
            PANEL_CODE, *about(BARGE_RESPONSE[which], 0.05),
            lambda found=found, which=which: found()[which],
        )  # fmt: skip


def sphere_memory(ka: float) -> tuple[float, float]:
    """Added mass over the displaced mass, and damping over this and omega, that the sphere's memory
    gives at k times radius."""
    omega = np.sqrt(GRAVITY * ka / 5.0)
    a0, a1, c = np.transpose(SPHERE_MEMORY)
    K = np.sum(c * 1j * omega / (a0 - omega**2 + 1j * a1 * omega))
    return float(SPHERE_ADDED_MASS_INF + K.imag / omega), float(K.real / omega)


def barge_response(amplitude: float = 0.02) -> tuple[float, float]:
    """Surge [m/m] and pitch [rad/m] of the barge of models/barge.xml over 3 m of water, in waves of
    8 s from behind. amplitude [m]: of the waves. The barge is free in surge, heave and pitch, with
    the panel code's added mass and damping at this period and without diffraction."""
    omega = 2.0 * np.pi / BARGE_PERIOD
    deep = omega**2 / GRAVITY
    wavelength = float(2.0 * np.pi / deep * shortening(np.array([deep]), SHALLOW)[0])
    matrices = np.zeros((2, 6, 6))
    matrices[:, [[0], [2], [4]], [0, 2, 4]] = BARGE_ADDED_MASS, BARGE_DAMPING
    custom = (
        LINEAR_METHOD
        + numeric("water_depth", SHALLOW)
        + numeric("water_ramp", 16)
        + numeric("wave_swell", amplitude, wavelength, 0, 0)
        + numeric("added_mass", matrices[0])
        + numeric("damping", matrices[1])
    )
    joints = "".join(
        f'<joint type="{kind}" axis="{axis}" pos="0 0 -0.1"/>'
        for kind, axis in (("slide", "1 0 0"), ("slide", "0 0 1"), ("hinge", "0 1 0"))
    )
    body = (
        f'<body pos="0 0 -0.25">{joints}<geom name="hull" type="box" size="5 2 0.75"/><inertial '
        'pos="0 0 -0.1" mass="41000" diaginertia="105000 350000 396000"/></body>'
    )
    scene = scene_of(body, custom, 'timestep="0.02"')
    track = np.array([(s.time, *scene.data.qpos[[0, 2]]) for s in simulate(scene, 72.0, 10.0)])
    surge, pitch = amplitudes(track[track[:, 0] > 48.0], omega) / amplitude
    return float(surge), float(pitch)
