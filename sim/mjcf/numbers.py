"""Numbers: what the custom numerics of ours hold, and which values can be.

The one description from which a model's numbers are checked, and from which the tests draw numbers
that have to be refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle

import numpy as np

from sim.methods.chord import MOST_SAMPLES
from sim.water.gerstner import MOST_TIDES
from sim.water.spectrum import MOST_SEED, MOST_WAVES, WIDEST_SPREAD

LARGEST = 1e9
"""What is described as finite only may be so large, of any unit."""

MOST_THREADS = 1024


@dataclass(frozen=True)
class Number:
    """One number of a custom numeric: what it is, its unit, which values it may have, from `least`,
    or above it, to `most`, and what holds where it is left out."""

    name: str
    unit: str = ""
    least: float = -LARGEST
    most: float = LARGEST
    is_above: bool = False
    is_whole: bool = False
    default: float = 0.0

    @property
    def expected(self) -> str:
        if self.is_whole:
            return f"a whole number from {self.least:g} to {self.most:g}"
        low = f"above {self.least:g}" if self.is_above else f"{self.least:g} or more"
        return f"{low} and at most {self.most:g}"

    def allows(self, value: float) -> bool:
        """Whether a value can be."""
        if not self.least <= value <= self.most:  # NaN neither
            return False
        if self.is_above and value == self.least:
            return False
        return not self.is_whole or value == int(value)

    def check(self, value: float) -> None:
        """Raises ValueError for a value that cannot be."""
        if not self.allows(value):
            found = f"{value:g} {self.unit}".strip()
            raise ValueError(f"the {self.name} is {found}; it must be {self.expected}")


@dataclass(frozen=True)
class NumericKind:
    """What a custom numeric of ours holds: its numbers, of which those behind the first `needed`
    may be left out, and whether a geom may have its own ('<name>_<geom>'). With sizes, there are so
    many of the one number."""

    numbers: tuple[Number, ...]
    needed: int = 0
    per_geom: bool = False
    of_one: tuple[int, ...] = ()

    @property
    def sizes(self) -> tuple[int, ...]:
        """How many numbers there may be."""
        return self.of_one or tuple(range(self.needed or len(self.numbers), len(self.numbers) + 1))

    @property
    def meaning(self) -> str:
        return ", ".join(f"{n.name} {n.unit}".strip() for n in self.numbers)

    def check_count(self, count: int) -> None:
        """Raises ValueError for too many numbers, or too few."""
        if count in self.sizes:
            return
        first, *others = map(str, self.sizes)
        expected = f"{first} to {others[-1]}" if len(others) > 1 else " or ".join([first, *others])
        if self.of_one and len(others) > 2:  # not all that lie between
            expected = f"{first}, {others[0]}, {others[1]}, ... or {others[-1]}"
        raise ValueError(
            f"has {count} number{'s' * (count != 1)}; expected {expected}: {self.meaning}"
        )

    def filled(self, values: Sequence[float]) -> list[float]:
        """The numbers with those that were left out."""
        return [*map(float, values), *(n.default for n in self.numbers[len(values) :])]

    def check(self, values: Sequence[float]) -> None:
        """Raises ValueError for numbers that cannot be."""
        for number, value in zip(cycle(self.numbers), values, strict=False):
            number.check(value)


def _kind(*numbers: Number, **options: object) -> NumericKind:
    return NumericKind(numbers, **options)


_HEADING = Number("heading", "deg")
_HEIGHT = Number("significant height", "m", 0.0, 1e3, is_above=True)
_PERIOD = Number("peak period", "s", 0.0, 1e3, is_above=True)
_SEA = (
    _HEADING,
    Number("spread", "deg", 0.0, np.degrees(0.999 * WIDEST_SPREAD), default=25.0),
    Number("number of waves", "", 1, MOST_WAVES, is_whole=True, default=40),
    Number("seed", "", 0, MOST_SEED, is_whole=True),
)
"""What all irregular seas may have behind their shape."""

WAVE = _kind(
    Number("amplitude", "m", 0.0, 1e4),
    Number("wavelength", "m", 0.0, 1e6, is_above=True),
    _HEADING,
    Number("phase", "deg"),
)

NUMERICS = {
    "water_density": _kind(Number("water density", "kg/m^3", 0.0, 1e6, is_above=True)),
    "water_level": _kind(
        Number("water level m, or number of pairs of time s and level m", "", -1e6, 1e6),
        of_one=(1, *range(4, 2 * MOST_TIDES + 1, 2)),
    ),
    "water_current": _kind(
        Number("current along x", "m/s", -100.0, 100.0),
        Number("current along y", "m/s", -100.0, 100.0),
        Number("current along z", "m/s", -100.0, 100.0),
        needed=2,
    ),
    "water_ramp": _kind(Number("water ramp", "s", 0.0, 1e6)),
    "water_drawn": _kind(Number("drawing of the water (0 for none)", "", 0, 1, is_whole=True)),
    "sea_jonswap": _kind(
        _HEIGHT, _PERIOD, Number("gamma", "", 1.0, 100.0, default=3.3), *_SEA, needed=2
    ),
    "sea_bretschneider": _kind(_HEIGHT, _PERIOD, *_SEA, needed=2),
    "sea_pierson_moskowitz": _kind(_HEIGHT, *_SEA, needed=1),
    "sea_ochi_hubble": _kind(
        Number("swell height", "m", 0.0, 1e3, is_above=True),
        Number("swell period", "s", 0.0, 1e3, is_above=True),
        Number("swell sharpness", "", 0.5, 30.0),
        Number("wind sea height", "m", 0.0, 1e3, is_above=True),
        Number("wind sea period", "s", 0.0, 1e3, is_above=True),
        Number("wind sea sharpness", "", 0.5, 30.0),
        *_SEA,
        needed=6,
    ),
    "sea_record": _kind(
        _HEADING,
        Number("shortest period", "s", 0.0, 1e3, is_above=True, default=1.0),
        Number("longest period", "s", 0.0, 1e6, is_above=True, default=60.0),
        Number("x", "m"),
        Number("y", "m"),
        needed=1,
    ),
    "buoyancy_tolerance": _kind(
        Number("buoyancy tolerance", "m of water height", 0.0, 1e6, is_above=True)
    ),
    "buoyancy_threads": _kind(Number("number of threads", "", 1, MOST_THREADS, is_whole=True)),
    "buoyancy_union": _kind(
        Number("union of overlapping hulls (0 leaves them alone)", "", 0, 1, is_whole=True)
    ),
    "displaced": _kind(
        Number("displaced volume over the hull's", "", 0.0, 1e3, is_above=True), per_geom=True
    ),
    "chord_samples": _kind(Number("number of samples", "", 0, MOST_SAMPLES, is_whole=True)),
    "drag_angular": _kind(Number("angular drag coefficient", "1/s", 0.0), per_geom=True),
    "drag": _kind(
        Number("linear drag coefficient", "", 0.0),
        Number("form drag coefficient", "", 0.0),
        Number("friction drag coefficient", "", 0.0),
        per_geom=True,
    ),
    "added_mass": _kind(
        Number("coefficient of added mass, or number of its matrix row by row", "", -1e12, 1e12),
        per_geom=True, of_one=(6, 36),
    ),
    "damping": _kind(
        Number("damping in N s/m or N m s, or number of its matrix row by row", "", -1e12, 1e12),
        per_geom=True, of_one=(6, 36),
    ),
}  # fmt: skip
"""The custom numerics we know, besides the waves; a name that begins another comes before it."""
