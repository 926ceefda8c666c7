"""Cases: what is hard for a float, and what must come out."""

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
    weight_times_a_foot,
)  # fmt: skip
from sim.runs.divergence import DivergenceError
from sim.runs.simulation import simulate
from sim.scenes.scene import Scene

Array = NDArray[np.float64]

WATER, G = 1025.0, 9.81
DRAG = '<numeric name="drag" data="0.2 1.0 0.005"/>'
ADDED = '<numeric name="added_mass" data="0.5 0.5 0.5 0 0 0"/>'
BOTH = DRAG + ADDED


@dataclass(frozen=True)
class Case:
    """bodies, assets, custom: MJCF; floats: names of the buoyant geoms; qpos, qvel: start, the
    model's own where None; judge: the error of a run; limit: the largest that passes; expects:
    what it says, in words; duration [s]; time [s] at the start."""

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
        """Samples a second [Hz]."""
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
    """Errors of one case and integrator by timestep; None where the run diverged."""

    errors: dict[float, float | None] = field(default_factory=dict)
    messages: list[str] = field(default_factory=list)

    def holds_up_to(self, limit: float) -> float | None:
        """The largest timestep [s] up to which all hold."""
        largest = None
        for timestep, error in sorted(self.errors.items()):
            if error is None or not error <= limit:
                break
            largest = timestep
        return largest


def body(geom: str, density: float = 0.5 * WATER, extra: str = "") -> str:
    return f'<body name="b"><freejoint/><geom name="g" {geom} density="{density}"/>{extra}</body>'


def box(x: float, y: float, z: float) -> str:
    """A box geom of these sides [m]."""
    return f'type="box" size="{x / 2} {y / 2} {z / 2}"'


BALL = 'type="sphere" size="0.1"'
CUBE = box(1, 1, 1)


def at(z: float, x: float = 0.0, tilt: float = 0.0) -> list[float]:
    """A pose, tilted about the x axis [rad]."""
    return [x, 0.0, z, np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0]


def mesh(vertices: Array, faces: NDArray[np.int64]) -> str:
    """A mesh asset 'm' with these vertices and faces."""
    v = " ".join(f"{x:.9g}" for x in np.ravel(vertices))
    f = " ".join(map(str, np.ravel(faces)))
    return f'<mesh name="m" inertia="exact" vertex="{v}" face="{f}"/>'


def grid_cube(side: float, splits: list[float]) -> str:
    """A cube whose faces are cut along lines at these parts of the side, 0 to 1."""
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


STEEP = (
    '<numeric name="wave_a" data="0.35 4 0 0"/><numeric name="wave_b" data="0.1 2.4 55 40"/>'
    '<numeric name="wave_c" data="0.0309 1.4 -65 110"/>'
)  # sum of k a 0.95
TWO_SECONDS = G * 4.0 / (2.0 * np.pi)
"""Wavelength [m] of a wave with a period of 2 s."""

HERE = Case(
    "", body(CUBE), departure, np.inf, custom=DRAG + '<numeric name="wave_a" data="0.1 4 0 0"/>',
    qpos=at(0.3, tilt=0.3), duration=5.0,
)  # fmt: skip
NOW = Case(
    "", body(CUBE), departure, np.inf, qpos=at(0.3, tilt=0.3), duration=5.0,
    custom=f'{DRAG}<numeric name="wave_a" data="0.1 {TWO_SECONDS:.17g} 0 0"/>',
)  # fmt: skip
SMOOTH = Case("", body(CUBE), departure, np.inf, qpos=at(0.3, tilt=0.3), duration=5.0)

BALLAST = '<geom type="sphere" size="0.05" pos="0 0 0.3" mass="60"/>'
LINK = '<geom name="{}" {} density="512.5"/>'
LINKS = f"""<body name="front"><freejoint/>{LINK.format("front", box(1, 1, 0.2))}
    <body name="rear" pos="1.2 0 0"><joint type="hinge" axis="0 1 0" pos="-0.6 0 0"/>
    {LINK.format("rear", box(1, 1, 0.2))}</body></body>"""
PLACES = [(0.42 * i, 0.42 * j, 0.25) for i in range(3) for j in range(3)] + [(0.4, 0.4, 0.7)]
CRATES = "".join(
    f'<body name="b{i}" pos="{x} {y} {z}"><freejoint/>{LINK.format(f"g{i}", box(0.4, 0.4, 0.4))}'
    "</body>"
    for i, (x, y, z) in enumerate(PLACES)
)

CASES = {
    "light ball dropped": Case(
        "density 0.01 from 1 m: at rest in the end, m/s", body(BALL, 0.01 * WATER),
        final_speed, 0.05, custom=BOTH, qpos=at(1.0),
    ),
    "light ball released": Case(
        "density 0.01 from 2 m depth: no higher than 1.3 m", body(BALL, 0.01 * WATER),
        highest, 1.3, custom=BOTH, qpos=at(-2.0),
    ),
    "light ball, no drag": Case(
        "the same without drag and added mass: thrown 198 m high", body(BALL, 0.01 * WATER),
        apex(198.0), 0.05, qpos=at(-2.0), duration=8.0,
    ),
    "thin plate, flat": Case(
        "2 cm, density 0.05: at rest in the end, m/s", body(box(1, 1, 0.02), 0.05 * WATER),
        final_speed, 0.05, custom=DRAG, qpos=at(0.2),
    ),
    "thin plate, on edge": Case(
        "falls over and lies flat, deg", body(box(1, 1, 0.02), 0.05 * WATER),
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
        "density 1: stays where it is, m", body(BALL, WATER),
        departure, 1e-6, qpos=at(-2.0), duration=20.0,
    ),
    "density 0.9999": Case(
        "rises at the acceleration that is left, relative", body(BALL, 0.9999 * WATER),
        rise(G * 1e-4 / 0.9999), 0.01, qpos=at(-2.0), duration=20.0,
    ),
    "faces in the surface": Case(
        "neutral cube, its top at the water's level: stays, m", body(CUBE, WATER),
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
        "aspect 1e6: moves as a box geom does, m", body('type="mesh" mesh="m"'),
        same_as(SMOOTH), 1e-3, assets=grid_cube(1.0, [1e-6, 0.4]),
        qpos=at(0.3, tilt=0.3), duration=5.0,
    ),
    "steepness 0.95": Case(
        "ball stays within 0.3 m of the surface", body(BALL),
        distance_from_surface(3.0), 0.3, custom=BOTH + STEEP, qpos=at(0.5), duration=20.0,
    ),
    "wave of a tenth": Case(
        "of the body's size: floats as in flat water, relative", body(box(1, 1, 0.4), 0.6 * WATER),
        mean_fraction(0.6), 0.02, qpos=at(0.2),
        custom=DRAG + '<numeric name="wave_a" data="0.004 0.1 0 0"/>',
    ),
    "wave of a thousand": Case(
        "times the body's size: rides it, m from the surface", body(box(1, 1, 0.4), 0.6 * WATER),
        distance_from_surface(5.0), 0.2, qpos=at(0.0), duration=25.0,
        custom=DRAG + '<numeric name="wave_a" data="10 1000 0 0"/>',
    ),
    "100 m above": Case(
        "falls, dives, and is at rest in the end, m/s", body(BALL),
        final_speed, 0.05, custom=BOTH, qpos=at(100.0), duration=20.0,
    ),
    "1 km deep": Case(
        "rises at its terminal velocity, relative", body(BALL),
        final_velocity(np.sqrt(2.0 * G * 0.4 / 3.0)), 0.03, qpos=at(-1000.0), duration=5.0,
        custom='<numeric name="drag" data="0 1 0"/>',
    ),
    "1 km away": Case(
        "moves as at the origin, m", body(CUBE), same_as(HERE, (1e3, 0, 0)), 1e-3,
        custom=HERE.custom, qpos=at(0.3, 1e3, 0.3), duration=5.0,
    ),
    "1000 km away": Case(
        "moves as at the origin, m", body(CUBE), same_as(HERE, (1e6, 0, 0)), 1e-3,
        custom=HERE.custom, qpos=at(0.3, 1e6, 0.3), duration=5.0,
    ),
    "after 1e6 s": Case(
        "moves as at the start, m", body(CUBE), same_as(NOW), 1e-3,
        custom=NOW.custom, qpos=at(0.3, tilt=0.3), duration=5.0, time=1e6,
    ),
    "mesh in millimetres": Case(
        "1 mm cube: heaves as it must, of the amplitude", body('type="mesh" mesh="m"'),
        heave(1e-5, 5e-4), 0.3, assets=grid_cube(1e-3, [0.5]), qpos=at(1e-5), duration=0.1,
    ),
    "mesh in kilometres": Case(
        "1 km cube: heaves as it must, of the amplitude", body('type="mesh" mesh="m"'),
        heave(10.0, 500.0), 0.3, assets=grid_cube(1e3, [0.5]), qpos=at(10.0), duration=40.0,
    ),
    "impact at 30 m/s": Case(
        "dives and is at rest in the end, m/s", body(BALL),
        final_speed, 0.05, custom=BOTH, qpos=at(0.5), qvel=[0, 0, -30, 0, 0, 0],
    ),
    "two links": Case(
        "hinged and folded: lie flat in the end, relative fraction", LINKS,
        mean_fraction(0.5), 0.02, ("front", "rear"), custom=DRAG, duration=20.0,
        qpos=[*at(0.2), 0.5],
    ),
    "ten bodies in contact": Case(
        "crates, one on top: float as the weight says, relative", CRATES,
        mean_fraction(0.5), 0.1, tuple(f"g{i}" for i in range(10)), custom=DRAG, duration=10.0,
        option='jacobian="dense"',
    ),
    "drag times a thousand": Case(
        "speed falls below a tenth, as energy", body(BALL, WATER),
        energy_growth, 0.01, qpos=at(-5.0), qvel=[3, -1, 2, 5, 3, 1], duration=2.0,
        custom='<numeric name="drag" data="200 1000 5"/>',
    ),
    "tumbling, no drag": Case(
        "neutral box: keeps its kinetic energy, relative", body(box(1, 0.6, 0.3), WATER),
        conserves(kinetic_energy), 0.05, qpos=at(-50.0), qvel=[0, 0, 0, 1, 2, 0.5], duration=20.0,
    ),
    "bobbing and rolling": Case(
        "a minute without drag: energy over weight times 0.3 m", body(box(2, 1, 0.4), 0.6 * WATER),
        conserves(weight_times_a_foot), 0.1, qpos=at(0.3, tilt=0.6), duration=60.0,
    ),
}  # fmt: skip


def attempts(case: Case, integrator: str, timesteps: Sequence[float]) -> Outcome:
    """Run a case with an integrator at each of the timesteps [s]."""
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
