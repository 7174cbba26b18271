"""Commands on banks of masks: build, info, verify and visualize."""

import json
import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import click

import slicemask
from slicemask import Frustum, PoseGrid
from slicemask.bank.write import FORMAT
from slicemask.cli.options import (
    FRUSTUM_OPTIONS,
    Numbers,
    as_json_option,
    cache_option,
    cells_option,
    frustum_options,
)
from slicemask.cli.output import print_result, progress_bar, readable_size

# How long a thread of a build may keep the interpreter from another one that wants it.
_SWITCH_INTERVAL_S = 0.0002


@contextmanager
def _fast_thread_switching() -> Iterator[None]:
    """Let threads take turns at the interpreter quickly.

    Those of a build want it for an instant, between long calls that do without it; by default each
    may have to wait 5 ms for it.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before)


@click.command()
@click.option("--grid", metavar="RxCxH", help="Rows x columns x headings, such as 21x21x64.")
@click.option(
    "--poses",
    "pose_file",
    metavar="FILE",
    help="A list of poses instead: CSV with columns u,v,heading_deg, or .npy [K, 3].",
)
@click.option(
    "--extent",
    type=Numbers("u0,v0,u1,v1"),
    help="Part of the tile that the grid fills.  [default: all]",
)
@click.option(
    "--places",
    type=click.Choice(["centres", "endpoints"]),
    default="centres",
    show_default=True,
    help="Where the grid's places lie in the extent.",
)
@frustum_options
@cells_option
@click.option(
    "--engine",
    type=click.Choice(["shapely", "rays"]),
    default="shapely",
    show_default=True,
    help="Polygon intersections, or the closed form.",
)
@click.option("--out", metavar="FILE", help="Where the bank goes.  [default: a name in the cache]")
@cache_option
@click.option("--force", is_flag=True, help="Build again, and replace an existing bank.")
@click.option("--jobs", type=int, help="Threads.  [default: all processors]")
@as_json_option
def build(
    grid: str | None,
    pose_file: str | None,
    extent: tuple[float, float, float, float] | None,
    places: Any,
    frustum: Frustum,
    cells: int,
    engine: Any,
    out: str | None,
    cache: str | None,
    force: bool,
    jobs: int | None,
    as_json: bool,
) -> None:
    """Build the bank of a pose grid, or of a list of poses."""
    if (grid is None) == (pose_file is None):
        raise click.UsageError("Give either --grid, such as --grid 21x21x64, or --poses FILE.")
    if pose_file is not None and (extent is not None or places != "centres"):
        raise click.UsageError("--extent and --places belong to --grid, not to --poses.")
    start = time.perf_counter()
    poses = (
        slicemask.read_poses(pose_file)
        if pose_file is not None
        else PoseGrid.parse(str(grid), extent or (0.0, 0.0, 1.0, 1.0), places)
    )
    with progress_bar("building", "poses") as progress, _fast_thread_switching():
        result = slicemask.build_bank(
            poses,
            frustum,
            cells,
            engine=engine,
            out=out,
            cache=cache,
            force=force,
            jobs=jobs,
            progress=progress,
        )
    content: dict[str, Any] = {
        "path": str(result.path),
        "reused": result.reused,
        "poses": len(poses),
        "masks": len(poses) * math.prod(frustum.mask_axes),
        "distinct_masks": result.rows,
        "bytes": result.path.stat().st_size,
        "seconds": round(time.perf_counter() - start, 3),
    }
    figures = (
        f"{len(poses):,} poses, {result.rows:,} distinct masks of {content['masks']:,}, "
        f"{readable_size(content['bytes'])}"
    )
    print_result(
        as_json,
        content,
        f"{result.path}: already exists and matches ({figures}); --force builds it again"
        if result.reused
        else f"{result.path}: built in {content['seconds']:.2f} s ({figures})",
    )


@click.command()
@click.argument("bank")
@as_json_option
def info(bank: str, as_json: bool) -> None:
    """Show what a bank holds."""
    with slicemask.open_bank(bank) as opened:
        spec = opened.spec
        content = {
            "path": bank,
            "format": FORMAT,
            "version": spec.version,
            "spec": json.loads(spec.to_json()),
            "poses": len(opened),
            "masks": len(opened) * math.prod(spec.frustum.mask_axes),
            "distinct_masks": opened.rows,
            "nonzeros": opened.nonzeros,
            "bytes": Path(bank).stat().st_size,
        }
    lines = {
        "bank": f"{bank} ({FORMAT}, version {spec.version})",
        "poses": f"{len(opened):,} ({'a list' if spec.grid is None else spec.poses})",
        "HFoV": f"{spec.frustum.hfov_deg:g} degrees, {spec.frustum.projection}",
        "axis": f"{100 * spec.frustum.principal_point:.4g} % of the image's width from its left, "
        f"which sees {spec.frustum.left_deg or 0.0:.5g} to {spec.frustum.right_deg:.5g} degrees",
        "slices": str(spec.frustum.slices),
        "bands": ", ".join(_band_texts(spec.frustum.bands)),
        "cells": f"{spec.cells} x {spec.cells}",
        "masks": f"{content['masks']:,}, {opened.rows:,} of them distinct",
        "nonzeros": f"{opened.nonzeros:,}, {opened.nonzeros / opened.rows:.1f} a distinct mask",
        "size": readable_size(content["bytes"]),
        "engine": spec.engine,
        "versions": ", ".join(f"{name} {text}" for name, text in sorted(spec.versions.items())),
    }
    if spec.grid is not None:
        u0, v0, u1, v1 = spec.grid.extent
        lines["extent"] = f"u {u0:g} to {u1:g}, v {v0:g} to {v1:g}, places at {spec.grid.places}"
    if not spec.frustum.bands:
        del lines["bands"]
    if spec.frustum.left_deg is None:
        del lines["axis"]
    print_result(as_json, content, "\n".join(f"{name:<10}{text}" for name, text in lines.items()))


def _band_texts(bands: tuple[float, ...]) -> list[str]:
    """The bands as ranges, in shares of the tile's side."""
    edges = ["0", *(f"{range_:g}" for range_ in bands), ""]
    return [f"{near} to {far}" if far else f"beyond {near}" for near, far in pairwise(edges)]


@click.command()
@click.argument("bank")
@click.option("--sample", type=int, help="Masks to recompute, at least.  [default: 2000]")
@click.option("--all", "everything", is_flag=True, help="Recompute every mask of every pose.")
@click.option("--jobs", type=int, help="Threads.  [default: all processors]")
@as_json_option
def verify(
    bank: str, sample: int | None, everything: bool, jobs: int | None, as_json: bool
) -> None:
    """Recompute a bank's masks with the other engine and compare."""
    from slicemask.bank.verify import verify_bank

    if everything and sample is not None:
        raise click.UsageError("Give only one of --sample and --all.")
    count = None if everything else 2000 if sample is None else sample
    with slicemask.open_bank(bank) as opened, progress_bar("verifying", "poses") as progress:
        found = verify_bank(opened, count, jobs, progress)
    compared = f"{found.masks:,} masks of {found.poses:,} poses recomputed with {found.engine}"
    largest = f"largest difference {found.largest_difference:.2e}"
    if found.first_wrong is None:
        verdict = f"{largest}, within what rounding explains ({found.tolerance:.1e})"
    else:
        pose, number, *band = found.first_wrong
        which = f"band {band[0]} of slice {number}" if band else f"slice {number}"
        verdict = f"{found.wrong_masks:,} are wrong, first {which} of pose {pose}; {largest}"
    print_result(
        as_json, {**asdict(found), "passed": found.passed}, f"{bank}: {compared}: {verdict}"
    )
    if not found.passed:
        sys.exit(1)


@click.command()
@click.argument("bank", required=False)
@click.option("--pose", metavar="ROW,COLUMN,HEADING|K", help="Which pose of the bank.")
@click.option(
    "--at", type=Numbers("u,v,heading_deg"), help="Any pose, computed now; needs no bank."
)
@frustum_options
@cells_option
@click.option("--aerial", metavar="IMAGE", help="Aerial tile to draw on.")
@click.option(
    "--out",
    metavar="FILE",
    help="PNG, SVG or PDF (GIF with --animate), by its suffix.  "
    "[default: named after what is drawn, in the current folder]",
)
@click.option(
    "--animate", type=click.Choice(["heading"]), help="Write a GIF that turns the camera."
)
@cache_option
@as_json_option
@click.pass_context
def visualize(
    ctx: click.Context,
    bank: str | None,
    pose: str | None,
    at: tuple[float, float, float] | None,
    frustum: Frustum,
    cells: int,
    aerial: str | None,
    out: str | None,
    animate: str | None,
    cache: str | None,
    as_json: bool,
) -> None:
    """Draw the slices of a pose.

    The pose is one of BANK or of the newest bank, or any other with --at.
    """
    from slicemask import plot, view

    if at is not None and (bank is not None or pose is not None):
        raise click.UsageError("--at needs no BANK and no --pose: give one or the other.")
    if cache is not None and (bank is not None or at is not None):
        raise click.UsageError("--cache says where the newest bank is; it needs no BANK or --at.")
    if at is None:
        for name in (*FRUSTUM_OPTIONS, "cells"):
            if ctx.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT:
                raise click.UsageError(f"--{name} belongs to --at; a bank has its own.")
    tile = plot.read_aerial(aerial) if aerial is not None else None
    seen = (
        view.view_at(at, frustum, cells) if at is not None else view.view_of_bank(bank, pose, cache)
    )
    path = Path(out or f"{seen.name}.{'gif' if animate else 'png'}")
    if animate:
        with progress_bar("drawing", "frames") as progress:
            plot.animate_heading(
                seen.pose, seen.frustum, seen.cells, path, aerial=tile, progress=progress
            )
    else:
        plot.save_figure(plot.draw_pose(seen.masks, seen.pose, seen.frustum, aerial=tile), path)
    u, v, heading_deg = (float(value) for value in seen.pose)
    content = {"path": str(path), "pose": {"u": u, "v": v, "heading_deg": heading_deg}}
    print_result(
        as_json, content, f"{path}: u {u:.4g}, v {v:.4g}, heading {heading_deg:.5g} degrees"
    )
