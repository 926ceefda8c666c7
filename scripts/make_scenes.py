"""Make the generated files in models/: the Wigley hull's mesh and the scene of a hundred spheres.

    python scripts/make_scenes.py                      # the files in models/
    python scripts/make_scenes.py --stations 80 --output finer

The Wigley hull (Wigley 1934) has hydrostatics in closed form. Its surface is parabolic along the
hull and with depth,

    y = +- B/2 (1 - (2x/L)^2) (1 - (z/T)^2)    for -T <= z <= 0,

with vertical sides from the waterline up to the deck and L : B : T = 10 : 1 : 0.625.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from command_line import Parser, at_least, run_script

MODELS = Path(__file__).resolve().parents[1] / "models"

LENGTH, BEAM, DRAFT, FREEBOARD = 10.0, 1.0, 0.625, 0.4  # [m]

STATIONS = 40
"""Number of sections along the Wigley hull; it has about 1.4 times the square of this in faces."""

SPHERES_A_SIDE, SPHERE_SPACING, SPHERE_RADIUS = 10, 0.9, 0.3  # [m]
COLOURS = ("0.90 0.36 0.24", "0.93 0.69 0.13", "0.92 0.90 0.84", "0.34 0.66 0.52")


def wigley(stations: int = STATIONS) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (V, 3) [m] and faces (F, 3) of the closed Wigley hull, wound outwards.

    The x axis points forwards, and the design waterline is at z = 0. Below it there are a quarter
    as many rows of faces as stations.
    """
    x = np.linspace(-0.5 * LENGTH, 0.5 * LENGTH, stations + 1)
    below = np.linspace(-DRAFT, 0.0, max(2, stations // 4) + 1)
    z = np.concatenate([below, np.linspace(0.0, FREEBOARD, max(1, stations // 10) + 1)[1:]])
    width = 1.0 - (np.minimum(z, 0.0) / DRAFT) ** 2
    y = 0.5 * BEAM * np.outer(1.0 - (2.0 * x / LENGTH) ** 2, width)
    y[[0, -1]], y[:, 0] = 0.0, 0.0  # stems and keel, without round-off
    port = np.stack(np.broadcast_arrays(x[:, None], y, z[None, :]), axis=-1)
    starboard = port * [1.0, -1.0, 1.0]
    deck = np.stack([starboard[:, -1], port[:, -1]], axis=1)
    pieces = [triangles(starboard), triangles(port[:, ::-1]), triangles(deck)]
    vertices, corner = np.unique(np.concatenate(pieces).reshape(-1, 3), axis=0, return_inverse=True)
    faces = corner.reshape(-1, 3)
    has_area = (faces != np.roll(faces, 1, axis=1)).all(axis=1)  # some at stems and keel have none
    return vertices, faces[has_area]


def triangles(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """Triangles (N, 3, 3) of a grid of points (I, J, 3), counterclockwise from axis i to axis j."""
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    halves = [np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]
    return np.concatenate([half.reshape(-1, 3, 3) for half in halves])


def wigley_obj(stations: int = STATIONS) -> str:
    """The mesh as the text of an OBJ file."""
    vertices, faces = wigley(stations)
    lines = [f"# Wigley hull, {stations} stations; made by scripts/make_scenes.py"]
    lines += ["v {:.7f} {:.7f} {:.7f}".format(*(vertex + 0.0)) for vertex in vertices]
    lines += ["f {} {} {}".format(*(face + 1)) for face in faces]
    return "\n".join(lines) + "\n"


SPHERES = """<!-- A hundred colliding spheres of 1280 faces each, in three crossing waves.
     scripts/make_scenes.py makes this file. The solver is CG because MuJoCo 4.0.0 has a bug in its
     sparse Newton solver, which it would choose for 600 degrees of freedom.
     The joints' damping (N s/m and N m s/rad) replaces the drag of the water. -->
<mujoco model="spheres">
  <option timestep="0.005" integrator="implicitfast" solver="CG"/>

  <extension><plugin plugin="waterline"><instance name="water"/></plugin></extension>

  <custom>
    <numeric name="water_density" data="1025"/> <!-- kg/m^3 -->
    <text name="water_pressure" data="froude-krylov"/>
    <!-- amplitude m, wavelength m, heading deg, phase deg -->
    <numeric name="wave_swell" data="0.15 8.0 0 0"/>
    <numeric name="wave_cross" data="0.10 5.0 55 40"/>
    <numeric name="wave_chop" data="0.05 2.4 -65 110"/>
    <text name="buoyancy_method" data="patches"/>
    <tuple name="buoyant">
{elements}
    </tuple>
  </custom>

  <default>
    <joint damping="20"/>
    <geom type="sphere" size="{radius:g}"/>
  </default>

  <worldbody>
    <light directional="true" dir="-0.4 0.3 -1" diffuse="0.8 0.8 0.8"/>
{bodies}
  </worldbody>

  <keyframe>
    <key name="start" qpos="{start}"/>
  </keyframe>
</mujoco>
"""


def spheres_xml() -> str:
    """The scene of the spheres: a square of them, of 300 to 700 kg/m^3, falls into the water."""
    rng = np.random.default_rng(0)
    elements, bodies, start = [], [], []
    middle = 0.5 * (SPHERES_A_SIDE - 1)
    for i, j in np.ndindex(SPHERES_A_SIDE, SPHERES_A_SIDE):
        name, colour = f"ball_{i}_{j}", COLOURS[rng.integers(len(COLOURS))]
        x, y = SPHERE_SPACING * (i - middle), SPHERE_SPACING * (j - middle)
        z, density = rng.uniform(0.4, 0.9), rng.uniform(300.0, 700.0)
        elements.append(f'      <element objtype="geom" objname="{name}" prm="0"/>')
        bodies.append(
            f'    <body name="{name}"><joint type="free"/>'
            f'<geom name="{name}" density="{density:.0f}" rgba="{colour} 1"/></body>'
        )
        start.append(f"{x:g} {y:g} {z:.2f} 1 0 0 0")
    return SPHERES.format(
        elements="\n".join(elements),
        bodies="\n".join(bodies),
        start="  ".join(start),
        radius=SPHERE_RADIUS,
    )


def main(arguments: list[str] | None = None) -> int:
    parser = Parser(__doc__)
    parser.add_argument(
        "--stations",
        type=at_least(2, 10_000),
        default=STATIONS,
        metavar="N",
        help=f"sections along the hull ({STATIONS})",
    )
    parser.add_argument(
        "--output", type=Path, default=MODELS, metavar="FOLDER", help="default: models/"
    )
    options = parser.parse_args(arguments)
    contents = {"meshes/wigley.obj": wigley_obj(options.stations), "spheres.xml": spheres_xml()}
    for name, text in contents.items():
        path = options.output / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        print(path)
    return 0


if __name__ == "__main__":
    run_script(main)
