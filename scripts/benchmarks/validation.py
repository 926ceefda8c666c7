"""Validation: checks of this package against published results and closed forms.

The Wigley hull's added mass, damping and responses below were computed with the panel code
Capytaine; `validate.py --panel-code` computes them again. The checks run without Capytaine.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.hulls.hull import Hull
from sim.methods import Linear, Method, Patches
from sim.runs.simulation import simulate
from sim.scenes.hydrostatics import hydrostatics
from sim.scenes.scene import Scene
from sim.statics.report import Rest
from sim.water.sea import Sea
from sim.water.wave import Wave

Array = NDArray[np.float64]

DENSITY, GRAVITY = 1025.0, 9.81

SMALL_AMPLITUDE = 0.01
"""Amplitude [m] of waves so small that first-order theory holds to 1e-3."""

CLOSED_FORM, PANEL_CODE, OES = "closed form", "panel code", "OES Task 10"

WIGLEY_MASS, WIGLEY_CENTRE = 2847.22, (0.0, 0.0, -0.2)
WIGLEY_INERTIA = (455.6, 17795.0, 17795.0)

WIGLEY_ADDED_MASS = ((52.76, 0.0, 554.67), (0.0, 1881.98, 0.0), (554.67, 0.0, 10654.06))
WIGLEY_DAMPING = ((149.59, 0.0, 1810.14), (0.0, 6629.17, 0.0), (1810.14, 0.0, 22351.99))
"""Added mass [kg, kg m, kg m^2] and damping [N s/m, N s, N m s] of the Wigley hull in surge, heave
and pitch about its centre of mass, in a wave of its own length; used for all wavelengths."""

WIGLEY_RESPONSES = {
    3.0: (0.901, 0.984), 2.0: (0.783, 0.918), 1.5: (0.629, 0.820), 1.2: (0.462, 0.694),
    1.0: (0.304, 0.550), 0.9: (0.216, 0.452),
}  # fmt: skip
"""By wavelength over hull length: heave [m/m] and pitch [rad over k a] of a hull free in both."""

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
    yield from _speeds()
    yield from _decays((1.0,) if quick else (1.0, 3.0, 5.0))
    yield from _responses(wigley, (3.0, 1.0) if quick else tuple(WIGLEY_RESPONSES))


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


def first_harmonic(method: Method, wave: Wave, position: Array) -> Array:
    """Amplitude (6,) of the wrench's first harmonic, per metre of wave amplitude."""
    omega = np.sqrt(GRAVITY * wave.wavenumber)
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
    custom = "".join(
        f'<numeric name="{name}" data="{" ".join(map(str, matrix))}"/>'
        for name, matrix in (("added_mass", added), ("damping", damping))
    )
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
    custom = f'<numeric name="wave_head" data="{amplitude} {wave.wavelength} 180 0"/>' + "".join(
        f'<numeric name="{name}" data="{" ".join(map(str, m.ravel()))}"/>'
        for name, m in zip(("added_mass", "damping"), matrices, strict=True)
    )
    scene = scene_of("heave and pitch", LINEAR_METHOD + custom, 'timestep="0.01"', wigley)
    period = 2.0 * np.pi / omega
    track = np.array(
        [(s.time, *scene.data.qpos[:2]) for s in simulate(scene, 14.0 + 3.0 * period, 30.0)]
    )
    settled = track[track[:, 0] > 14.0]
    turns = omega * settled[:, 0]
    basis = np.stack([np.cos(turns), np.sin(turns), np.ones_like(turns)], axis=1)
    fitted, *_ = np.linalg.lstsq(basis, settled[:, 1:], rcond=None)
    heave, pitch = np.hypot(*fitted[:2]) / amplitude
    return float(heave), float(pitch / wave.wavenumber)
