"""Renders of the finished model: colour and uncertainty in a corner view, and a top view."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon.recording.plots import INK, SOFT, new_figure
from uav_recon.recording.software_renderer import RenderView, corner_view, facing_inwards, render, top_view
from uav_recon.types.frames import ByteArray, FloatArray, IntArray
from uav_recon.types.maps import TriangleMesh

WIDTH = 1200
HEIGHT = 800
_DPI = 100


def render_mesh_images(folder: Path, mesh: TriangleMesh, inside_world: FloatArray) -> list[Path]:
    """Write mesh_colour.png, mesh_uncertainty.png, mesh_top.png (1200x800); returns the paths.

    An empty mesh gives none. inside_world (3,): any point in the free space of the room; it determines the front side of the
    surface.
    """
    if len(mesh.faces) == 0:
        return []
    folder.mkdir(parents=True, exist_ok=True)
    vertices = np.asarray(mesh.vertices_world, dtype=np.float64)
    faces = facing_inwards(vertices, mesh.faces, inside_world)
    used = vertices[np.unique(faces)]
    # a few stray triangles must not shrink the room
    lower, upper = np.percentile(used, 0.2, axis=0), np.percentile(used, 99.8, axis=0)
    corner = corner_view(
        lower, upper, WIDTH, HEIGHT, np.radians(-62.0 if upper[0] - lower[0] >= upper[1] - lower[1] else -28.0)
    )
    top = top_view(lower, upper, WIDTH, HEIGHT)
    shown, low, high = _uncertainty_colours(mesh)
    written = [folder / "mesh_colour.png", folder / "mesh_uncertainty.png", folder / "mesh_top.png"]
    _save(written[0], vertices, faces, mesh.rgb, corner, (lower, upper), None)
    _save(written[1], vertices, faces, shown, corner, (lower, upper), (low, high))
    _save(written[2], vertices, faces, mesh.rgb, top, (lower, upper), None)
    return written


def _uncertainty_colours(mesh: TriangleMesh) -> tuple[ByteArray, float, float]:
    """Return vertex colours (V, 3) by uncertainty, and the values at the ends of the colour map.

    The ends are the 2nd and 98th percentile. The scale is logarithmic, because the uncertainty of a surface seen once is
    many times that of one seen often.
    """
    import matplotlib

    finite = mesh.uncertainty[np.isfinite(mesh.uncertainty)]
    low, high = (float(v) for v in np.percentile(finite, [2.0, 98.0])) if len(finite) else (0.0, 1.0)
    low = max(low, 1e-9)
    high = max(high, low * 1.001)
    shown = np.clip(np.nan_to_num(mesh.uncertainty, nan=high, posinf=high), low, high)
    scaled = np.log(shown / low) / np.log(high / low)
    colours = matplotlib.colormaps["turbo"](scaled)[:, :3]
    return np.asarray(colours * 255.0, dtype=np.uint8), low, high


def _save(
    picture: Path,
    vertices: FloatArray,
    faces: IntArray,
    rgb: ByteArray,
    view: RenderView,
    bounds: tuple[FloatArray, FloatArray],
    scale: tuple[float, float] | None,
) -> None:
    figure = new_figure(WIDTH / _DPI, HEIGHT / _DPI)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(render(vertices, faces, rgb, view), extent=(0, WIDTH, HEIGHT, 0), interpolation="nearest")
    axes.set_axis_off()
    axes.set_xlim(0, WIDTH)
    axes.set_ylim(HEIGHT, 0)
    _draw_ruler(axes.plot, axes.text, view, *bounds)
    if scale is not None:
        _draw_colour_bar(figure, *scale)
    figure.savefig(picture, dpi=_DPI)


def _draw_ruler(
    plot: Callable[..., object], text: Callable[..., object], view: RenderView, lower: FloatArray, upper: FloatArray
) -> None:
    """Draw a ruler on the floor along the nearest long edge, with one block per metre."""
    gap = 0.035 * float((upper - lower)[:2].max())
    corners = np.array([[lower[0], lower[1]], [upper[0], lower[1]], [upper[0], upper[1]], [lower[0], upper[1]]])
    outward = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
    lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    v_middle = view.project(_on_floor((corners + np.roll(corners, -1, axis=0)) / 2, lower))[:, 1]
    near = v_middle > np.median(v_middle)  # the two edges in front; in the top view the lower one
    edge = int(np.argmax(np.where(near, lengths, -1.0)))
    ends = corners[[edge, (edge + 1) % 4]]
    u_ends = view.project(_on_floor(ends, lower))[:, 0]
    ends = ends if u_ends[0] <= u_ends[1] else ends[::-1]  # count from left to right
    metres = max(1, int(lengths[edge]))
    along = np.arange(metres + 1)[:, None] * (ends[1] - ends[0]) / max(lengths[edge], 1e-9) + ends[0] + gap * outward[edge]
    marks = view.project(_on_floor(along, lower))[:, :2]
    labels = view.project(_on_floor(along + gap * outward[edge], lower))[:, :2]
    plot(marks[:, 0], marks[:, 1], color=INK, lw=5.0, solid_capstyle="butt")
    for n in range(0, metres, 2):
        plot(marks[n : n + 2, 0], marks[n : n + 2, 1], color="white", lw=3.0, solid_capstyle="butt")
    for n in range(metres + 1):
        text(*labels[n], f"{n} m" if n == metres else str(n), color=SOFT, fontsize=11, ha="center", va="center")


def _on_floor(points: FloatArray, lower: FloatArray) -> FloatArray:
    return np.column_stack([points, np.full(len(points), lower[2])])


def _draw_colour_bar(figure: Any, low: float, high: float) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    axes = figure.add_axes((0.76, 0.93, 0.2, 0.02))
    bar = figure.colorbar(ScalarMappable(LogNorm(low, high), "turbo"), cax=axes, orientation="horizontal")
    bar.outline.set_visible(False)
    bar.set_ticks([low, high], labels=[f"{low:.1g}", f"{high:.1g}"], minor=False)
    bar.minorticks_off()
    axes.tick_params(colors=SOFT, length=0, labelsize=11)
    axes.set_title("surface uncertainty", color=INK, fontsize=12)
