"""Record the scenes and make their pictures in models/pictures/.

    python scripts/make_pictures.py              # all of them
    python scripts/make_pictures.py bunny trio   # some

Needs what scripts/snapshot.py needs.
"""

import tempfile
from pathlib import Path

from PIL import Image
from snapshot import main as snapshot

from command_line import Parser, notes_said, run_script
from sim import Recorder, Scene, simulate

MODELS = Path(__file__).resolve().parents[1] / "models"

TIMES = {
    "bunny": 4.75,
    "trio": 4.6,
    "cube": 2.0,
    "dragon": 3.0,
    "wigley": 4.0,
    "topheavy": 0.85,
    "spar": 5.0,
    "catamaran": 6.0,
    "robot": 6.0,
    "articulated": 4.2,
    "spheres": 2.5,
}
"""Simulated time [s] of the picture of each scene."""

EXTRA_TIME = 1.0
"""Seconds that are recorded after the picture's time, so that the plots continue."""

WINDOW_SIZE = (1600, 928)
TABS_HEIGHT = 28
LARGE_SIZE, SMALL_SIZE = (1000, 562), (720, 405)
"""Sizes [pixels] of the window, of its row of tabs, which is cut off, of the pictures in the README
and of the others."""

IN_README = ("bunny", "trio")


def make_picture(name: str, output: Path) -> int:
    """Record a scene, make its picture and shrink it; return the exit status of snapshot.py."""
    with notes_said(quiet=True):
        scene = Scene.load(MODELS / f"{name}.xml")
    with tempfile.TemporaryDirectory() as folder:
        recording, picture = Path(folder) / "run.rrd", Path(folder) / "picture.png"
        with Recorder(recording, scene) as recorder:
            for sample in simulate(scene, TIMES[name] + EXTRA_TIME):
                recorder.log(sample)
        size = ["--width", str(WINDOW_SIZE[0]), "--height", str(WINDOW_SIZE[1])]
        asked = [str(recording), "--time", str(TIMES[name]), "--output", str(picture), *size]
        if status := snapshot(asked):
            return status
        image = Image.open(picture).convert("RGB").crop((0, TABS_HEIGHT, *WINDOW_SIZE))
        pixels = LARGE_SIZE if name in IN_README else SMALL_SIZE
        image = image.resize(pixels, Image.Resampling.LANCZOS)
        output.parent.mkdir(parents=True, exist_ok=True)
        image.save(output, optimize=True)
    print(f"{output}: {output.stat().st_size / 1e3:.0f} kB")
    return 0


def main(arguments: list[str] | None = None) -> int:
    parser = Parser(__doc__)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"{', '.join(TIMES)} (all)")
    parser.add_argument(
        "--output", type=Path, default=MODELS / "pictures", metavar="FOLDER", help="models/pictures"
    )
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.scenes) - set(TIMES))
    if unknown:
        parser.error(f"no scene {', '.join(unknown)}; choose from {', '.join(TIMES)}")
    statuses = (
        make_picture(name, options.output / f"{name}.png")
        for name in TIMES
        if name in (options.scenes or TIMES)
    )
    return next((status for status in statuses if status), 0)


if __name__ == "__main__":
    run_script(main)
