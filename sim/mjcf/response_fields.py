"""Response fields: from a model's custom fields and files to the responses of its bodies."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.geometry import moved_matrix
from sim.mjcf.drag_fields import DragFields, check_diagonal
from sim.mjcf.fields import HYDRODYNAMICS, MEMORY, Numbers
from sim.mjcf.floats import body_label
from sim.mjcf.geoms import frame_rotation
from sim.resistance.added_mass import damping_matrix
from sim.resistance.diffraction import scattering
from sim.resistance.hydrodynamics import COLUMN_SIZE, Hydrodynamics, check_memory
from sim.resistance.response import Response
from sim.water.sea import Sea

Array = NDArray[np.float64]

STRONGEST_COLUMN = 100.0
"""Largest plausible l^2 of a column, in hull volume * density * gravity / length, or times length^2
for rotations. A sphere has 0.3. A larger one is refused as an error of units; the states would be
unstable at usual timesteps."""

NOTED_DIFFERENCE = 0.01
"""Relative difference of density, gravity or depth from those of a file that is noted."""

WIDEST_GAP = 50.0
"""Largest difference [deg] of two headings of a file between which a wave's heading is not
noted."""

NOTED_ENERGY_SHARE = 1e-3
"""Share of the waves' energy beyond the frequencies of a file that is noted."""


def bodies_with_responses(
    model: mujoco.MjModel, prefix: str, numerics: Mapping[str, Array], texts: Mapping[str, str]
) -> Iterator[tuple[int, str, str]]:
    """The id of each body with a response, and the names of its fields MEMORY and HYDRODYNAMICS. ""
    for a field that it has not. The id is -1 if there is no such body."""
    beginnings = ((MEMORY, numerics), (HYDRODYNAMICS, texts))
    names = {n.removeprefix(b) for b, fields in beginnings for n in fields if n.startswith(b)}
    for name in sorted(names):
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, prefix + name)
        memory, file = (b + name if b + name in fields else "" for b, fields in beginnings)
        yield body, memory, file


def check_response(
    model: mujoco.MjModel,
    body: int,
    memory: str,
    file: str,
    hulls: Sequence[tuple[int, DragFields]],
) -> None:
    """Refuse a response of a body that does not float, or with fields that say a thing twice.
    hulls: the body and the resistance of each hull."""
    source = f"custom numeric '{memory}'" if memory else f"custom text '{file}'"
    own = [fields for b, fields in hulls if b == body]
    if not own:
        names = sorted({body_label(model, b) for b, _ in hulls})
        raise ValueError(
            f"{source} names no body with a geom of the tuple 'buoyant' (which has "
            f"{', '.join(names)}); correct the name or list the body"
        )
    if memory and file:
        raise ValueError(
            f"{source} and custom text '{file}' both give the memory of the body; remove one"
        )
    for fields in own if file else []:
        if fields.values.get("added_mass", np.zeros(1)).any():
            raise ValueError(
                f"{source} and custom numeric '{fields.sources['added_mass']}' both give the added "
                f"mass of body '{body_label(model, body)}'; remove the numeric, or set it to six 0 "
                f"for this body: 'added_mass_{body_label(model, body)}'"
            )


@dataclass(frozen=True)
class Size:
    """The size of a body: volume [m^3] of its hulls and what of it is submerged at rest, and the
    largest length [m] of a hull."""

    volume: float
    afloat: float
    length: float


def _check_strength(memory: Array, size: Size, sea: Sea) -> None:
    """Refuse columns (N, 8) of a memory that are too strong for a body."""
    limit = STRONGEST_COLUMN * sea.density * sea.gravity * size.volume / size.length
    for unit, columns, most in (
        ("kg/s^2", memory[:, 2:5], limit), ("kg m^2/s^2", memory[:, 5:], limit * size.length**2)
    ):  # fmt: skip
        squares = (columns**2).sum(axis=1)
        if (squares > most).any():
            row = int(np.argmax(squares))
            raise ValueError(
                f"the memory's l^2 is {squares[row]:.4g} {unit} in row {row + 1}; expected at most "
                f"{most:.4g} for this hull: use kg, m and s"
            )


def memory_response(
    model: mujoco.MjModel, body: int, source: str, rows: Numbers, sea: Sea, size: Size
) -> Response:
    """The response of a body with rows (8 N,) of a memory in its inertial frame. Raises
    ValueError."""
    try:
        memory = check_memory(np.reshape(rows, (-1, COLUMN_SIZE)))
        _check_strength(memory, size, sea)
    except ValueError as error:
        raise ValueError(f"custom numeric '{source}': {error}") from None
    own = Hydrodynamics(
        model.body_ipos[body], frame_rotation(model.body_iquat[body]), np.zeros((6, 6)), memory,
        np.empty(0), np.empty(0), np.empty((0, 0, 6), complex), sea.density, sea.gravity, sea.depth,
    )  # fmt: skip
    none = scattering(own, sea.components)
    return Response(body, size.afloat, own, np.zeros((6, 6)), none, is_relative=True)


def file_response(
    model: mujoco.MjModel, body: int, source: str, name: str, fields: DragFields, sea: Sea,
    size: Size,
) -> Response:  # fmt: skip
    """The response of a body with a file of coefficients. fields: the resistance of the body, whose
    damping becomes part of the response. Raises ValueError."""
    try:
        own = Hydrodynamics.load(Path(name))
        _check_strength(own.memory, size, sea)
        inertial = frame_rotation(model.body_iquat[body])
        place = inertial.T @ (own.position - model.body_ipos[body])
        turn = inertial.T @ own.rotation  # of the rest frame in the inertial frame
        added_mass = moved_matrix(own.added_mass, -turn.T @ place, turn.T)
        check_diagonal(model, body, added_mass)
        damping = np.zeros((6, 6))
        if "damping" in fields.values:
            given = fields.values["damping"]
            share = 1.0 if given.size == 36 else size.afloat / size.volume
            damping = share * moved_matrix(damping_matrix(given), place, turn)
    except (ValueError, OSError) as error:
        raise ValueError(f"custom text '{source}': {error}") from None
    return Response(
        body, size.afloat, own, damping, scattering(own, sea.components), is_relative=False
    )


def notes_about_response(
    model: mujoco.MjModel, response: Response, fields: DragFields, sea: Sea
) -> Iterator[str]:
    """Notes about the response of a body: likely mistakes, and what its coefficients lack."""
    label, own = f"body '{body_label(model, response.body)}'", response.coefficients
    drag = fields.values.get("drag", np.zeros(3))
    if drag[0] > 0.0 and len(own.memory):
        yield (
            f"{label}: its memory has the waves that it makes, and the linear drag coefficient "
            f"{drag[0]:g} of '{fields.sources['drag']}' adds more; set that to 0"
        )
    if response.is_relative:
        return
    for name in ("density", "gravity", "depth"):
        there, here = getattr(own, name), getattr(sea, name)
        if there != here and not abs(there - here) <= NOTED_DIFFERENCE * min(there, here):
            yield (
                f"{label}: its hydrodynamics are for a {name} of {there:g}, and the scene's is "
                f"{here:g}; make them again for this water"
            )
    if sea.waves:
        yield from _about_diffraction(label, own, sea)


def _about_diffraction(label: str, own: Hydrodynamics, sea: Sea) -> Iterator[str]:
    """Notes about waves that are beyond the frequencies or between the headings of a file."""
    waves, band = sea.components, own.frequencies
    if not len(band):
        yield f"{label}: its hydrodynamics have no diffraction, so the waves pass it unscattered"
        return
    energy, is_short = waves["amplitude"] ** 2, waves["rate"] > band[-1]
    share = float(energy[is_short].sum() / max(energy.sum(), np.finfo(float).tiny))
    if share > NOTED_ENERGY_SHARE:
        yield (
            f"{label}: {np.count_nonzero(is_short)} of {len(waves)} waves, with "
            f"{100.0 * share:.2g} % of the energy, are shorter than the shortest of its "
            f"hydrodynamics ({2.0 * np.pi / band[-1]:.3g} s) and are not scattered; make them "
            "again with higher frequencies"
        )
    gaps = np.degrees(np.diff(np.append(own.headings, own.headings[0] + 2.0 * np.pi)))
    if gaps.max() > WIDEST_GAP + 1e-6:
        yield (
            f"{label}: two headings of its hydrodynamics are {gaps.max():.3g} deg apart, and "
            "diffraction is interpolated linearly between them; make them again with headings all "
            f"around, at most {WIDEST_GAP:g} deg apart"
        )
