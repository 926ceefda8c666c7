"""Look: colours, views, plots and texts of a recording."""

from collections.abc import Callable, Mapping

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from sim.recording.output import path_part
from sim.runs.tally import Tally
from sim.scenes.scene import Scene
from sim.water.words import sea_in_words

Array = NDArray[np.float64]

EYE_IN_HULLS, EYE_IN_SPREADS = 2.6, 0.9
"""Distance of the eye from its target, as a sum of lengths of the largest hull and distances
between the bodies."""

LARGEST_SLENDERNESS = 3.2
"""Largest apparent length of a hull, in cube roots of its volume. A whole slender hull would look
like a line."""

EYE_DIRECTION = np.array([-0.49, -0.78, 0.39])

MOST_PLOTTED = 6
"""Largest number of bodies in the plots and the overview. The series of the other bodies are in the
recording as rows of one entity, because separate entities take ten times the space. A scene with
more bodies has no trails."""

TROUGH_COLOUR, CREST_COLOUR = np.array([12.0, 50.0, 104.0]), np.array([122.0, 196.0, 228.0])
WATER_OPACITY = 125
SKY_COLOUR = (40, 56, 72)
WET_TINT, TINT_SHARE = np.array([20.0, 70.0, 130.0]), 0.4
"""Colour that is mixed into the colour of a wet surface, and its share."""

WATER_SERIES_COLOUR = np.array([90.0, 150.0, 200.0])
WATERLINE_COLOUR = (255, 255, 255)
FORCE_COLOURS = {"buoyancy": (80, 200, 120), "weight": (220, 80, 60), "drag": (240, 180, 60)}

COLOURS = ("wet", "pressure")
"""Colourings of hulls: the geom's colour, darker where it is wet, or the pressure."""

LEAST_HEAD_COLOUR, LARGEST_HEAD_COLOUR = (
    np.array([250.0, 235.0, 160.0]),
    np.array([150.0, 20.0, 40.0]),
)
DRY_COLOUR = np.array([170.0, 175.0, 180.0])

PLOTS = {
    "heave": "Heave, and the water [m]",
    "height": "Height [m]",
    "surge": "Surge [m]",
    "tilt": "Tilt [deg]",
    "heel": "Heel [deg]",
    "trim": "Trim [deg]",
    "force": "Buoyant force [weights]",
    "submerged": "Submerged [of the volume]",
}
"""Time series views: the name in entity paths and the title."""

TABS = (("heave", "height", "surge"), ("tilt", "heel", "trim"), ("force", "submerged"))
"""The plots in each row of tabs."""

DIFFERENCES = {
    "heave": "Heave minus the first [m]",
    "tilt": "Tilt minus the first [deg]",
}
"""Plots of the differences between twins, whose curves would hide one another."""

ROW_HEIGHTS = (1.0, 1.0, 1.0, 1.55)
"""Relative heights of the three rows of plots and the overview below them."""

SERIES = {
    "heave": "plots/heave/{}",
    "water_above_level": "plots/heave/{}/water",
    "height": "plots/height/{}",
    "water_height": "plots/height/{}/water",
    "surge": "plots/surge/{}",
    "tilt_deg": "plots/tilt/{}",
    "heel_deg": "plots/heel/{}",
    "trim_deg": "plots/trim/{}",
    "submerged_fraction": "plots/submerged/{}",
    "vertical_force": "plots/force/{}",
}
"""Entity path of each quantity of a plotted body."""

PLOT_WITH_LEGEND = "tilt"

WATER_QUANTITIES = ("water_above_level", "water_height")

OTHER_SERIES = {
    quantity: path.replace("plots/", "others/").replace("/{}", "")
    for quantity, path in SERIES.items()
}
"""Entity path of each quantity of all other bodies."""

SHADES = 256
"""Number of colours of a palette."""


def rounded(colour: Array) -> NDArray[np.uint8]:
    return np.round(colour).astype(np.uint8)


def shades(values: Array) -> NDArray[np.uint8]:
    """Indices into a palette of values from -1/2 to 1/2; other values are clipped."""
    return np.clip(SHADES * (values + 0.5), 0.0, SHADES - 1.0).astype(np.uint8)


def palette(first: Array, last: Array) -> NDArray[np.uint32]:
    """SHADES opaque colours between two colours (3,), 0 to 255, in Rerun's format 0xRRGGBBAA."""
    share = np.linspace(0.0, 1.0, SHADES)[:, None]
    r, g, b = rounded(first + share * (last - first)).astype(np.uint32).T
    return (r << 24) | (g << 16) | (b << 8) | 255


WATER_PALETTE = palette(TROUGH_COLOUR, CREST_COLOUR)

HEAD_PALETTE = palette(LEAST_HEAD_COLOUR, LARGEST_HEAD_COLOUR)
HEAD_PALETTE[0] = palette(DRY_COLOUR, DRY_COLOUR)[0]
"""Colours by pressure head over the largest head, and grey for dry surfaces."""


def extent(scene: Scene, in_hulls: float, in_spreads: float) -> float:
    """A length [m]: a sum of apparent lengths of the largest hull and distances between the bodies,
    with these factors."""
    hulls = [f.method.hull for f in scene.buoyancy.floats]
    length = max(min(h.length, LARGEST_SLENDERNESS * np.cbrt(h.volume)) for h in hulls)
    spread = np.ptp(scene.data.xipos[scene.buoyancy.bodies, :2], axis=0).max()
    return float(in_hulls * length + in_spreads * spread)


def overview(scene: Scene, tally: Tally, largest_head: float | None = None) -> str:
    """Scene, sea, hulls and settings as Markdown, with the means of the tally if it has samples,
    and with the legend of pressure colours if there is a largest head [m]."""
    floats, timestep = scene.buoyancy.floats, scene.model.opt.timestep
    lines = [
        f"**{scene.name}**, timestep {1e3 * timestep:g} ms, {sea_in_words(scene.buoyancy.sea)}"
    ]
    for f in floats[:MOST_PLOTTED]:
        hull, method = f.method.hull, type(f.method).__name__.lower()
        if f.method.tolerance is not None:
            method += f" to {f.method.tolerance:.2g} m of water height"
        lines.append(f"- {f.name}: {len(hull.faces):,} faces, {hull.volume:.4g} m³, {method}")
    if len(floats) > MOST_PLOTTED:
        lines.append(f"- and {len(floats) - MOST_PLOTTED} more")
    if largest_head is not None:
        lines.append(
            f"- colours: pressure head, from pale at 0 to dark red at {largest_head:.2g} m and more"
        )
    if tally.last is None:
        return "\n".join(lines)
    lines += ["", "| mean of | height m | tilt ° | submerged | force/weight |", "|--|--|--|--|--|"]
    for name, means in list(tally.bodies().items())[:MOST_PLOTTED]:
        lines.append(
            f"| {name} | {means['mean_height']:.3f} | {means['mean_tilt_deg']:.1f} | "
            f"{means['mean_submerged_fraction']:.3f} | {means['mean_force_over_weight']:.3f} |"
        )
    step, spent = tally.last.step, tally.last.step_seconds
    lines += [
        "",
        f"{step:,} steps to {tally.last.time:.2f} s, {1e6 * spent / max(step, 1):.0f} µs each",
    ]
    return "\n".join(lines)


def _view(scene: Scene, name: str, root: str = "", abreast: int = 1) -> rrb.Spatial3DView:
    """A view that moves with the bodies. abreast: the number of views side by side; the eye of a
    narrow view is farther away."""
    distance = np.sqrt(abreast) * extent(scene, EYE_IN_HULLS, EYE_IN_SPREADS)
    eye = rrb.EyeControls3D(
        position=distance * EYE_DIRECTION, look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0)
    )
    return rrb.Spatial3DView(
        origin=f"{root}world/focus",
        contents=f"/{root}world/**",
        name=name,
        eye_controls=eye,
        line_grid=False,
        background=rrb.Background(kind=rrb.BackgroundKind.SolidColor, color=SKY_COLOUR),
    )


def _plot(entity: str, contents: list[str]) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin="/",
        contents=contents,
        name=PLOTS[entity],
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=entity == PLOT_WITH_LEGEND),
    )


def blueprint(scene: Scene) -> rrb.Blueprint:
    names = [path_part(name) for name in scene.buoyancy.body_names[:MOST_PLOTTED]]
    rows = _rows(lambda entity: [f"/plots/{entity}/{name}/**" for name in names])
    text = rrb.TextDocumentView(origin="overview", name="Overview")
    plots = rrb.Vertical(*rows, text, row_shares=ROW_HEIGHTS)
    title = f"{scene.name}: waterline white, buoyancy green, weight red, drag orange"
    return _arranged(_view(scene, title), plots, [2, 1])


def side_by_side_blueprint(scenes: Mapping[str, Scene]) -> rrb.Blueprint:
    views = [
        _view(scene, label, f"{path_part(label)}/", len(scenes)) for label, scene in scenes.items()
    ]
    rows = _rows(lambda entity: [f"/{path_part(label)}/plots/{entity}/**" for label in scenes])
    differences = [
        rrb.TimeSeriesView(origin="/", contents=[f"/difference/{entity}/**"], name=title)
        for entity, title in DIFFERENCES.items()
    ]
    plots = rrb.Vertical(*rows, rrb.Tabs(*differences, active_tab=0))
    return _arranged(rrb.Horizontal(*views), plots, [3, 1])


def _rows(contents_of: Callable[[str], list[str]]) -> list[rrb.Tabs]:
    """The rows of tabs with plots."""
    return [
        rrb.Tabs(*(_plot(entity, contents_of(entity)) for entity in row), active_tab=0)
        for row in TABS
    ]


def _arranged(
    left: rrb.Spatial3DView | rrb.Horizontal, right: rrb.Vertical, shares: list[int]
) -> rrb.Blueprint:
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=shares),
        rrb.TimePanel(timeline="time", state="collapsed"),
        collapse_panels=True,
    )
