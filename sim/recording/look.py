"""Look: colours, views, plots and words of a recording."""

from collections.abc import Callable, Mapping

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from sim.hulls.hull import Hull
from sim.recording.output import part
from sim.runs.simulation import Tally
from sim.scenes.scene import Scene
from sim.water.sea import Sea

Array = NDArray[np.float64]

EYE_IN_HULLS, EYE_IN_SPREADS = 2.6, 0.9
"""Distance of the eye from what it looks at, likewise: near enough for the waterline, far enough to
have all bodies and a wave or two around them."""

SLENDER = 3.2
"""Cube roots of its volume that a slender hull counts as long as: seen whole it would be a line."""

EYE_DIRECTION = np.array([-0.49, -0.78, 0.39])

MOST_PLOTTED = 6
"""Bodies in the plots and the overview, the first ones. The series of the others are in the
recording too, as rows of one entity: an entity each would take ten times the space. With more
bodies than these there are no trails: they would be a thicket."""

MOST_WAVES_NAMED = 4
"""Waves of a sea up to which the overview has each."""

TROUGH_COLOUR, CREST_COLOUR = np.array([12.0, 50.0, 104.0]), np.array([122.0, 196.0, 228.0])
WATER_OPACITY = 125
SKY_COLOUR = (40, 56, 72)
WET_TINT, WET_SHARE = np.array([20.0, 70.0, 130.0]), 0.4
"""A wet surface has this share of the colour WET_TINT."""

WATER_SERIES_COLOUR = np.array([90.0, 150.0, 200.0])
WATERLINE_COLOUR = (255, 255, 255)
FORCE_COLOURS = {"buoyancy": (80, 200, 120), "weight": (220, 80, 60), "drag": (240, 180, 60)}

COLOURS = ("wet", "pressure")
"""What hulls may be coloured by: their own colours, darker where they are wet, or the pressure."""

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
"""Time series views: the first part of the entity path and the title."""

TABS = (("heave", "height", "surge"), ("tilt", "heel", "trim"), ("force", "submerged"))
"""Views that lie behind one another, from the top."""

DIFFERENCES = {
    "heave": "Heave, off the first [m]",
    "tilt": "Tilt, off the first [deg]",
}
"""What is plotted of twins, one of which would hide the other."""

PLOT_SHARES = (1.0, 1.0, 1.0, 1.55)
"""Heights of the three plots and the overview below them."""

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
"""Entity path of every quantity of a body that is plotted."""

LEGEND = "tilt"
"""The plot with a legend: one is enough."""

WATERS = ("water_above_level", "water_height")
"""Those that are of the water."""

OTHER_SERIES = {
    quantity: path.replace("plots/", "others/").replace("/{}", "")
    for quantity, path in SERIES.items()
}
"""Entity path of every quantity of all those that are not."""

SHADES = 256
"""Colours from dry to wet and from trough to crest."""


def rounded(colour: Array) -> NDArray[np.uint8]:
    """A colour in whole numbers."""
    return np.round(colour).astype(np.uint8)


def shades(values: Array) -> NDArray[np.uint8]:
    """Which of the SHADES values from -1/2 to 1/2 have; those beyond have the last ones."""
    return np.clip(SHADES * (values + 0.5), 0.0, SHADES - 1.0).astype(np.uint8)


def palette(first: Array, last: Array) -> NDArray[np.uint32]:
    """The opaque SHADES between two colours (3,) in 0 ... 255 as Rerun keeps them, 0xRRGGBBAA."""
    share = np.linspace(0.0, 1.0, SHADES)[:, None]
    r, g, b = rounded(first + share * (last - first)).astype(np.uint32).T
    return (r << 24) | (g << 16) | (b << 8) | 255


WATER_PALETTE = palette(TROUGH_COLOUR, CREST_COLOUR)

HEAD_PALETTE = palette(LEAST_HEAD_COLOUR, LARGEST_HEAD_COLOUR)
HEAD_PALETTE[0] = palette(DRY_COLOUR, DRY_COLOUR)[0]
"""By the pressure head over its largest; what is dry is grey."""


def apparent_size(hull: Hull) -> float:
    """How large [m] a hull is to the eye: its longest side, or, of a slender one, less."""
    return float(min(hull.length, SLENDER * np.cbrt(hull.volume)))


def extent(scene: Scene, in_hulls: float, in_spreads: float) -> float:
    """A length [m] that goes with the largest hull and with how far the bodies are apart."""
    buoyancy = scene.buoyancy
    largest = max(apparent_size(f.method.hull) for f in buoyancy.floats)
    spread = np.ptp(scene.data.xipos[buoyancy.bodies, :2], axis=0).max()
    return float(in_hulls * largest + in_spreads * spread)


def overview(scene: Scene, tally: Tally, largest_head: float | None = None) -> str:
    """Scene, sea, hulls and settings as Markdown; with samples in the tally, the means too; with a
    largest head [m] the legend of hulls that are coloured by the pressure."""
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


def sea_in_words(sea: Sea) -> str:
    """One line on a sea: each wave, or their significant height where they are many."""
    if not sea.waves:
        return "still water"
    if len(sea.waves) > MOST_WAVES_NAMED:
        lengths = [wave.wavelength for wave in sea.waves]
        return (
            f"{len(sea.waves)} waves of {min(lengths):.3g} to {max(lengths):.3g} m, significant "
            f"height {sea.significant_height:.3g} m, steepness {sea.steepness:.2f}, {sea.pressure}"
        )
    waves = [f"{w.amplitude:.3g} x {w.wavelength:.3g} m" for w in sea.waves]
    named = ", ".join(waves)
    return f"waves (amplitude x length) {named}, steepness {sea.steepness:.2f}, {sea.pressure}"


def _view(scene: Scene, name: str, root: str = "", abreast: int = 1) -> rrb.Spatial3DView:
    """The bodies and the water around them, seen from a place that moves with them, and from
    further away by a view that is one of several abreast, hence narrow."""
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
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=entity == LEGEND),
    )


def blueprint(scene: Scene) -> rrb.Blueprint:
    names = [part(name) for name in scene.buoyancy.body_names[:MOST_PLOTTED]]
    rows = _rows(lambda entity: [f"/plots/{entity}/{name}/**" for name in names])
    text = rrb.TextDocumentView(origin="overview", name="Overview")
    plots = rrb.Vertical(*rows, text, row_shares=PLOT_SHARES)
    title = f"{scene.name}: waterline white, buoyancy green, weight red, drag orange"
    return _arranged(_view(scene, title), plots, [2, 1])


def side_by_side_blueprint(scenes: Mapping[str, Scene]) -> rrb.Blueprint:
    views = [_view(scene, label, f"{part(label)}/", len(scenes)) for label, scene in scenes.items()]
    rows = _rows(lambda entity: [f"/{part(label)}/plots/{entity}/**" for label in scenes])
    differences = [
        rrb.TimeSeriesView(origin="/", contents=[f"/difference/{entity}/**"], name=title)
        for entity, title in DIFFERENCES.items()
    ]
    plots = rrb.Vertical(*rows, rrb.Tabs(*differences, active_tab=0))
    return _arranged(rrb.Horizontal(*views), plots, [3, 1])


def _rows(contents_of: Callable[[str], list[str]]) -> list[rrb.Tabs]:
    """Rows of plots, those of one behind one another."""
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
