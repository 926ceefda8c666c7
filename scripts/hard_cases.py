"""Run what is hard for a float, at every integrator and timestep, and say what holds.

    python scripts/hard_cases.py [--quick] [--json FILE] [--only WORD]

Each case states what must come out. A timestep holds when the run does not diverge and the
error against that stays within the case's limit; reported is the largest timestep up to which all
hold, and the errors at 2 ms. Exit status: 0 when all cases hold at 2 ms with every integrator,
1 when one does not, 2 on unusable input.
"""

import argparse
import json
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

from command_line import INTERRUPTED, Parser, interruptible, run_script

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim import DivergenceError, Sample, Scene, simulate

Array = NDArray[np.float64]

INTEGRATORS = ("Euler", "implicitfast", "RK4")
TIMESTEPS = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02)
QUICK_TIMESTEPS = (0.002, 0.02)
REFERENCE = 0.002
"""Timestep [s] of the shipped scenes, at which every case has to hold."""

WATER, G = 1025.0, 9.81
DRAG = '<numeric name="drag" data="0.2 1.0 0.005"/>'
ADDED = '<numeric name="added_mass" data="0.5 0.5 0.5 0 0 0"/>'
BOTH = DRAG + ADDED

Judge = Callable[["Run"], float]


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
        scene = Scene.from_model(
            mujoco.MjModel.from_xml_string(
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


@dataclass(frozen=True)
class Run:
    """A case that has been run to its end."""

    case: Case
    integrator: str
    timestep: float
    scene: Scene
    samples: list[Sample]


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


def final_speed(run: Run) -> float:
    """Speed [m/s] of a single body's frame; a ball may go on spinning, which takes little drag."""
    return float(np.linalg.norm(run.scene.data.qvel[:3]))


def final_tilt(expected: float) -> Judge:
    """Angle [deg] between the tilt at the end and the expected one [deg]."""

    def judge(run: Run) -> float:
        return float(abs(np.degrees(run.samples[-1].tilts[0]) - expected))

    return judge


def flat_tilt(run: Run) -> float:
    """Angle [deg] between a plate's axis and the vertical, whichever side is up."""
    tilt = np.degrees(run.samples[-1].tilts[0])
    return float(min(tilt, 180.0 - tilt))


def highest(run: Run) -> float:
    return max(float(s.centres[0, 2]) for s in run.samples)


def departure(run: Run) -> float:
    """How far [m] a body gets from where it started."""
    start = run.samples[0].centres
    return max(float(np.abs(s.centres - start).max()) for s in run.samples)


def apex(expected: float) -> Judge:
    """Relative error of the greatest height against the expected one [m]."""

    def judge(run: Run) -> float:
        return abs(highest(run) / expected - 1.0)

    return judge


def rise(acceleration: float) -> Judge:
    """Relative error of the way gone against that at a constant acceleration [m/s^2]."""

    def judge(run: Run) -> float:
        way = run.samples[-1].centres[0, 2] - run.samples[0].centres[0, 2]
        return abs(way / (0.5 * acceleration * run.samples[-1].time ** 2) - 1.0)

    return judge


def final_velocity(expected: float) -> Judge:
    def judge(run: Run) -> float:
        return abs(run.scene.data.qvel[2] / expected - 1.0)

    return judge


def distance_from_surface(after: float) -> Judge:
    """Largest distance [m] of the body from the water's surface after a while [s]."""

    def judge(run: Run) -> float:
        start = run.samples[0].time
        late = [s for s in run.samples if s.time - start > after]
        return max(float(np.abs(s.centres[:, 2] - s.elevations).max()) for s in late)

    return judge


def mean_fraction(expected: float) -> Judge:
    """Largest relative error of a body's mean submerged fraction over the second half."""

    def judge(run: Run) -> float:
        half = run.samples[len(run.samples) // 2 :]
        means = np.mean([s.submerged_fractions for s in half], axis=0)
        return float(np.abs(means / expected - 1.0).max())

    return judge


def heave(amplitude: float, draft: float) -> Judge:
    """Largest distance from free heave, amplitude cos(omega t), over the amplitude [m]."""
    omega = np.sqrt(G / draft)

    def judge(run: Run) -> float:
        return max(
            abs(float(s.centres[0, 2]) / amplitude - np.cos(omega * s.time)) for s in run.samples
        )

    return judge


def symmetry(run: Run) -> float:
    """Largest sideways motion [m] and turn [rad] of a body that nothing pushes aside."""
    start = run.samples[0]
    return max(
        max(
            float(np.abs(s.centres[0, :2] - start.centres[0, :2]).max()),
            float(np.abs(s.quaternions[0] - start.quaternions[0]).max()),
        )
        for s in run.samples
    )


def same_as(other: "Case", offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Judge:
    """Largest distance [m] from the run of another case, apart from an offset."""

    def judge(run: Run) -> float:
        twin = other.scene(run.integrator, run.timestep)
        twins = simulate(twin, other.duration, other.rate)
        return max(
            float(np.abs(a.centres - b.centres - offset).max())
            for a, b in zip(run.samples, twins, strict=True)
        )

    return judge


def energy_growth(run: Run) -> float:
    """Kinetic energy at the end over that of 1 m/s; drag alone may only lower it."""
    return float(0.5 * (run.scene.data.qvel[:3] ** 2).sum() / 0.5)


def potential(scene: Scene) -> float:
    """Potential energy [J] of flat water at level 0 and the bodies in it.

    That of the water is density g times the integral of the depth over the submerged volume,
    which by Gauss's theorem is that of - depth^2 / 2 n_z over the wet surface. Over a
    triangle with depths a, b, c it is area (a^2 + b^2 + c^2 + ab + bc + ca) / 6; an odd corner
    with the depth d across the surface takes or gives area d^4 / (6 (d - e) (d - f)).
    """
    model, data = scene.model, scene.data
    total = float(model.body_mass @ data.xipos[:, 2]) * G
    for f in scene.buoyancy.floats:
        hull = f.method.hull
        up = data.ximat[f.body].reshape(3, 3)[2]
        depth = -(hull.vertices @ up + data.xipos[f.body, 2])[hull.faces]
        wet = depth > 0.0
        odd = np.argmax(wet == (wet.sum(axis=1) == 1)[:, None], axis=1)
        d, e, c = (depth[np.arange(len(depth)), (odd + i) % 3] for i in range(3))
        whole = (depth**2).sum(axis=1) + d * e + e * c + c * d
        cut = wet.any(axis=1) & ~wet.all(axis=1)
        corner = np.where(cut, d**4 / np.where(cut, (d - e) * (d - c), 1.0), 0.0)
        integral = np.select(
            [wet.all(axis=1), wet.sum(axis=1) == 1, cut], [whole, corner, whole - corner], 0.0
        )
        total -= WATER * G * 0.5 * float(integral / 6.0 @ (hull.area_vectors @ up))
    return total


def mechanical_energy(scene: Scene) -> float:
    """Kinetic and potential energy [J] as the state stands."""
    mujoco.mj_forward(scene.model, scene.data)
    mujoco.mj_energyVel(scene.model, scene.data)
    return float(scene.data.energy[1]) + potential(scene)


def conserves(scale: Callable[[Scene], float]) -> Judge:
    """Change of the energy from start to end over a scale [J]."""

    def judge(run: Run) -> float:
        start = run.case.scene(run.integrator, run.timestep)
        change = mechanical_energy(run.scene) - mechanical_energy(start)
        return abs(change) / scale(start)

    return judge


def kinetic_energy(scene: Scene) -> float:
    return mechanical_energy(scene) - potential(scene)


def weight_times_a_foot(scene: Scene) -> float:
    return 0.3 * G * float(scene.model.body_mass.sum())


WAVES = (
    '<numeric name="wave_a" data="0.10 4 0 0"/><numeric name="wave_b" data="0.06 2.4 55 40"/>'
    '<numeric name="wave_c" data="0.03 1.4 -65 110"/>'
)
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
        "density 0.01 from 2 m depth: no higher than 0.5 m", body(BALL, 0.01 * WATER),
        highest, 0.5, custom=BOTH, qpos=at(-2.0),
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


def attempt(case: Case, integrator: str, timestep: float, outcome: Outcome) -> None:
    """Run a case once and note its error, or None and the message when it diverges."""
    scene = case.scene(integrator, timestep)
    try:
        samples = list(simulate(scene, case.duration, case.rate))
    except DivergenceError as error:
        outcome.errors[timestep] = None
        outcome.messages.append(str(error))
        return
    outcome.errors[timestep] = float(case.judge(Run(case, integrator, timestep, scene, samples)))


def drag_cost() -> dict[str, float]:
    """Time of buoyancy with drag over that without, for the shipped bunny as it floats."""
    path = Path(__file__).resolve().parents[1] / "models" / "bunny.xml"
    times: dict[str, list[float]] = {"with": [], "without": []}
    scene = Scene.load(path)
    plain_text = path.read_text().replace('name="drag"', 'name="no_drag"')
    plain = Scene.from_model(
        mujoco.MjModel.from_xml_string(
            plain_text.replace('meshdir="meshes"', f'meshdir="{path.parent / "meshes"}"')
        )
    )
    for _ in simulate(scene, 3.0):
        pass
    plain.data.qpos[:] = scene.data.qpos
    plain.data.time = scene.data.time
    for _ in range(20):
        for name, which in (("with", scene), ("without", plain)):
            started = perf_counter()
            for _ in range(100):
                which.buoyancy.apply(which.model, which.data)
            times[name].append((perf_counter() - started) / 100.0)
    with_drag, without = min(times["with"]), min(times["without"])
    return {
        "buoyancy_us": 1e6 * without,
        "with_drag_us": 1e6 * with_drag,
        "drag_over_buoyancy": with_drag / without - 1.0,
    }


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(prog="hard_cases.py", description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="implicitfast only, at 2 and 20 ms; under a minute"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all errors there")
    parser.add_argument("--only", default="", metavar="WORD", help="cases whose name has it")
    options = parser.parse_args(arguments)
    if not any(options.only in name for name in CASES):
        parser.error(f"no case has '{options.only}' in its name; there are {', '.join(CASES)}")
    if options.json is not None:
        try:
            options.json.open("a").close()
        except OSError as error:
            parser.error(str(error))
    return options


def show(value: float | None, unit: str = "") -> str:
    return "-" if value is None else f"{value:.2g}{unit}"


def run_case(name: str, quick: bool) -> dict[str, Any]:
    """All integrators and timesteps of a case: its line in the table and in the JSON."""
    case = CASES[name]
    line: dict[str, Any] = {"expects": case.expects, "limit": case.limit, "integrators": {}}
    for integrator in INTEGRATORS[1:2] if quick else INTEGRATORS:
        outcome = Outcome()
        for timestep in QUICK_TIMESTEPS if quick else TIMESTEPS:
            attempt(case, integrator, timestep, outcome)
        line["integrators"][integrator] = {
            "largest_stable_timestep": outcome.holds_up_to(case.limit),
            "errors": {f"{h:g}": e for h, e in outcome.errors.items()},
            "divergences": outcome.messages,
        }
    return line


def holds(line: dict[str, Any]) -> bool:
    """Whether a case holds at REFERENCE with every integrator that was run."""
    errors = [i["errors"][f"{REFERENCE:g}"] for i in line["integrators"].values()]
    return all(e is not None and e <= line["limit"] for e in errors)


def print_table(options: argparse.Namespace, results: dict[str, Any]) -> None:
    """Run the cases, add them to the results and print their lines as they come."""
    integrators = INTEGRATORS[1:2] if options.quick else INTEGRATORS
    columns = "".join(f"{name:>22}" for name in integrators)
    print(f"largest timestep that holds / error at 2 ms\n{'case':<24}{'limit':>8}{columns}")
    for name in CASES:
        if options.only not in name:
            continue
        line = results[name] = run_case(name, options.quick)
        cells = ""
        for integrator in line["integrators"].values():
            largest = integrator["largest_stable_timestep"]
            step = show(largest and 1e3 * largest, " ms")
            cells += f"{step + ' / ' + show(integrator['errors'][f'{REFERENCE:g}']):>22}"
        verdict = "" if holds(line) else "   FAILS"
        print(f"{name:<24}{line['limit']:>8.1g}{cells}   {line['expects']}{verdict}", flush=True)


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    warnings.simplefilter("ignore")  # a diverging run overflows before it is stopped
    results: dict[str, Any] = {}
    cost, interrupted = None, False
    try:
        with interruptible():
            print_table(options, results)
            cost = drag_cost()
        print(
            f"\nbunny in three waves: buoyancy {cost['buoyancy_us']:.1f} us, with drag "
            f"{cost['with_drag_us']:.1f} us: drag costs {cost['drag_over_buoyancy']:.2f} of "
            "buoyancy"
        )
    except KeyboardInterrupt:
        print("hard_cases.py: interrupted", file=sys.stderr)
        interrupted = True
    if options.json is not None:
        options.json.write_text(json.dumps({"cases": results, "drag": cost}, indent=2) + "\n")
    failed = [name for name, line in results.items() if not holds(line)]
    print(f"{len(results) - len(failed)} of {len(results)} cases hold at 2 ms" + ": " * bool(failed)
          + "; ".join(f"{name} fails" for name in failed))  # fmt: skip
    if interrupted:
        return INTERRUPTED
    return 1 if failed else 0


if __name__ == "__main__":
    run_script(main)
