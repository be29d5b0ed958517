"""Screen layout of a recorded flight, and the entity names in the recording."""

from __future__ import annotations

from typing import Any

APPLICATION = "uav_recon"
TIMELINE = "flight"
RECORDING = "flight.rrd"

WORLD = "world"
FENCE = "world/fence"
BODY = "world/body"
TRAIL = "world/trail"
PLAN = "world/plan"
TRAJECTORY = "world/trajectory"
DEPTH = "world/depth"
RGB = "world/rgb"
VOXELS = "world/voxels"
CEILING = "world/ceiling"
SURFACE = "world/surface"
MESH = "world/mesh"
LOG = "log"

SPEED = "plots/speed/m_per_s"
CLEARANCE = "plots/distance/to_not_free_m"
EXPLORED = "plots/explored/m3"
PLANNING = "plots/planning/step_ms"
PLANNING_TASKS = "plots/planning/tasks_ms"
VIEWS = "plots/views/taken"
FRONTIERS = "plots/views/frontiers"
PLACE_PREDICTED = "plots/place/predicted_cm"
PLACE_MEASURED = "plots/place/measured_cm"


def review_blueprint() -> Any:
    """Return the layout: 3-D view beside both images; below them six time series and the log."""
    import rerun.blueprint as rrb

    def series(origin: str, name: str) -> Any:
        return rrb.TimeSeriesView(origin=origin, name=name)

    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Spatial3DView(origin=WORLD, contents=["$origin/**", f"- /{CEILING}/**"], name="Room"),  # seen from above
                rrb.Vertical(
                    rrb.Spatial2DView(origin=RGB, name="Colour"),
                    rrb.Spatial2DView(origin=DEPTH, name="Depth"),
                ),
                column_shares=[3, 1],
            ),
            rrb.Horizontal(
                rrb.Tabs(
                    series("plots/speed", "Speed"),
                    series("plots/distance", "Distance to anything not known free"),
                    series("plots/place", "Uncertainty of the place, cm"),
                ),
                series("plots/explored", "Explored"),
                series("plots/planning", "Planning"),
                series("plots/views", "Views and frontiers"),
                rrb.TextLogView(origin=LOG, name="Log"),
            ),
            row_shares=[3, 1],
        ),
        collapse_panels=True,
    )
