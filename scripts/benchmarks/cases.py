"""Cases that are hard for a simulation of floating bodies, and the result that each must have."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.judges import (
    Judge,
    Run,
    apex,
    conserves,
    departure,
    distance_from_surface,
    energy_growth,
    final_speed,
    final_tilt,
    final_velocity,
    flat_tilt,
    heave,
    highest,
    kinetic_energy,
    mean_fraction,
    rise,
    same_as,
    symmetry,
    weight_times_30_cm,
)  # fmt: skip
from sim.runs.divergence import DivergenceError
from sim.runs.simulation import simulate
from sim.scenes.scene import Scene

Array = NDArray[np.float64]

DENSITY, GRAVITY = 1025.0, 9.81  # [kg/m^3], [m/s^2]
DRAG = '<numeric name="drag" data="0.2 1.0 0.005"/>'
ADDED_MASS = '<numeric name="added_mass" data="0.5 0.5 0.5 0 0 0"/>'
DRAG_AND_ADDED_MASS = DRAG + ADDED_MASS


@dataclass(frozen=True)
class Case:
    """A scene and the largest error that it may have.

    expects: the expected result and the unit of the error, in words. bodies, custom, assets: MJCF
    elements. option: attributes of the MJCF option. floats: names of the buoyant geoms. judge: the
    function that measures the error of a run. limit: the largest error that passes. qpos, qvel:
    initial state; None means the model's. duration [s]. time: start time [s].
    """

    expects: str
    bodies: str
    judge: Judge
    limit: float
    floats: tuple[str, ...] = ("g",)
    custom: str = ""
    assets: str = ""
    qpos: list[float] | None = None
    qvel: list[float] | None = None
    duration: float = 10.0
    time: float = 0.0
    option: str = ""

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""
        return max(20.0, 100.0 / self.duration)

    def scene(self, integrator: str, timestep: float) -> Scene:
        elements = "".join(f'<element objtype="geom" objname="{g}" prm="0"/>' for g in self.floats)
        scene = Scene.load(
            mujoco.MjSpec.from_string(
                f'<mujoco><option timestep="{timestep}" integrator="{integrator}" {self.option}/>'
                f"<custom>{self.custom}"
                f'<tuple name="buoyant">{elements}</tuple></custom>'
                f"<asset>{self.assets}</asset><worldbody>{self.bodies}</worldbody></mujoco>"
            )
        )
        if self.qpos is not None:
            scene.data.qpos[:] = self.qpos
        if self.qvel is not None:
            scene.data.qvel[:] = self.qvel
        scene.data.time = self.time
        return scene


@dataclass
class Outcome:
    """Errors of a case with one integrator, by timestep [s]; None where the run diverged."""

    errors: dict[float, float | None] = field(default_factory=dict)
    messages: list[str] = field(default_factory=list)

    def holds_up_to(self, limit: float) -> float | None:
        """The largest timestep [s] up to which all errors are within the limit, or None."""
        largest = None
        for timestep, error in sorted(self.errors.items()):
            if error is None or not error <= limit:
                break
            largest = timestep
        return largest


def body(geom: str, density: float = 0.5 * DENSITY, extra: str = "") -> str:
    return f'<body name="b"><freejoint/><geom name="g" {geom} density="{density}"/>{extra}</body>'


def box(x: float, y: float, z: float) -> str:
    """Attributes of a box geom with these sides [m]."""
    return f'type="box" size="{x / 2} {y / 2} {z / 2}"'


BALL = 'type="sphere" size="0.1"'
CUBE = box(1, 1, 1)


def at(z: float, x: float = 0.0, tilt: float = 0.0) -> list[float]:
    """qpos of a free joint at (x, 0, z) [m], tilted about the x axis [rad]."""
    return [x, 0.0, z, np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0]


def mesh(vertices: Array, faces: NDArray[np.int64]) -> str:
    """A mesh asset named 'm'."""
    v = " ".join(f"{x:.9g}" for x in np.ravel(vertices))
    f = " ".join(map(str, np.ravel(faces)))
    return f'<mesh name="m" inertia="exact" vertex="{v}" face="{f}"/>'


def grid_cube(side: float, splits: list[float]) -> str:
    """A cube whose faces are cut along lines at these shares of the side, 0 to 1."""
    lines = np.array([0.0, *splits, 1.0]) - 0.5
    count = len(lines) - 1
    vertices, faces = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            first = len(vertices)
            for u in lines:
                for v in lines:
                    point = np.zeros(3)
                    point[[axis, (axis + 1) % 3, (axis + 2) % 3]] = 0.5 * sign, u, v
                    vertices.append(side * point)
            for i in range(count):
                for j in range(count):
                    a = first + i * (count + 1) + j
                    b, c, d = a + count + 1, a + count + 2, a + 1
                    quad = [[a, b, c], [a, c, d]] if sign > 0 else [[a, c, b], [a, d, c]]
                    faces += quad
    unique, index = np.unique(np.array(vertices), axis=0, return_inverse=True)
    return mesh(unique, np.ravel(index)[np.array(faces)])


STEEP_WAVES = (
    '<numeric name="wave_a" data="0.35 4 0 0"/><numeric name="wave_b" data="0.1 2.4 55 40"/>'
    '<numeric name="wave_c" data="0.0309 1.4 -65 110"/>'
)  # the sum of k a is 0.95
TWO_SECOND_WAVE = GRAVITY * 4.0 / (2.0 * np.pi)
"""Wavelength [m] at which the period is 2 s."""

AT_ORIGIN = Case(
    "", body(CUBE), departure, np.inf, custom=DRAG + '<numeric name="wave_a" data="0.1 4 0 0"/>',
    qpos=at(0.3, tilt=0.3), duration=5.0,
)  # fmt: skip
AT_TIME_0 = Case(
    "", body(CUBE), departure, np.inf, qpos=at(0.3, tilt=0.3), duration=5.0,
    custom=f'{DRAG}<numeric name="wave_a" data="0.1 {TWO_SECOND_WAVE:.17g} 0 0"/>',
)  # fmt: skip
BOX_GEOM = Case("", body(CUBE), departure, np.inf, qpos=at(0.3, tilt=0.3), duration=5.0)

BALLAST = '<geom type="sphere" size="0.05" pos="0 0 0.3" mass="60"/>'
LINK = '<geom name="{}" {} density="512.5"/>'
LINKS = f"""<body name="front"><freejoint/>{LINK.format("front", box(1, 1, 0.2))}
    <body name="rear" pos="1.2 0 0"><joint type="hinge" axis="0 1 0" pos="-0.6 0 0"/>
    {LINK.format("rear", box(1, 1, 0.2))}</body></body>"""
POSITIONS = [(0.42 * i, 0.42 * j, 0.25) for i in range(3) for j in range(3)] + [(0.4, 0.4, 0.7)]
CRATES = "".join(
    f'<body name="b{i}" pos="{x} {y} {z}"><freejoint/>{LINK.format(f"g{i}", box(0.4, 0.4, 0.4))}'
    "</body>"
    for i, (x, y, z) in enumerate(POSITIONS)
)

CASES = {
    "light ball dropped": Case(
        "density 0.01, from 1 m: at rest at the end, m/s", body(BALL, 0.01 * DENSITY),
        final_speed, 0.05, custom=DRAG_AND_ADDED_MASS, qpos=at(1.0),
    ),
    "light ball released": Case(
        "density 0.01, from 2 m depth: no higher than 1.3 m", body(BALL, 0.01 * DENSITY),
        highest, 1.3, custom=DRAG_AND_ADDED_MASS, qpos=at(-2.0),
    ),
    "light ball, no drag": Case(
        "the same without drag and added mass: thrown 198 m high", body(BALL, 0.01 * DENSITY),
        apex(198.0), 0.05, qpos=at(-2.0), duration=8.0,
    ),
    "thin plate, flat": Case(
        "2 cm, density 0.05: at rest at the end, m/s", body(box(1, 1, 0.02), 0.05 * DENSITY),
        final_speed, 0.05, custom=DRAG, qpos=at(0.2),
    ),
    "thin plate, on edge": Case(
        "falls over and lies flat, deg", body(box(1, 1, 0.02), 0.05 * DENSITY),
        flat_tilt, 3.0, custom=DRAG, qpos=at(0.4, tilt=1.4), duration=20.0,
    ),
    "needle": Case(
        "2 m by 2 cm, upright: falls over, deg", body('type="capsule" size="0.01 1"'),
        final_tilt(90.0), 3.0, custom=DRAG, qpos=at(0.5, tilt=0.05), duration=20.0,
    ),
    "top-heavy box": Case(
        "capsizes and settles upside down, deg", body(box(0.6, 0.6, 0.8), 200.0, BALLAST),
        final_tilt(180.0), 3.0, custom=DRAG, qpos=at(0.2, tilt=0.05), duration=20.0,
    ),
    "neutral ball": Case(
        "density 1: stays where it is, m", body(BALL, DENSITY),
        departure, 1e-6, qpos=at(-2.0), duration=20.0,
    ),
    "density 0.9999": Case(
        "rises at the remaining acceleration, relative", body(BALL, 0.9999 * DENSITY),
        rise(GRAVITY * 1e-4 / 0.9999), 0.01, qpos=at(-2.0), duration=20.0,
    ),
    "faces in the surface": Case(
        "neutral cube, top face at the water level: stays, m", body(CUBE, DENSITY),
        departure, 1e-6, qpos=at(-0.5),
    ),
    "vertices in the surface": Case(
        "half-submerged, a row of vertices at the level: stays, m",
        body('type="mesh" mesh="m"'), departure, 1e-5, assets=grid_cube(1.0, [0.5]), qpos=at(0.0),
    ),
    "cube on an edge": Case(
        "stays until disturbed, m and rad", body(CUBE),
        symmetry, 1e-6, qpos=at(0.0, tilt=np.pi / 4), duration=5.0,
    ),
    "sliver triangles": Case(
        "aspect ratio 1e6: moves like a box geom, m", body('type="mesh" mesh="m"'),
        same_as(BOX_GEOM), 1e-3, assets=grid_cube(1.0, [1e-6, 0.4]),
        qpos=at(0.3, tilt=0.3), duration=5.0,
    ),
    "steepness 0.95": Case(
        "ball stays within 0.3 m of the surface", body(BALL),
        distance_from_surface(3.0), 0.3, custom=DRAG_AND_ADDED_MASS + STEEP_WAVES,
        qpos=at(0.5), duration=20.0,
    ),
    "wave of a tenth": Case(
        "0.1 body lengths: floats as in flat water, relative", body(box(1, 1, 0.4), 0.6 * DENSITY),
        mean_fraction(0.6), 0.02, qpos=at(0.2),
        custom=DRAG + '<numeric name="wave_a" data="0.004 0.1 0 0"/>',
    ),
    "wave of a thousand": Case(
        "1000 body lengths: follows it, m from the surface", body(box(1, 1, 0.4), 0.6 * DENSITY),
        distance_from_surface(5.0), 0.2, qpos=at(0.0), duration=25.0,
        custom=DRAG + '<numeric name="wave_a" data="10 1000 0 0"/>',
    ),
    "100 m above": Case(
        "falls, dives, and is at rest at the end, m/s", body(BALL),
        final_speed, 0.05, custom=DRAG_AND_ADDED_MASS, qpos=at(100.0), duration=20.0,
    ),
    "1 km deep": Case(
        "rises at its terminal velocity, relative", body(BALL),
        final_velocity(np.sqrt(2.0 * GRAVITY * 0.4 / 3.0)), 0.03, qpos=at(-1000.0), duration=5.0,
        custom='<numeric name="drag" data="0 1 0"/>',
    ),
    "1 km away": Case(
        "moves as at the origin, m", body(CUBE), same_as(AT_ORIGIN, (1e3, 0, 0)), 1e-3,
        custom=AT_ORIGIN.custom, qpos=at(0.3, 1e3, 0.3), duration=5.0,
    ),
    "1000 km away": Case(
        "moves as at the origin, m", body(CUBE), same_as(AT_ORIGIN, (1e6, 0, 0)), 1e-3,
        custom=AT_ORIGIN.custom, qpos=at(0.3, 1e6, 0.3), duration=5.0,
    ),
    "after 1e6 s": Case(
        "moves as from time 0, m", body(CUBE), same_as(AT_TIME_0), 1e-3,
        custom=AT_TIME_0.custom, qpos=at(0.3, tilt=0.3), duration=5.0, time=1e6,
    ),
    "mesh in millimetres": Case(
        "1 mm cube: heaves freely, error over amplitude", body('type="mesh" mesh="m"'),
        heave(1e-5, 5e-4), 0.3, assets=grid_cube(1e-3, [0.5]), qpos=at(1e-5), duration=0.1,
    ),
    "mesh in kilometres": Case(
        "1 km cube: heaves freely, error over amplitude", body('type="mesh" mesh="m"'),
        heave(10.0, 500.0), 0.3, assets=grid_cube(1e3, [0.5]), qpos=at(10.0), duration=40.0,
    ),
    "impact at 30 m/s": Case(
        "dives and is at rest at the end, m/s", body(BALL),
        final_speed, 0.05, custom=DRAG_AND_ADDED_MASS, qpos=at(0.5), qvel=[0, 0, -30, 0, 0, 0],
    ),
    "two links": Case(
        "hinged, start folded: end flat, relative fraction", LINKS,
        mean_fraction(0.5), 0.02, ("front", "rear"), custom=DRAG, duration=20.0,
        qpos=[*at(0.2), 0.5],
    ),
    "ten bodies in contact": Case(
        "crates, one on top: submerged as their weight demands, relative", CRATES,
        mean_fraction(0.5), 0.1, tuple(f"g{i}" for i in range(10)), custom=DRAG, duration=10.0,
        option='jacobian="dense"',
    ),
    "drag times a thousand": Case(
        "slows below 0.1 m/s, energy over that at 1 m/s", body(BALL, DENSITY),
        energy_growth, 0.01, qpos=at(-5.0), qvel=[3, -1, 2, 5, 3, 1], duration=2.0,
        custom='<numeric name="drag" data="200 1000 5"/>',
    ),
    "tumbling, no drag": Case(
        "neutral box: keeps its kinetic energy, relative", body(box(1, 0.6, 0.3), DENSITY),
        conserves(kinetic_energy), 0.05, qpos=at(-50.0), qvel=[0, 0, 0, 1, 2, 0.5], duration=20.0,
    ),
    "bobbing and rolling": Case(
        "a minute without drag: energy over weight * 0.3 m", body(box(2, 1, 0.4), 0.6 * DENSITY),
        conserves(weight_times_30_cm), 0.1, qpos=at(0.3, tilt=0.6), duration=60.0,
    ),
}  # fmt: skip


def attempts(case: Case, integrator: str, timesteps: Sequence[float]) -> Outcome:
    """Run a case with an integrator at each timestep [s] and judge the runs."""
    outcome = Outcome()
    for timestep in timesteps:
        scene = case.scene(integrator, timestep)
        try:
            samples = list(simulate(scene, case.duration, case.rate))
        except DivergenceError as error:
            outcome.errors[timestep] = None
            outcome.messages.append(str(error))
        else:
            run = Run(case, integrator, timestep, scene, samples)
            outcome.errors[timestep] = float(case.judge(run))
    return outcome
