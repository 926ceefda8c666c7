"""Look: colours, views, plots and texts of a recording."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from sim.recording.colours import palette
from sim.recording.framing import EYE_DIRECTION
from sim.recording.output import path_part
from sim.recording.sea_surface import HORIZON_COLOUR
from sim.runs.tally import Tally
from sim.scenes.scene import Scene
from sim.water.words import sea_in_words

Array = NDArray[np.float64]

MOST_PLOTTED = 6
"""Largest number of bodies in the plots and the overview. The series of the other bodies are in the
recording as rows of one entity, because separate entities take ten times the space. A scene with
more bodies has no trails."""

WET_TINT, TINT_SHARE = np.array([20.0, 70.0, 130.0]), 0.4
"""Colour that is mixed into the colour of a wet surface, and its share."""

WATER_SERIES_SHARE = 0.5
"""Brightness of the plotted line of the water at a body, as a share of the body's line."""

WATERLINE_COLOUR, TRAIL_COLOUR, CONTACT_COLOUR = (255, 255, 255), (150, 155, 160), (250, 110, 250)
SKY_COLOUR = tuple(int(value) for value in HORIZON_COLOUR)
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
"""The plots in each row of the column."""

DIFFERENCES = {
    "heave": "Heave minus the first [m]",
    "tilt": "Tilt minus the first [deg]",
}
"""Plots of the differences between twins, whose curves would hide one another."""

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

WATER_QUANTITIES = ("water_above_level", "water_height")

OTHER_SERIES = {
    quantity: path.replace("plots/", "others/").replace("/{}", "")
    for quantity, path in SERIES.items()
}
"""Entity path of each quantity of all other bodies."""

ENVELOPE_SERIES = {
    quantity: path.replace("plots/", "envelope/").replace("/{}", "")
    for quantity, path in SERIES.items()
}
"""Entity path of the largest, mean and smallest value of each quantity over all bodies, for scenes
with more bodies than MOST_PLOTTED."""

ENVELOPE_NAMES = ("largest", "mean", "smallest")
ENVELOPE_COLOURS = np.array([[120.0, 130.0, 140.0], [240.0, 200.0, 90.0], [120.0, 130.0, 140.0]])

HEAD_PALETTE = palette(LEAST_HEAD_COLOUR, LARGEST_HEAD_COLOUR)
HEAD_PALETTE[0] = palette(DRY_COLOUR, DRY_COLOUR)[0]
"""Colours by pressure head over the largest head, and grey for dry surfaces."""


def overview(
    scene: Scene, tally: Tally, largest_head: float | None = None, starts: Sequence[float] = ()
) -> str:
    """Scene, sea, hulls and settings as Markdown, with the means of the tally if it has samples,
    with the legend of pressure colours if there is a largest head [m], and with the times [s] at
    which episodes start if there are several."""
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
    if len(starts) > 1:
        lines.append(f"- episodes start at {', '.join(f'{start:.2f}' for start in starts)} s")
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


def _view(distance: float, name: str, root: str = "", abreast: int = 1) -> rrb.Spatial3DView:
    """A view that moves with the bodies. distance [m]: of the eye. abreast: the number of views
    side by side; the eye of a narrow view is farther away."""
    eye = rrb.EyeControls3D(
        position=abreast * distance * EYE_DIRECTION,
        look_target=(0.0, 0.0, 0.0),
        eye_up=(0.0, 0.0, 1.0),
    )
    return rrb.Spatial3DView(
        origin=f"{root}world/focus",
        contents=f"/{root}world/**",
        name=name,
        eye_controls=eye,
        line_grid=False,
        background=rrb.Background(kind=rrb.BackgroundKind.SolidColor, color=SKY_COLOUR),
        overrides={f"{root}world/trail": rrb.EntityBehavior(visible=False)},
    )


def blueprint(scene: Scene, distance: float) -> rrb.Blueprint:
    """The arrangement of a recording, with the eye at a distance [m]."""
    names = [path_part(name) for name in scene.buoyancy.body_names]
    if len(names) > MOST_PLOTTED:
        plots = _column(lambda entity: [f"/envelope/{entity}/**"])
    else:
        plots = _column(lambda entity: [f"/plots/{entity}/{name}/**" for name in names])
    title = f"{scene.name}: waterline white, buoyancy green, weight red, drag orange"
    text = rrb.TextDocumentView(origin="overview", name="Overview")
    return _arranged(_view(distance, title), plots, text)


def side_by_side_blueprint(scenes: Mapping[str, Scene], distance: float) -> rrb.Blueprint:
    """The arrangement of several simulations of a scene, with the eyes at a distance [m]."""
    views = [_view(distance, label, f"{path_part(label)}/", len(scenes)) for label in scenes]
    plots = _column(lambda entity: [f"/{path_part(label)}/plots/{entity}/**" for label in scenes])
    differences = [
        rrb.TimeSeriesView(origin="/", contents=[f"/difference/{entity}/**"], name=title)
        for entity, title in DIFFERENCES.items()
    ]
    return _arranged(
        rrb.Horizontal(*views, name="Views"),
        plots,
        rrb.Vertical(*differences, name="Differences"),
    )


def _column(contents_of: Callable[[str], list[str]]) -> rrb.Vertical:
    """One column of plots, with further plots in the tabs of each."""
    rows = [
        rrb.Tabs(
            *(
                rrb.TimeSeriesView(
                    origin="/",
                    contents=contents_of(entity),
                    name=PLOTS[entity],
                    plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
                )
                for entity in row
            ),
            active_tab=0,
        )
        for row in TABS
    ]
    return rrb.Vertical(*rows, name="Plots")


def _arranged(*tabs: rrb.View | rrb.Container) -> rrb.Blueprint:
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=0),
        rrb.TimePanel(timeline="time", state="collapsed"),
        collapse_panels=True,
    )
