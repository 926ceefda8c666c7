"""Validation: checks of this package against published results and closed forms.

The numbers of the Wigley hull, the barge and the sphere below that come from a panel code were
computed with Capytaine; `validate.py --panel-code` computes them again. The checks run without it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.hulls.hull import Hull
from sim.hulls.primitives import box
from sim.methods import Linear, Method, Patches
from sim.resistance.hydrodynamics import Hydrodynamics
from sim.runs.simulation import simulate
from sim.scenes.hydrostatics import hydrostatics
from sim.scenes.scene import Scene
from sim.statics.report import Rest
from sim.water.sea import Sea
from sim.water.wave import Wave, shortening

Array = NDArray[np.float64]

DENSITY, GRAVITY = 1025.0, 9.81

SMALL_AMPLITUDE = 0.01
"""Amplitude [m] of waves so small that first-order theory holds to 1e-3."""

CLOSED_FORM, PANEL_CODE, OES = "closed form", "panel code", "OES Task 10"

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

HULME = (
    (0.1, 0.8627, 0.1816), (0.2, 0.7938, 0.2793), (0.4, 0.6452, 0.3410), (0.6, 0.5381, 0.3271),
    (1.0, 0.4284, 0.2484), (2.0, 0.3884, 0.1031), (5.0, 0.4471, 0.0116),
)  # fmt: skip
"""Heaving hemisphere by Hulme 1982: k times radius, added mass over the displaced mass, damping
over the displaced mass and omega."""

SHALLOW, SHALLOW_PHASES, BARGE_PERIOD = 3.0, (0.5, 1.0, 2.0), 8.0
"""Depth [m] under the barge of models/barge.xml, k times depth of the waves whose pressure is
compared, and the period [s] of those in which it floats freely."""

HULME_ERROR = 0.015
"""Error of the memory that is accepted in these numbers."""

SPHERE_MEMORY = ((0.75898, 0.8709, 0.18188), (1.61706, 0.8089, 0.16193), (3.13618, 0.8813, 0.10264))
SPHERE_ADDED_MASS_INF = 0.5014
SPHERE_DIFFRACTION, SPHERE_RESPONSE = -0.1880 - 0.1860j, 1.855
"""Heave of the sphere of OES Task 10: columns a0 [1/s^2], a1 [1/s] and l^2 over mass of its memory,
added mass over mass at infinite frequency, and in waves of three diameters the diffraction force
over rho g times waterplane [m/m] and the response [m/m]."""

BARGE_FORCES = (
    (57515.5, 334628.7, 478877.7), (71287.4, 191682.5, 657127.5), (11367.97, 12438.2, 302751.1),
)  # fmt: skip
"""Froude-Krylov forces on the barge in surge [N/m], heave [N/m] and pitch [N m/m] in these
waves."""

BARGE_ADDED_MASS = ((10235.1, 0.0, 33677.0), (0.0, 110676.1, 0.0), (33677.0, 0.0, 611395.1))
BARGE_DAMPING = ((1533.2, 0.0, 10700.7), (0.0, 74668.6, 0.0), (10700.7, 0.0, 74698.9))
BARGE_RESPONSE = (2.0551, 0.1475)
"""The barge in waves of 8 s: added mass [kg, kg m, kg m^2] and damping [N s/m, N s, N m s] in
surge, heave and pitch about its centre of mass, and its surge [m/m] and pitch [rad/m]."""

LINEAR_METHOD = '<text name="buoyancy_method" data="linear"/>'
"""Patches with the default tolerance, 1/400 of the hull's length, miss waves this small."""

SPHERE_ADDED_MASS, SPHERE_DAMPING = 0.4325, 91.0e3
"""Added mass over mass, and damping [N s/m] in water of 1000 kg/m^3, of the sphere of OES Task 10
at its natural frequency."""


@dataclass(frozen=True)
class Check:
    """A quantity, its unit, and the source and bounds of its expected value.

    known_gap: why the quantity is known to miss the bounds; empty if it must be within them.
    """

    group: str
    what: str
    unit: str
    source: str
    low: float
    high: float
    measure: Callable[[], float]
    known_gap: str = ""

    def verdict(self, found: float) -> str:
        if self.low <= found <= self.high:
            return "holds"
        bound = self.low if found < self.low else self.high
        off = f"off by {100.0 * (found / bound - 1.0):+.1f} %"
        return f"{off}: {self.known_gap}" if self.known_gap else off


def about(value: float, share: float) -> tuple[float, float]:
    """The band within a share of a value, for sources that give a single number."""
    return tuple(sorted((value * (1.0 - share), value * (1.0 + share))))


def checks(wigley: Hull, quick: bool = False) -> Iterator[Check]:
    """Yield all checks, given the Wigley hull with its waterline at z = 0.

    quick: fewer heights of decay and fewer wavelengths.
    """
    yield from _hydrostatics(wigley)
    yield from _pressures(wigley)
    yield from _pressures_above_a_bottom(quick)
    yield from _speeds()
    yield from _decays((1.0,) if quick else (1.0, 3.0, 5.0))
    yield from _responses(wigley, (3.0, 1.0) if quick else tuple(WIGLEY_RESPONSES))
    yield from _wide_responses()


# Scenes


def scene_of(body: str, custom: str = "", option: str = "", wigley: Hull | None = None) -> Scene:
    """A scene in which the geom 'hull' floats.

    body: MJCF of the body. If a Wigley hull is given, that hull floats instead, with a free joint
    if `body` is "free", else with joints for heave and pitch only.
    """
    spec = mujoco.MjSpec.from_string(
        f"<mujoco><option {option}/><custom>{custom}"
        '<tuple name="buoyant"><element objtype="geom" objname="hull" prm="0"/></tuple></custom>'
        f"<worldbody>{body if wigley is None else ''}</worldbody></mujoco>"
    )
    if wigley is not None:
        spec.add_mesh(
            name="wigley", uservert=wigley.vertices.ravel(), userface=wigley.faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT,
        )  # fmt: skip
        own = spec.worldbody.add_body(
            name="wigley", mass=WIGLEY_MASS, ipos=WIGLEY_CENTRE, inertia=WIGLEY_INERTIA,
            explicitinertial=True,
        )  # fmt: skip
        kinds = mujoco.mjtJoint
        if body == "free":
            own.add_freejoint()
        else:
            own.add_joint(type=kinds.mjJNT_SLIDE, axis=[0, 0, 1], pos=WIGLEY_CENTRE)
            own.add_joint(type=kinds.mjJNT_HINGE, axis=[0, 1, 0], pos=WIGLEY_CENTRE)
        own.add_geom(name="hull", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="wigley", contype=0)
    return Scene.load(spec)


def _matrices(added_mass: Array, damping: Array) -> str:
    """The custom elements of matrices of 36 numbers."""
    return "".join(
        f'<numeric name="{name}" data="{" ".join(map(str, matrix.ravel()))}"/>'
        for name, matrix in (("added_mass", added_mass), ("damping", damping))
    )


# Still water


def _hydrostatics(wigley: Hull) -> Iterator[Check]:
    def at_rest(name: str, body: str, hull: Hull | None = None) -> Callable[[], Rest]:
        return lambda: hydrostatics(scene_of(body, wigley=hull), with_gz=False)[name].rest

    box = at_rest("box", _box("1 0.5 0.2", 0.6))
    ship = at_rest("wigley", "free", wigley)
    sphere = at_rest("sphere", OES_SPHERE.format("<freejoint/>"))
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
    for density, heel in ((0.22, 13.67), (0.24, 23.49), (0.27, 33.69)):
        bar = at_rest("box", _box("5 0.5 0.5", density))
        yield Check(
            "hydrostatics", f"square bar of relative density {density}: heel", "deg", CLOSED_FORM,
            heel - 0.01, heel + 0.01, lambda bar=bar: abs(bar().heel_deg),
        )  # fmt: skip


def _box(size: str, density: float) -> str:
    return (
        f'<body name="box"><freejoint/><geom name="hull" type="box" size="{size}" '
        f'density="{density * DENSITY}"/></body>'
    )


SPHERE_MASS = DENSITY * np.pi * 250.0 / 3.0  # [kg]
OES_SPHERE = f"""<body name="sphere">{{}}<geom name="hull" size="5"/>
  <inertial pos="0 0 -2" mass="{SPHERE_MASS:.6f}" diaginertia="1e6 1e6 1e6"/></body>"""
"""The sphere of OES Task 10, half submerged in sea water; the joint is to be filled in."""


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
        found = _Once(partial(pressed, phase))
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


# Free decay


def _decays(heights: tuple[float, ...]) -> Iterator[Check]:
    for height in heights:
        memory = "radiated waves have no memory here"
        if height > 1.0:
            memory += ", and linear codes do not see the waterplane change"
        track = _Once(lambda height=height: _decay(height))
        source = OES if height == 1.0 else f"{OES}, linear codes"
        for what, unit, low, high, which, gap in (
            ("first trough", "of it", -0.892, -0.869, 0, memory),
            ("second peak", "of it", 0.341, 0.370, 1, memory),
            ("first trough at", "s", *about(2.23, 0.02), 2, memory),
            ("second peak at", "s", 8.66, 8.81, 3, memory),
        ):
            title = f"sphere let go {height:g} m up: {what}"
            yield Check(
                "heave decay", title, unit, source, low, high,
                lambda track=track, which=which: track()[which], gap,
            )  # fmt: skip


class _Once:
    """A measurement that runs once and serves several checks."""

    def __init__(self, work: Callable[[], tuple[float, ...]]) -> None:
        self._work, self._found = work, None

    def __call__(self) -> tuple[float, ...]:
        if self._found is None:
            self._found = self._work()
        return self._found


def _decay(height: float) -> tuple[float, float, float, float]:
    """First trough and second peak, relative to the initial height [m], and their times [s]."""
    added, damping = np.zeros(36), np.zeros(36)
    added[14], damping[14] = SPHERE_ADDED_MASS * SPHERE_MASS, SPHERE_DAMPING * DENSITY / 1000.0
    custom = _matrices(added, damping)
    joint = '<joint type="slide" axis="0 0 1"/>'
    scene = scene_of(OES_SPHERE.format(joint), custom, 'timestep="0.005"')
    scene.data.qpos[0] = height
    samples = [(s.time, s.positions[0, 2] / height) for s in simulate(scene, 14.0, 100.0)]
    times, heights = np.transpose(samples)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(heights)))) + 1
    trough, peak = turns[0], turns[3]
    return heights[trough], heights[peak], times[trough], times[peak]


# Response in waves


def _responses(wigley: Hull, ratios: tuple[float, ...]) -> Iterator[Check]:
    for ratio in ratios:
        found = _Once(lambda ratio=ratio: wigley_response(wigley, ratio))
        for which, (name, unit) in enumerate((("heave", "m/m"), ("pitch", "rad/ka"))):
            yield Check(
                "response in head waves", f"Wigley, wavelength {ratio:g} lengths: {name}", unit,
                PANEL_CODE, *about(WIGLEY_RESPONSES[ratio][which], 0.05),
                lambda found=found, which=which: found()[which],
            )  # fmt: skip


def wigley_stiffness(wigley: Hull) -> Array:
    """Hydrostatic stiffness (2, 2) [N/m, N, N m] in heave and pitch about the centre of mass."""
    found = hydrostatics(scene_of("free", wigley=wigley), with_gz=False)["wigley"].rest
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
    custom = f'<numeric name="wave_head" data="{amplitude} {wave.wavelength} 180 0"/>' + _matrices(
        *matrices
    )
    scene = scene_of("heave and pitch", LINEAR_METHOD + custom, 'timestep="0.01"', wigley)
    period = 2.0 * np.pi / omega
    track = np.array(
        [(s.time, *scene.data.qpos[:2]) for s in simulate(scene, 14.0 + 3.0 * period, 30.0)]
    )
    settled = track[track[:, 0] > 14.0]
    heave, pitch = amplitudes(settled, omega) / amplitude
    return float(heave), float(pitch / wave.wavenumber)


def _wide_responses() -> Iterator[Check]:
    for ka, added, damping in HULME:
        for name, value, which in (("added mass", added, 0), ("damping", damping, 1)):
            yield Check(
                "response of wide bodies", f"heaving hemisphere, k a {ka:g}: {name} of the memory",
                "", "Hulme 1982", value - HULME_ERROR, value + HULME_ERROR,
                lambda ka=ka, which=which: sphere_memory(ka)[which],
            )  # fmt: skip
    found = _Once(barge_response)
    for which, (name, unit) in enumerate((("surge", "m/m"), ("pitch", "rad/m"))):
        yield Check(
            "response of wide bodies", f"barge over 3 m of water, waves of 8 s: {name}", unit,
            PANEL_CODE, *about(BARGE_RESPONSE[which], 0.05),
            lambda found=found, which=which: found()[which],
        )  # fmt: skip
    yield Check(
        "response of wide bodies", "sphere 10 m, waves of three diameters: heave", "m/m",
        PANEL_CODE, *about(SPHERE_RESPONSE, 0.05), sphere_response,
    )  # fmt: skip


def amplitudes(track: Array, omega: float) -> Array:
    """Amplitudes (N,) of motions at a frequency [rad/s], besides a mean and a drift. track: rows of
    time [s] and N values."""
    turns = omega * track[:, 0]
    basis = np.stack([np.cos(turns), np.sin(turns), np.ones_like(turns), turns], axis=1)
    fitted, *_ = np.linalg.lstsq(basis, track[:, 1:], rcond=None)
    return np.hypot(*fitted[:2])


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
        f'<numeric name="water_depth" data="{SHALLOW}"/><numeric name="water_ramp" data="16"/>'
        f'<numeric name="wave_swell" data="{amplitude} {wavelength} 0 0"/>{LINEAR_METHOD}'
    ) + _matrices(*matrices)
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


def sphere_memory(ka: float) -> tuple[float, float]:
    """Added mass over the displaced mass, and damping over this and omega, that the sphere's memory
    gives at k times radius."""
    omega = np.sqrt(GRAVITY * ka / 5.0)
    a0, a1, c = np.transpose(SPHERE_MEMORY)
    K = np.sum(c * 1j * omega / (a0 - omega**2 + 1j * a1 * omega))
    return float(SPHERE_ADDED_MASS_INF + K.imag / omega), float(K.real / omega)


def sphere_response(amplitude: float = 0.1) -> float:
    """Heave [m/m] of the sphere of OES Task 10 in waves of three diameters, with memory and
    diffraction. amplitude [m]: of the waves."""
    wave = Wave(amplitude, 30.0)
    omega = np.sqrt(GRAVITY * wave.wavenumber)
    memory, added_mass = np.zeros((len(SPHERE_MEMORY), 8)), np.zeros((6, 6))
    memory[:, [0, 1, 4]] = SPHERE_MEMORY
    memory[:, 4] = np.sqrt(SPHERE_MASS * memory[:, 4])
    added_mass[2, 2] = SPHERE_ADDED_MASS_INF * SPHERE_MASS
    forces = np.zeros((1, 1, 6), dtype=complex)
    forces[0, 0, 2] = SPHERE_DIFFRACTION * DENSITY * GRAVITY * np.pi * 25.0
    own = Hydrodynamics(
        position=np.array([0.0, 0.0, -2.0]), rotation=np.eye(3), added_mass=added_mass,
        memory=memory, frequencies=np.array([omega]), headings=np.zeros(1), diffraction=forces,
        density=DENSITY, gravity=GRAVITY,
    )  # fmt: skip
    with TemporaryDirectory() as folder:
        own.save(Path(folder) / "sphere.npz")
        custom = (
            f'<text name="hydrodynamics_sphere" data="{folder}/sphere.npz"/>'
            f'<numeric name="wave_swell" data="{amplitude} 30 0 0"/>'
            f'<numeric name="water_ramp" data="10"/>'
        )
        joint = '<joint type="slide" axis="0 0 1"/>'
        scene = scene_of(OES_SPHERE.format(joint), custom, 'timestep="0.01"')
        track = np.array([(s.time, *scene.data.qpos) for s in simulate(scene, 70.0, 20.0)])
    return float(amplitudes(track[track[:, 0] > 40.0], omega)[0] / amplitude)
