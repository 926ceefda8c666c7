"""Independent computations that share no code with the package, and seeded poses and seas."""

import os
import runpy
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

import numpy as np
import trimesh

import command_line
from sim import Hull, Sea, Wave

REPOSITORY = Path(__file__).resolve().parents[1]
MODELS = REPOSITORY / "models"

DENSITY, GRAVITY = 1025.0, 9.81

ROUND_OFF = 1e-12
"""Relative round-off error of sums over some thousand triangles in double precision."""


def three_waves(steepness: float = 0.45) -> Sea:
    """Three crossing waves, the longest of 4 m, with a given sum of k a. Pressure is hydrostatic as
    in this file's quadrature and in closed forms; `test_head` tests the decaying pressure."""
    shape = [(0.10, 4.0, 0.0, 0.0), (0.06, 2.4, 0.96, 0.7), (0.03, 1.4, -1.13, 1.9)]
    waves = [Wave(*numbers) for numbers in shape]
    scale = steepness / sum(w.steepness for w in waves)
    return Sea([Wave(scale * a, *rest) for a, *rest in shape], pressure="hydrostatic")


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """Rotation matrix (3, 3), uniform over all rotations."""
    return trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]


def meshes() -> dict[str, trimesh.Trimesh]:
    """Closed meshes about 1 m long: a convex one, one with a hole, and a scan."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    torus = trimesh.creation.torus(major_radius=0.35, minor_radius=0.15)
    return {"icosphere": ball, "torus": torus, "bunny": load_mesh("bunny")}


def load_mesh(name: str) -> trimesh.Trimesh:
    return trimesh.load_mesh(MODELS / "meshes" / f"{name}.obj", process=False)


def volume_below(mesh: trimesh.Trimesh, height: float) -> float:
    """Volume [m^3] of a closed mesh below a height, cut by trimesh.

    The volume is a sum of cones from a point in the cutting plane. Cones over the cut have no
    height, so the cut may stay open.
    """
    origin, down = np.array([0.0, 0.0, height]), np.array([0.0, 0.0, -1.0])
    vertices, faces, *_ = trimesh.intersections.slice_faces_plane(
        mesh.vertices, mesh.faces, down, origin
    )
    a, b, c = np.moveaxis((vertices - origin)[faces], 1, 0)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0)


def clip(corners: np.ndarray, heads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Wet pieces of triangles (N, 3, 3) with linear heads (N, 3), as triangles and their heads.
    Polygons are clipped one by one (Sutherland and Hodgman 1974)."""
    wet_corners, wet_heads = [], []
    for triangle, head in zip(corners, heads, strict=True):
        points, values = [], []
        for i in range(3):
            j = (i + 1) % 3
            if head[i] > 0.0:
                points.append(triangle[i])
                values.append(head[i])
            if (head[i] > 0.0) != (head[j] > 0.0):
                along = head[i] / (head[i] - head[j])
                points.append(triangle[i] + along * (triangle[j] - triangle[i]))
                values.append(0.0)
        for k in range(1, len(points) - 1):
            wet_corners.append([points[0], points[k], points[k + 1]])
            wet_heads.append([values[0], values[k], values[k + 1]])
    return np.reshape(wet_corners, (-1, 3, 3)), np.reshape(wet_heads, (-1, 3))


def wet_triangles(hull: Hull, sea: Sea, position, rotation, time: float):
    """Corners (N, 3, 3) [m, world] and heads (N, 3) [m] of the wet pieces of a hull's triangles."""
    vertices = hull.vertices @ np.asarray(rotation).T + position
    heads = sea.elevation(vertices[:, 0], vertices[:, 1], time) - vertices[:, 2]
    return clip(vertices[hull.faces], heads[hull.faces])


def quadrature_wrench(corners, heads, about) -> np.ndarray:
    """Wrench (6,) of wet triangles by quadrature of -p n and r x -p n.

    The integrands are quadratic over a triangle; the three edge midpoints integrate them exactly.
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    area = 0.5 * np.cross(b - a, c - a)
    wrench = np.zeros(6)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        point = 0.5 * (corners[:, i] + corners[:, j]) - about
        pressure = DENSITY * GRAVITY * 0.5 * (heads[:, i] + heads[:, j])
        force = -(pressure / 3.0)[:, None] * area
        wrench += np.concatenate([force.sum(axis=0), np.cross(point, force).sum(axis=0)])
    return wrench


def random_poses(count: int, seed: int) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Poses: positions within 3 m sideways and 0.4 m of the level, any rotation, times to 10 s."""
    rng = np.random.default_rng(seed)
    return [
        (rng.uniform(-1.0, 1.0, 3) * [3.0, 3.0, 0.4], random_rotation(rng), rng.uniform(0.0, 10.0))
        for _ in range(count)
    ]


def relative_error(wrench: np.ndarray, truth: np.ndarray, hull: Hull) -> float:
    """Largest error of force and torque, relative to density * gravity * volume (* 1 m)."""
    return float(np.abs(wrench - truth).max() / (DENSITY * GRAVITY * hull.volume))


def mean_error(wrenches: list[np.ndarray], truths: list[np.ndarray], hull: Hull) -> float:
    """Mean of `relative_error` over several poses."""
    pairs = zip(wrenches, truths, strict=True)
    return float(np.mean([relative_error(wrench, truth, hull) for wrench, truth in pairs]))


def status_of(script: str, *arguments: object) -> int:
    """Exit status of a script that runs in this process, which is faster than starting one."""
    path = str(REPOSITORY / "scripts" / script)
    former, sys.argv = sys.argv, [path, *map(str, arguments)]
    handlers = [signal.getsignal(stop) for stop in command_line.STOPS]
    try:
        runpy.run_path(path, run_name="__main__")
    except SystemExit as left:
        return left.code
    finally:
        sys.argv = former
        for stop, handler in zip(command_line.STOPS, handlers, strict=True):
            signal.signal(stop, handler)


@contextmanager
def sending(number: int, when: Callable[[], bool]) -> Iterator[None]:
    """Send a signal to this process as soon as a condition holds, unless the block ends first."""
    ended = Event()

    def send() -> None:
        while not ended.wait(0.02):
            if when():
                os.kill(os.getpid(), number)
                return

    thread = Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def receive_ctrl_c() -> None:
    """Let a child process receive Ctrl-C; a `preexec_fn`. Background jobs ignore SIGINT, and their
    children inherit that."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
