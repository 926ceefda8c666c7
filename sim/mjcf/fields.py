"""Fields: the table of all custom elements that describe the water and the hulls.

A scene is one MJCF file; its `<custom>` element describes the water. Each field is described here
once. Refusals, `--help` and the documentation are printed from this table.

The tuple `buoyant` lists geoms, whose surfaces are hulls, and bodies. A body stands for all geoms
of its subtree that collide, or for all geoms if none collides.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import cycle
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from sim.methods import METHODS, Settings
from sim.methods.chord import MOST_SAMPLES
from sim.methods.reference import SMALLEST_TOLERANCE
from sim.resistance.hydrodynamics import COLUMN_SIZE, MOST_COLUMNS
from sim.water.gerstner import MOST_TIDES
from sim.water.head import PRESSURES
from sim.water.sea import DEFAULT_PRESSURE
from sim.water.spectrum import LARGEST_SEED, MOST_WAVES, SMALLEST_NUMBER, WIDEST_SPREAD

Numbers = Sequence[float] | NDArray[np.float64]

LARGEST_NUMBER = 1e9
"""Default bound of numbers, in any unit."""

BUOYANT = "buoyant"
"""The tuple that lists the floating geoms and bodies."""

COMPONENTS, RECORD = "sea_components", "sea_record"
"""The texts that name files of waves."""

MEMORY, HYDRODYNAMICS = "memory_", "hydrodynamics_"
"""Beginnings of the fields of one body: its memory, and the file of its coefficients."""

METHOD, PRESSURE, TOLERANCE = "buoyancy_method", "water_pressure", "buoyancy_tolerance"

HULL, OVERLAP = "hull", "overlap"
"""The texts that say how hulls are made."""

MESH, CONVEX = "mesh", "convex"
"""Contents of HULL; the first is the default."""

KEEP, CUT = "keep", "cut"
"""Contents of OVERLAP; the first is the default."""

WATER_PREFIXES = ("water", "wave_", "sea_")
"""Beginnings of the names of fields that describe the water."""

PREFIXES = (
    *WATER_PREFIXES, "wave", "buoyan", "chord_", "reference_", "drag_", "added_mass", "damping",
    "displaced", MEMORY, HYDRODYNAMICS,
)  # fmt: skip
"""Beginnings of names that belong to this table. An unknown name with such a beginning is a typing
error and is refused."""

NEARNESS = 0.8
"""Least likeness of two names, from 0 to 1, at which one is likely the other with a typing error. A
letter that is missing or added in a name of four letters gives 0.86 or more."""


@dataclass(frozen=True)
class Number:
    """One number of a field.

    least, most: its bounds; is_above excludes `least` itself. is_whole: whether it is a whole
    number. default: its value if the field leaves it out.
    """

    name: str
    unit: str = ""
    least: float = -LARGEST_NUMBER
    most: float = LARGEST_NUMBER
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
        """Whether the value is within the bounds; NaN is not."""
        if not self.least <= value <= self.most or (self.is_above and value == self.least):
            return False
        return not self.is_whole or value == int(value)

    def check(self, value: float) -> None:
        """Raise ValueError for a value out of bounds."""
        if not self.allows(value):
            quantity = f"{value:g} {self.unit}".strip()
            raise ValueError(f"the {self.name} is {quantity}; it must be {self.expected}")


@dataclass(frozen=True)
class NumericField:
    """A field that is a custom numeric.

    meaning: one line of documentation. numbers: in order; the numbers after the first `needed` are
    optional. counts: the allowed counts, if the field is a row of one kind of number. per_geom:
    whether `<name>_<geom>` sets it for one geom, or for all geoms below one body.
    """

    meaning: str
    numbers: tuple[Number, ...]
    needed: int = 0
    counts: tuple[int, ...] = ()
    per_geom: bool = False

    @property
    def allowed_counts(self) -> tuple[int, ...]:
        if self.counts:
            return self.counts
        return tuple(range(self.needed or len(self.numbers), len(self.numbers) + 1))

    @property
    def units(self) -> str:
        """The numbers with their units, as one line."""
        return ", ".join(f"{n.name} {n.unit}".strip() for n in self.numbers)

    def check(self, values: Numbers) -> None:
        """Raise ValueError for a wrong count, or for a number out of bounds."""
        count, allowed = len(values), self.allowed_counts
        if count not in allowed:
            first, *others = map(str, allowed)
            expected = (
                f"{first} to {others[-1]}" if len(others) > 1 else " or ".join([first, *others])
            )
            if self.counts and len(others) > 2:
                expected = f"{first}, {others[0]}, {others[1]}, ... or {others[-1]}"
            raise ValueError(
                f"has {count} number{'s' * (count != 1)}; expected {expected}: {self.units}"
            )
        for number, value in zip(cycle(self.numbers), values, strict=False):
            number.check(value)

    def filled(self, values: Numbers) -> list[float]:
        """The values, followed by the defaults of the numbers that were left out."""
        return [*map(float, values), *(n.default for n in self.numbers[len(values) :])]


@dataclass(frozen=True)
class TextField:
    """A field that is a custom text. value: the text's content, for the documentation. choices: all
    contents that it may have, where this table knows them."""

    meaning: str
    value: str
    per_geom: bool = False
    choices: tuple[str, ...] = ()


def _positive(name: str, unit: str, most: float, default: float = 0.0) -> Number:
    return Number(name, unit, SMALLEST_NUMBER, most, is_above=True, default=default)


def _switch(name: str) -> Number:
    return Number(name, "", 0, 1, is_whole=True, default=1)


_HEADING = Number("heading", "deg")
_HEIGHT = _positive("significant height", "m", 1e3)
_PERIOD = _positive("peak period", "s", 1e3)
_SEA = (
    _HEADING,
    Number("spread", "deg", 0.0, np.degrees(0.999 * WIDEST_SPREAD),
           default=25.0),
    Number("number of waves", "", 1, MOST_WAVES, is_whole=True, default=40),
    Number("seed", "", 0, LARGEST_SEED, is_whole=True),
)  # fmt: skip
"""The last numbers of every irregular sea: how its spectrum is divided into waves."""

NUMERICS = {
    "wave_<name>": NumericField(
        "one Gerstner wave",
        (
            Number("amplitude", "m", 0.0, 1e4), _positive("wavelength", "m", 1e6), _HEADING,
            Number("phase", "deg"),
        ),
    ),
    "sea_jonswap": NumericField(
        "irregular sea with the JONSWAP spectrum",
        (_HEIGHT, _PERIOD, Number("gamma", "", 1.0, 100.0, default=3.3), *_SEA),
        needed=2,
    ),
    "sea_bretschneider": NumericField(
        "irregular sea with Bretschneider's spectrum", (_HEIGHT, _PERIOD, *_SEA), needed=2
    ),
    "sea_pierson_moskowitz": NumericField(
        "fully developed sea; its period follows from the height", (_HEIGHT, *_SEA), needed=1
    ),
    "sea_ochi_hubble": NumericField(
        "swell and wind sea together",
        (
            _positive("swell height", "m", 1e3), _positive("swell period", "s", 1e3),
            Number("swell sharpness", "", 0.5, 30.0), _positive("wind sea height", "m", 1e3),
            _positive("wind sea period", "s", 1e3), Number("wind sea sharpness", "", 0.5, 30.0),
            *_SEA,
        ),
        needed=6,
    ),
    RECORD: NumericField(
        "how the record of the text `sea_record` is read: its band of periods and its place",
        (
            _HEADING, _positive("shortest period", "s", 1e3, default=1.0),
            _positive("longest period", "s", 1e6, default=60.0), Number("x", "m"), Number("y", "m"),
        ),
        needed=1,
    ),
    "water_density": NumericField(
        "density of the water; the default is sea water at 15 degrees C and 35 g/kg of salt",
        (_positive("water density", "kg/m^3", 1e6, default=1025.0),),
    ),
    "water_level": NumericField(
        "height of the still water; pairs of a time and a level give a tide, linear in between",
        (Number("water level m, or number of pairs of time s and level m", "", -1e6, 1e6),),
        counts=(1, *range(4, 2 * MOST_TIDES + 1, 2)),
    ),
    "water_depth": NumericField(
        "depth of the bottom below the still water at the start; left out, the water is deep",
        (_positive("water depth", "m", 1e6, default=np.inf),),
    ),
    "water_current": NumericField(
        "velocity of all of the water; the waves travel on it",
        tuple(Number(f"current along {axis}", "m/s", -100.0, 100.0) for axis in "xyz"),
        needed=2,
    ),
    "water_ramp": NumericField(
        "time in which the waves grow from nothing", (Number("water ramp", "s", 0.0, 1e6),)
    ),
    "water_stokes": NumericField(
        "1 adds the Stokes drift of the waves to the water's velocity, which drag follows",
        (Number("Stokes drift", "", 0, 1, is_whole=True),),
    ),
    "water_drawn": NumericField(
        "0 hides the water in MuJoCo's own pictures", (_switch("drawing of the water"),)
    ),
    TOLERANCE: NumericField(
        "error of the water height that `patches` allow; left out, patches choose it",
        (_positive("buoyancy tolerance", "m of water height", 1e6),),
        per_geom=True,
    ),
    "chord_samples": NumericField(
        "points that `chord` puts on each chord of the waterline",
        (Number("number of samples", "", 0, MOST_SAMPLES, is_whole=True,
                default=Settings.chord_samples),),
    ),
    "reference_tolerance": NumericField(
        "error that `reference` converges to",
        (Number("reference tolerance", "of rho g V", SMALLEST_TOLERANCE, 1.0,
                default=Settings.reference_tolerance),),
    ),
    "buoyancy_union": NumericField(
        "0 keeps overlapping hulls of one body apart; their shared volume then counts twice",
        (_switch("union of overlapping hulls"),),
    ),
    "displaced": NumericField(
        "volume that a geom displaces, over the volume of its hull",
        (_positive("displaced volume over the hull's", "", 1e3, default=1.0),),
        per_geom=True,
    ),
    "drag_angular": NumericField(
        "decay rate of the angular momentum",
        (Number("angular drag coefficient", "1/s", 0.0),),
        per_geom=True,
    ),
    "drag": NumericField(
        "drag coefficients: wave making, eddies, skin friction",
        tuple(Number(f"{kind} drag coefficient", "", 0.0) for kind in
              ("linear", "form", "friction")),
        per_geom=True,
    ),
    "added_mass": NumericField(
        "added mass: six shares of the displaced water's mass and inertia, or a 6 x 6 matrix",
        (Number("coefficient of added mass, or number of its matrix row by row", "", -1e12, 1e12),),
        counts=(6, 36),
        per_geom=True,
    ),
    "damping_quadratic": NumericField(
        "quadratic damping relative to the water: its diagonal, or a 6 x 6 matrix",
        (Number("quadratic damping in N s^2/m^2 or N m s^2, or number of its matrix row by row",
                "", -1e12, 1e12),),
        counts=(6, 36),
        per_geom=True,
    ),
    "damping": NumericField(
        "linear damping relative to the water: its diagonal, or a 6 x 6 matrix",
        (Number("damping in N s/m or N m s, or number of its matrix row by row", "", -1e12, 1e12),),
        counts=(6, 36),
        per_geom=True,
    ),
    MEMORY + "<body>": NumericField(
        "memory of the waves that a body makes, in its inertial frame: any number of such rows",
        (
            _positive("a0", "1/s^2", 1e6), _positive("a1", "1/s", 1e6),
            *(Number(f"l along {axis}", "kg^0.5/s") for axis in "xyz"),
            *(Number(f"l about {axis}", "m kg^0.5/s") for axis in "xyz"),
        ),
        counts=tuple(range(COLUMN_SIZE, COLUMN_SIZE * MOST_COLUMNS + 1, COLUMN_SIZE)),
    ),
}  # fmt: skip
"""All numerics by name. A name comes after longer names that begin with it: `drag_angular`,
`drag`."""

TEXTS = {
    COMPONENTS: TextField(
        "waves from a file: amplitude m, wavelength m or period s, heading deg, phase deg",
        "a CSV file beside the scene",
    ),
    RECORD: TextField(
        "a sea whose elevation at one place is a record: time s, elevation m",
        "a CSV file beside the scene",
    ),
    PRESSURE: TextField(
        f"pressure under the waves ({DEFAULT_PRESSURE})", " or ".join(PRESSURES)
    ),
    METHOD: TextField(
        "how wrenches are computed (patches)", ", ".join(METHODS), per_geom=True
    ),
    HULL: TextField(
        f"hull of a mesh: its surface, or the convex hull of its vertices ({MESH})",
        f"{MESH} or {CONVEX}", per_geom=True, choices=(MESH, CONVEX),
    ),
    OVERLAP: TextField(
        f"`{CUT}` takes off a hull what it shares with other hulls of its tree at qpos0 ({KEEP})",
        f"{KEEP} or {CUT}", per_geom=True, choices=(KEEP, CUT),
    ),
    HYDRODYNAMICS + "<body>": TextField(
        "added mass, memory and diffraction of a body, from a panel code",
        "a file of scripts/coefficients.py beside the scene",
    ),
}  # fmt: skip
"""All texts by name."""


def numeric_base(name: str) -> str | None:
    """The entry of NUMERICS that a name belongs to; None for an unknown name."""
    return _base(name, NUMERICS)


def text_base(name: str) -> str | None:
    """The entry of TEXTS that a name belongs to; None for an unknown name."""
    return _base(name, TEXTS)


def _base(name: str, table: dict[str, NumericField] | dict[str, TextField]) -> str | None:
    for base, field in table.items():
        stem, named, _ = base.partition("<")
        if name.startswith(stem) if named else name == base:
            return base
        if field.per_geom and name.startswith(f"{base}_"):
            return base
    return None


def names_file(name: str) -> bool:
    """Whether a text, with the prefix of an attached model or without, names a file."""
    return name.endswith((COMPONENTS, RECORD)) or HYDRODYNAMICS in name


def is_ours(name: str) -> bool:
    """Whether a name belongs to this table; it may still be unknown."""
    return name.startswith(PREFIXES) or name == "drag"


def nearest(name: str) -> str | None:
    """The field, or the tuple `buoyant`, whose name another one nearly is; None if there is none.
    The first words are compared, too, because the others may be those of a wave or a geom."""
    fields = {base.partition("_<")[0]: base for base in (*NUMERICS, *TEXTS, BUOYANT)}
    words = re.split(r"[^a-z0-9]+", name.lower())
    for count in range(len(words), 0, -1):
        close = get_close_matches("_".join(words[:count]), fields, n=1, cutoff=NEARNESS)
        if close:
            return fields[close[0]]
    return None


def check_numeric(name: str, values: Numbers) -> None:
    """Raise ValueError for an unknown numeric, a wrong count, or a number out of bounds."""
    base = numeric_base(name)
    if base is None:
        refuse_unknown("numeric", name, ", ".join(_names(NUMERICS)))
    try:
        NUMERICS[base].check(values)
    except ValueError as error:
        colon = "" if str(error).startswith("has ") else ":"
        raise ValueError(f"custom numeric '{name}'{colon} {error}") from None


def check_text(name: str, content: str) -> None:
    """Raise ValueError for an unknown text, or for a content that is not one of its choices."""
    base = text_base(name)
    if base is None:
        refuse_unknown("text", name, ", ".join(_names(TEXTS)))
    if TEXTS[base].choices and content not in TEXTS[base].choices:
        raise ValueError(f"custom text '{name}' is '{content}'; expected {TEXTS[base].value}")


def refuse_unknown(kind: str, name: str, known: str) -> NoReturn:
    expected = nearest(name) or known
    raise ValueError(
        f"custom {kind} '{name}' is unknown; expected {expected}: correct or rename it"
    )


def _names(table: dict[str, NumericField] | dict[str, TextField]) -> list[str]:
    return [name + "[_<geom>]" * field.per_geom for name, field in table.items()]


def described() -> Iterator[tuple[str, str, str]]:
    """A row (name, value, meaning) of documentation for each field. The value lists numbers and
    units, with defaults in brackets."""
    for field, name in zip(NUMERICS.values(), _names(NUMERICS), strict=True):
        numbers = []
        for i, number in enumerate(field.numbers):
            is_optional = i >= field.needed if field.needed else bool(number.default)
            default = f" ({number.default:g})" if is_optional else ""
            numbers.append(f"{number.name} {number.unit}".strip() + default)
        is_matrix = field.counts == (6, 36)
        count = f"{' or '.join(map(str, field.counts))} x " if is_matrix else ""
        yield name, count + ", ".join(numbers), field.meaning
    for (_, field), name in zip(TEXTS.items(), _names(TEXTS), strict=True):
        yield name, f"text: {field.value}", field.meaning
