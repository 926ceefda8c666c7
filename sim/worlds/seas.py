"""Seas: the tables of one sea for each world, or of fewer seas in turn."""

from collections.abc import Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from sim.methods import Patches
from sim.methods.method import Settings
from sim.methods.patches.fit import Level, jet_tolerance, jet_waves
from sim.methods.patches.patches import SOLVE, solve_table
from sim.methods.patches.sizes import default_tolerance
from sim.resistance.drag import Drag
from sim.resistance.probes import PROBE_ERROR, probe_error, sampled_motions
from sim.water.gerstner import WATER, WAVE
from sim.water.sea import ELEVATION_ERROR, Sea
from sim.worlds.programs import single

Table = NDArray[np.void]

SINGLE_ELEVATION_ERROR = 1e-8
"""Error [m] of an elevation from the solver in single precision."""

JUDGED_SEAS = 3
"""Number of seas, among those with the steepest waves and those with the shortest, for which hulls
are cut. The search for a patch's size takes a tenth of a second for each."""

LARGEST_EXCESS, LARGEST_DRAG_EXCESS = 1.5, 4.0
"""Largest error in other seas than the model's: of the head over a patch, in tolerances, and of the
water's motion between a hull's probes, in PROBE_ERRORs."""


def wave_rows(tables: Sequence[Table], count: int) -> Table:
    """WAVE tables of different lengths as one, (seas, count). Missing waves have no height."""
    found = np.zeros((len(tables), count), WAVE)
    for row, table in zip(found, tables, strict=True):
        row[: len(table)] = table
    return found


def water_rows(seas: Sequence[Sea]) -> tuple[Table, Table]:
    """WATER rows of seas in double and in single precision."""
    rows = np.concatenate([sea.water for sea in seas]).astype(WATER)
    narrow = rows.copy()
    narrow["tolerance"] *= np.sqrt(SINGLE_ELEVATION_ERROR / ELEVATION_ERROR)
    narrow["tolerance"] = np.minimum(narrow["tolerance"], 1e30)
    return rows, single(narrow)


def judged(seas: Sequence[Sea]) -> list[Sea]:
    """The seas that ask most of patches: those with the steepest waves and the shortest."""
    if len(seas) == 1:
        return list(seas)
    steepest = sorted(seas, key=lambda sea: -sea.worst_steepness)[:JUDGED_SEAS]
    bent = sorted(seas, key=lambda sea: -float(sea.components["kkka"].sum()))[:JUDGED_SEAS]
    return list({id(sea): sea for sea in (*steepest, *bent)}.values())


def cut_for(method: Patches, seas: Sequence[Sea]) -> Patches:
    """The method, cut for the sea of these that takes the smallest patches."""
    if list(seas) == [method.sea]:
        return method
    is_default = method.is_coarse or method.tolerance == default_tolerance(method.hull)
    settings = Settings(buoyancy_tolerance=None if is_default else method.tolerance)
    made = [Patches.from_settings(method.hull, sea, settings) for sea in judged(seas)]
    return min(made, key=lambda each: each.radius)


def solve_row(methods: Sequence[Patches], seas: Sequence[Sea]) -> Table:
    """One SOLVE row for all trees and seas."""
    row = np.zeros(1, SOLVE)
    found = [solve_table([at_sea(m, sea) for m in methods]) for sea in judged(seas) if methods]
    for name in ("steps", "squeeze", "reach"):
        row[name] = max((each[name][0] for each in found), default=0)
    row["residual"] = min((each["residual"][0] for each in found), default=0.0)
    row["residual"] = np.maximum(row["residual"], water_rows(judged(seas))[1]["tolerance"].min())
    return single(row)


def at_sea(method: Patches, sea: Sea) -> Patches:
    """The method with the same tree in another sea."""
    if sea is method.sea:
        return method
    found = copy(method)
    found.sea, found.levels = sea, (Level(method.radius, 0.0, 0.0, jet_waves(sea, method.radius)),)
    return found


def check_patches(methods: Sequence[Patches], seas: Sequence[Sea]) -> None:
    """Raise ValueError for seas whose waves the patches cannot follow."""
    for method in methods:
        for sea in judged(seas):
            error = jet_tolerance(sea, method.radius, squeeze=method.squeeze)
            allowed = LARGEST_EXCESS * float(method.tolerance or np.inf)
            if sea.waves and error > allowed:
                raise ValueError(
                    f"the patches of a hull follow the waves of a new sea to {error:.2g} m; "
                    f"expected {allowed:.2g} m: give a sea with waves as short and steep to "
                    "on_warp, which cuts the hulls for it"
                )


def check_probes(drags: Sequence[Drag], seas: Sequence[Sea]) -> None:
    """Raise ValueError for seas in which a few probes do not stand for the water around a hull."""
    for drag in (each for each in drags if len(each.probes)):
        for sea in (each for each in judged(seas) if each.waves and each is not drag.sea):
            motions = sampled_motions(drag.surface, drag.strength, sea, seed=1)
            error = probe_error(drag.probes, drag.surface, *motions)
            if error > LARGEST_DRAG_EXCESS * PROBE_ERROR:
                raise ValueError(
                    f"the drag of a hull takes the water's velocity in a sea to {error:.2g} of its "
                    f"size; expected {LARGEST_DRAG_EXCESS * PROBE_ERROR:.2g}: put waves as short "
                    "into the model, which chooses where drag computes the water for its own sea"
                )
