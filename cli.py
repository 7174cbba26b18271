"""The slicemask command: parse, call the library once, print."""

import errno
import gc
import importlib.util
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click


@contextmanager
def _no_collection() -> Iterator[None]:
    """Look for no garbage: what is imported is none, and to find that out takes long."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.freeze()
            gc.unfreeze()  # all are old ones now, which are seldom looked through
            gc.enable()


# Builds have threads of their own and multiply no matrices. OpenBLAS's, which NumPy starts, would
# only spin beside them.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

with _no_collection():
    import slicemask
    from slicemask import Frustum, PoseGrid, SlicemaskError
    from slicemask.bank.seal import VERSION
    from slicemask.bank.write import FORMAT
    from slicemask.shield import exit_on_signals

# How long a thread of a build may keep the interpreter from another one that wants it.
_TURN_S = 0.0002


class _Group(click.Group):
    """Commands whose expected errors are one sentence and exit code 1."""

    def invoke(self, ctx: click.Context) -> Any:
        # What is half-written is cleared away on the way out, for `kill` as for Ctrl-C.
        exit_on_signals()
        # What was imported is no garbage at the end, either.
        gc.freeze()
        try:
            return super().invoke(ctx)
        except SlicemaskError as error:
            raise click.ClickException(str(error)) from error
        except (MemoryError, RuntimeError) as error:
            from model.errors import is_out_of_memory

            if not is_out_of_memory(error):
                raise
            raise click.ClickException(
                "this takes more memory than there is; ask for fewer poses, slices or cells, or "
                "for smaller batches or images"
            ) from error
        except OSError as error:
            if error.errno == errno.EPIPE:  # a reader that has seen enough, which click handles
                raise
            raise click.ClickException(str(error)) from error


class _Numbers(click.ParamType):
    """Numbers parted by commas, such as ``0.5,0.5,90``."""

    def __init__(self, names: str, kind: type = float):
        self.name = names
        self.kind = kind

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if not isinstance(value, str):
            return value
        parts = value.split(",")
        try:
            numbers = tuple(self.kind(part) for part in parts)
        except ValueError:
            numbers = ()
        if len(numbers) != len(self.name.split(",")):
            self.fail(f"{value!r} is not {self.name}", param, ctx)
        return numbers


@contextmanager
def _short_turns() -> Iterator[None]:
    """Let threads take turns at the interpreter quickly.

    Those of a build want it for an instant, between long calls that do without it; by default each
    may have to wait 5 ms for it.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(_TURN_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before)


@contextmanager
def _progress(what: str, unit: str) -> Iterator[Callable[[int, int], None] | None]:
    """A progress bar on a terminal; None elsewhere."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(f"{task.speed:,.0f} {unit}/s" if task.speed else "")

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Rate(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _size(count: int) -> str:
    """Bytes as people read them, such as 4.6 MB."""
    from rich.filesize import decimal

    return decimal(count)


def _print(as_json: bool, content: dict[str, Any], text: str) -> None:
    if as_json:
        try:
            text = json.dumps(content, indent=2, allow_nan=False)
        except ValueError as error:
            raise click.ClickException(
                "a figure is not finite, and JSON has no such number; ask again without --json"
            ) from error
    click.echo(text)


_as_json = click.option("--json", "as_json", is_flag=True, help="Print JSON, for programs.")
_cache = click.option(
    "--cache",
    metavar="DIR",
    help="Folder of banks.  [default: $SLICEMASK_CACHE, else masks_cache]",
)


def _frustum_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --hfov, --slices and --projection."""
    for option in reversed(
        (
            click.option(
                "--hfov",
                type=float,
                default=360.0,
                show_default=True,
                metavar="DEGREES",
                help="Horizontal field of view, in (0, 360].",
            ),
            click.option(
                "--slices", type=int, default=16, show_default=True, help="Slices N of the HFoV."
            ),
            click.option(
                "--projection",
                type=click.Choice(["equirectangular", "pinhole"]),
                default="equirectangular",
                show_default=True,
                help="Equal azimuth ranges, or equal widths in a pinhole image.",
            ),
        )
    ):
        command = option(command)
    return command


_cells = click.option(
    "--cells", type=int, default=32, show_default=True, help="Cells L along each side."
)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(slicemask.__version__, prog_name="slicemask")
def main() -> None:
    """Exact slice masks for cross-view localization."""


@main.command()
@click.option("--grid", metavar="RxCxH", help="Rows x columns x headings, such as 21x21x64.")
@click.option(
    "--poses",
    "pose_file",
    metavar="FILE",
    help="A list of poses instead: CSV with columns u,v,heading_deg, or .npy [K, 3].",
)
@click.option(
    "--extent",
    type=_Numbers("u0,v0,u1,v1"),
    help="Part of the tile that the grid fills.  [default: all]",
)
@click.option(
    "--places",
    type=click.Choice(["centres", "endpoints"]),
    default="centres",
    show_default=True,
    help="Where the grid's places lie in the extent.",
)
@_frustum_options
@_cells
@click.option(
    "--engine",
    type=click.Choice(["shapely", "rays"]),
    default="shapely",
    show_default=True,
    help="Polygon intersections, or the closed form.",
)
@click.option("--out", metavar="FILE", help="Where the bank goes.  [default: a name in the cache]")
@_cache
@click.option("--force", is_flag=True, help="Build again, and replace the bank that is there.")
@click.option("--jobs", type=int, help="Threads.  [default: all processors]")
@_as_json
def build(
    grid: str | None,
    pose_file: str | None,
    extent: tuple[float, float, float, float] | None,
    places: Any,
    hfov: float,
    slices: int,
    cells: int,
    projection: Any,
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
    frustum = Frustum(hfov, slices, projection)
    poses = (
        slicemask.read_poses(pose_file)
        if pose_file is not None
        else PoseGrid.parse(str(grid), extent or (0.0, 0.0, 1.0, 1.0), places)
    )
    with _progress("building", "poses") as progress, _short_turns():
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
    content = {
        "path": str(result.path),
        "reused": result.reused,
        "poses": len(poses),
        "masks": len(poses) * slices,
        "distinct_masks": result.rows,
        "bytes": result.path.stat().st_size,
        "seconds": round(time.perf_counter() - start, 3),
    }
    figures = (
        f"{len(poses):,} poses, {result.rows:,} distinct masks of {content['masks']:,}, "
        f"{_size(content['bytes'])}"
    )
    _print(
        as_json,
        content,
        f"{result.path}: is there already and matches ({figures}); --force builds it again"
        if result.reused
        else f"{result.path}: built in {content['seconds']:.2f} s ({figures})",
    )


@main.command()
@click.argument("bank")
@_as_json
def info(bank: str, as_json: bool) -> None:
    """Say what a bank holds."""
    with slicemask.open_bank(bank) as opened:
        spec = opened.spec
        content = {
            "path": bank,
            "format": FORMAT,
            "version": VERSION,
            "spec": json.loads(spec.to_json()),
            "poses": len(opened),
            "masks": len(opened) * spec.frustum.slices,
            "distinct_masks": opened.rows,
            "nonzeros": opened.nonzeros,
            "bytes": Path(bank).stat().st_size,
        }
    lines = {
        "bank": f"{bank} ({FORMAT}, version {VERSION})",
        "poses": f"{len(opened):,} ({'a list' if spec.grid is None else spec.poses})",
        "HFoV": f"{spec.frustum.hfov_deg:g} degrees, {spec.frustum.projection}",
        "slices": str(spec.frustum.slices),
        "cells": f"{spec.cells} x {spec.cells}",
        "masks": f"{content['masks']:,}, {opened.rows:,} of them distinct",
        "nonzeros": f"{opened.nonzeros:,}, {opened.nonzeros / opened.rows:.1f} a distinct mask",
        "size": _size(content["bytes"]),
        "engine": spec.engine,
        "versions": ", ".join(f"{name} {text}" for name, text in sorted(spec.versions.items())),
    }
    if spec.grid is not None:
        u0, v0, u1, v1 = spec.grid.extent
        lines["extent"] = f"u {u0:g} to {u1:g}, v {v0:g} to {v1:g}, places at {spec.grid.places}"
    _print(as_json, content, "\n".join(f"{name:<10}{text}" for name, text in lines.items()))


@main.command()
@click.argument("bank")
@click.option("--sample", type=int, help="Masks to recompute, at least.  [default: 2000]")
@click.option("--all", "everything", is_flag=True, help="Recompute every mask of every pose.")
@click.option("--jobs", type=int, help="Threads.  [default: all processors]")
@_as_json
def verify(
    bank: str, sample: int | None, everything: bool, jobs: int | None, as_json: bool
) -> None:
    """Recompute a bank's masks with the other engine and compare."""
    from slicemask.bank.verify import verify_bank

    if everything and sample is not None:
        raise click.UsageError("Give either --sample or --all.")
    count = None if everything else 2000 if sample is None else sample
    with slicemask.open_bank(bank) as opened, _progress("verifying", "poses") as progress:
        found = verify_bank(opened, count, jobs, progress)
    compared = f"{found.masks:,} masks of {found.poses:,} poses recomputed with {found.engine}"
    largest = f"largest difference {found.largest_difference:.2e}"
    if found.first_wrong is None:
        verdict = f"{largest}, within float32 rounding ({found.tolerance:.1e})"
    else:
        pose, number = found.first_wrong
        verdict = f"{found.wrong_masks:,} are wrong, first slice {number} of pose {pose}; {largest}"
    _print(as_json, {**asdict(found), "passed": found.passed}, f"{bank}: {compared}: {verdict}")
    if not found.passed:
        sys.exit(1)


@main.command()
@click.argument("bank", required=False)
@click.option("--pose", metavar="ROW,COLUMN,HEADING|K", help="Which pose of the bank.")
@click.option(
    "--at", type=_Numbers("u,v,heading_deg"), help="Any pose, computed now; needs no bank."
)
@_frustum_options
@_cells
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
@_cache
@_as_json
@click.pass_context
def visualize(
    ctx: click.Context,
    bank: str | None,
    pose: str | None,
    at: tuple[float, float, float] | None,
    hfov: float,
    slices: int,
    cells: int,
    projection: Any,
    aerial: str | None,
    out: str | None,
    animate: str | None,
    cache: str | None,
    as_json: bool,
) -> None:
    """Draw the slices of a pose: of BANK, of the newest bank, or of --at."""
    from slicemask import plot, view

    if at is not None and (bank is not None or pose is not None):
        raise click.UsageError("--at needs no BANK and no --pose: give one or the other.")
    if cache is not None and (bank is not None or at is not None):
        raise click.UsageError("--cache says where the newest bank is; it needs no BANK or --at.")
    if at is None:
        for name in ("hfov", "slices", "cells", "projection"):
            if ctx.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT:
                raise click.UsageError(f"--{name} belongs to --at; a bank has its own.")
    tile = plot.read_aerial(aerial) if aerial is not None else None
    seen = (
        view.view_at(at, Frustum(hfov, slices, projection), cells)
        if at is not None
        else view.view_of_bank(bank, pose, cache)
    )
    path = Path(out or f"{seen.name}.{'gif' if animate else 'png'}")
    if animate:
        with _progress("drawing", "frames") as progress:
            plot.animate_heading(
                seen.pose, seen.frustum, seen.cells, path, aerial=tile, progress=progress
            )
    else:
        plot.save_figure(plot.draw_pose(seen.masks, seen.pose, seen.frustum, aerial=tile), path)
    u, v, heading_deg = (float(value) for value in seen.pose)
    content = {"path": str(path), "pose": {"u": u, "v": v, "heading_deg": heading_deg}}
    _print(as_json, content, f"{path}: u {u:.4g}, v {v:.4g}, heading {heading_deg:.5g} degrees")


def _check_model_installed() -> None:
    missing = [
        name
        for name in ("torch", "timm", "lightning", "pyproj", "safetensors", "tensorboard", "yaml")
        if importlib.util.find_spec(name) is None
    ]
    if missing:
        raise click.ClickException(
            f"this command needs {', '.join(missing)}; install: pip install 'slicemask[model]'"
        )


# As in `model.devices.Precision`, which takes torch's time to import.
_PRECISIONS = click.Choice(["32-true", "16-mixed", "bf16-mixed"])


class _Alpha(click.ParamType):
    """A number, or K."""

    name = "number|K"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        try:
            return value if str(value).upper() == "K" else float(value)
        except ValueError:
            self.fail(f"{value!r} is neither a number nor K", param, ctx)


def _settings(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add an option for each setting of a run, named as in `model.config.TrainConfig`.

    None has a default here: what is not given comes from --config, the run, or the paper.
    """
    same_or_cross = click.Choice(["same-area", "cross-area"])
    by_data = "[default: {} for VIGOR, {} for KITTI]".format
    options: tuple[tuple[str, Any, str], ...] = (
        ("data", click.Choice(["vigor", "kitti"]), "Format of the data."),
        ("root", str, "Folder of the data tree."),
        ("split", same_or_cross, "Where the test part lies.  [default: same-area]"),
        ("labels", click.Choice(["corrected", "original"]), "Of VIGOR.  [default: corrected]"),
        ("cities", str, "Only these of VIGOR's cities, parted by commas."),
        ("splits", str, "Folder of KITTI's split files.  [default: the root]"),
        ("heading-prior", float, "Known to +- this many degrees; 0 aligned.  [default: any]"),
        ("place-prior", _Numbers("u,v,radius"), "Only candidates within the radius of (u, v)."),
        ("extent", _Numbers("u0,v0,u1,v1"), "Part of the tile that the grids fill."),
        ("train-grid", str, f"Candidates in training.  {by_data('7x7x16', '5x5x16')}"),
        ("test-grid", str, f"Candidates in testing.  {by_data('21x21x64', '15x15x64')}"),
        ("encoder", str, "timm backbone.  [default: vgg16]"),
        ("weights", str, "imagenet, none or a file.  [default: imagenet]"),
        ("stride", int, "Of the feature maps.  [default: 16]"),
        (
            "ground-size",
            _Numbers("height,width", int),
            f"Pixels.  {by_data('320,640', '256,1024')}",
        ),
        ("aerial-size", int, "Pixels along each side.  [default: 512]"),
        ("slices", int, "N.  [default: 16]"),
        ("alpha", _Alpha(), "Weight of the candidates; K is plain infoNCE.  [default: 4]"),
        ("tau", float, "Temperature of the loss.  [default: 0.1]"),
        ("near-negatives", int, "Negatives around each true pose.  [default: 0]"),
        ("learning-rate", float, "Of Adam.  [default: 1e-5]"),
        (
            "schedule",
            click.Choice(["constant", "one-cycle"]),
            "Of the learning rate.  [default: constant]",
        ),
        ("batch-size", int, "Pairs in a step, on each device.  [default: 4]"),
        ("epochs", int, "Rounds through the training part.  [default: 30]"),
        ("validation-fraction", float, "Share that chooses the best checkpoint.  [default: 0.1]"),
        ("heat-map-every", int, "Epochs between example heat maps.  [default: 1]"),
        ("bad-samples", int, "Unreadable samples to bear.  [default: 10]"),
        ("seed", int, "Of all that is random.  [default: 0]"),
        ("workers", int, "Processes that load images.  [default: 4]"),
        (
            "precision",
            _PRECISIONS,
            "Of the encoders.  [default: 32-true]",
        ),
        ("accelerator", str, "auto, cpu, cuda, ...  [default: auto]"),
        ("devices", int, "How many.  [default: 1]"),
    )
    command = click.option(
        "--cross-view-attention/--no-cross-view-attention",
        default=None,
        help="Whether aerial attention sees the ground.  [default: it does]",
    )(command)
    command = click.option(
        "--grid-jitter/--no-grid-jitter",
        default=None,
        help="Whether the training grid moves at random.  [default: it does not]",
    )(command)
    command = click.option(
        "--augment/--no-augment",
        default=None,
        help="Turn, mirror and recolour training samples.  [default: not]",
    )(command)
    for name, kind, text in reversed(options):
        command = click.option(f"--{name}", type=kind, help=text)(command)
    return command


_run = click.argument("run")
_grid = click.option("--grid", metavar="RxCxH", help="Candidates.  [default: the run's test grid]")
_checkpoint = click.option(
    "--checkpoint", type=click.Choice(["best", "last"]), default="best", show_default=True
)
_device = click.option("--device", default="auto", show_default=True, help="auto, cpu, cuda[:N].")
_precision = click.option(
    "--precision",
    type=_PRECISIONS,
    default="32-true",
    show_default=True,
    help="Of the encoders; what follows them is float32. 16-mixed: GPUs only.",
)
_root = click.option("--root", metavar="DIR", help="Folder of the data tree.  [default: the run's]")
_workers = click.option(
    "--workers", type=int, help="Processes that load images.  [default: the run's]"
)
_run_options = (
    _run,
    _grid,
    click.option("--bank", metavar="FILE", help="A bank of candidates instead."),
    _checkpoint,
    _device,
    _precision,
    _cache,
)


_refine = click.option(
    "--refine",
    type=click.Choice(["none", "mean", "fine", "continuous"]),
    help="The best candidate, the mean of those around it, coarse to fine around the best ones, "
    "or that and then gradients.  [default: mean]",
)


def _of_a_run(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add RUN and the options of commands that use one."""
    for option in reversed(_run_options):
        command = option(command)
    return command


def _given(options: dict[str, Any]) -> dict[str, Any]:
    """The options without those that were not given, for the library's own defaults to hold."""
    return {name: value for name, value in options.items() if value is not None}


@main.command()
@click.option("--config", "config_file", metavar="FILE", help="YAML of settings, named as below.")
@click.option("--out", metavar="DIR", help="The run folder.  [default: runs/<data>]")
@click.option("--resume", is_flag=True, help="Go on with the run that is in the folder, if any.")
@_settings
@_cache
@_as_json
def train(
    config_file: str | None,
    out: str | None,
    resume: bool,
    cache: str | None,
    as_json: bool,
    **settings: Any,
) -> None:
    """Train SliceMatch; the paper's settings are the defaults."""
    _check_model_installed()
    from model.runs import plan_run
    from model.training import is_first_process, train

    asked = {name: value for name, value in settings.items() if value is not None}
    if "heading_prior" in asked:
        asked["heading_prior_deg"] = asked.pop("heading_prior")
    if "cities" in asked:
        asked["cities"] = asked["cities"].split(",")
    if str(asked.get("alpha")).upper() == "K":
        asked["alpha"] = None
    config, folder = plan_run(asked, config_file, out, resume)
    run = train(config, folder, resume=resume, cache=cache, progress=sys.stderr.isatty())
    if not is_first_process():
        return
    epochs = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    content = {"run": str(run), "epochs": len(epochs), "last_epoch": epochs[-1]}
    figures = ", ".join(f"{name} {value:.4g}" for name, value in epochs[-1].items() if "/" in name)
    count = "1 epoch" if len(epochs) == 1 else f"{len(epochs)} epochs"
    _print(as_json, content, f"{run}: {count} trained; the last one: {figures}")


@main.command()
@_of_a_run
@click.option(
    "--split",
    type=click.Choice(["same-area", "cross-area"]),
    help="Where the part lies.  [default: the run's]",
)
@click.option(
    "--part",
    type=click.Choice(["test", "validation", "train"]),
    default="test",
    show_default=True,
    help="Part of the data set.",
)
@_root
@click.option("--limit", type=int, help="Only so many samples, spread evenly.  [default: all]")
@click.option("--out", metavar="DIR", help="Where the results go.  [default: in the run folder]")
@click.option("--overwrite", is_flag=True, help="Replace results that are there.")
@_workers
@_refine
@_as_json
def evaluate(run: str, as_json: bool, **options: Any) -> None:
    """Measure the errors of a trained RUN, and what the candidate grid alone costs."""
    _check_model_installed()
    from model.evaluation import evaluate

    with _progress("evaluating", "samples") as progress:
        evaluation, folder = evaluate(run, progress=progress, **_given(options))
    text = f"{evaluation.report()}\nresults in {folder}"
    _print(as_json, {**evaluation.summary(), "folder": str(folder)}, text)


@main.command()
@_run
@_root
@_grid
@_checkpoint
@_device
@_workers
@_cache
@_as_json
def calibrate(run: str, as_json: bool, **options: Any) -> None:
    """Fit what makes scores of RUN probabilities, on its validation part; training does so too."""
    _check_model_installed()
    from model.calibration import calibrate

    with _progress("calibrating", "samples") as progress:
        content = calibrate(run, progress=progress, **options)
    text = (
        "temperature {temperature:.4g}: mean negative log-likelihood {nll:.3f} on {samples} "
        "samples, {nll_of_tau:.3f} with the loss's tau; for answers among {grid} by the "
        "{checkpoint} weights, others count as uncalibrated"
    )
    _print(as_json, content, text.format(**content))


@main.command()
@_of_a_run
@click.option("--ground", required=True, metavar="IMAGE", help="Panorama or camera image.")
@click.option("--aerial", required=True, metavar="IMAGE", help="Square aerial tile, north up.")
@click.option("--metres-per-pixel", type=float, help="Of the aerial tile as it is.")
@click.option("--heading-prior", type=_Numbers("centre,half_width"), help="In degrees.")
@click.option("--place-prior", type=_Numbers("u,v,radius"), help="In shares of the tile's side.")
@click.option("--truth", type=_Numbers("u,v,heading_deg"), help="The true pose, to be drawn.")
@click.option(
    "--centre", type=_Numbers("lat,lon"), help="Of the tile, degrees: adds latitude and longitude."
)
@click.option("--geojson", metavar="FILE", help="GeoJSON of the pose; needs --centre.")
@click.option("--out", metavar="FILE", help="Picture of the heat map and the pose: PNG, SVG, PDF.")
@_refine
@_as_json
def predict(
    run: str,
    ground: str,
    aerial: str,
    metres_per_pixel: float | None,
    heading_prior: tuple[float, float] | None,
    place_prior: tuple[float, float, float] | None,
    truth: tuple[float, float, float] | None,
    centre: tuple[float, float] | None,
    geojson: str | None,
    out: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Find where a ground image was taken, with a trained RUN."""
    if centre is not None and metres_per_pixel is None:
        raise click.UsageError("--centre needs --metres-per-pixel.")
    if geojson is not None and centre is None:
        raise click.UsageError("--geojson needs --centre and --metres-per-pixel.")
    if truth is not None and out is None:
        raise click.UsageError("--truth is drawn in the picture; it needs --out.")
    _check_model_installed()
    from model.localizer import Localizer, check_resolution
    from slicemask.geometry.poses import check_poses

    # What can be wrong with the request is found before anything is computed or written.
    if metres_per_pixel is not None:
        check_resolution(metres_per_pixel)
    if truth is not None:
        check_poses([truth], iter(["the truth"]))
    if centre is not None:
        from model.geo import check_centre

        check_centre(centre)
    if geojson is not None:
        from model.geo import check_geojson_target

        check_geojson_target(geojson)
    if out is not None:
        from slicemask.plot import check_figure_target

        check_figure_target(out)
    localizer = Localizer.load(run, options.pop("bank"), **_given(options))
    estimate = localizer.localize(
        ground, aerial, heading_prior, place_prior, metres_per_pixel=metres_per_pixel
    )
    content = estimate.as_dict(metres_per_pixel, centre) | {
        "refine": localizer.refine,
        "calibrated": localizer.calibrated,
    }
    if geojson is not None:
        from model.geo import feature_collection, save_geojson

        save_geojson(feature_collection(estimate, metres_per_pixel, centre), geojson)
        content["geojson"] = geojson
    if out is not None:
        from model.data import read_image
        from model.drawing import draw_estimate
        from slicemask.plot import read_aerial, save_figure

        figure = draw_estimate(
            read_aerial(aerial),
            estimate.heat_map,
            estimate.grid,
            estimate.pose,
            localizer.frustum,
            truth=truth,
            ground=read_image(ground),
        )
        save_figure(figure, out)
        content["picture"] = out
    text = "u {u:.4f}, v {v:.4f}, heading {heading_deg:.2f} degrees, score {score:.4f}"
    if metres_per_pixel is not None:
        east_m, north_m = content["east_m"], content["north_m"]
        text += (
            f"; {abs(east_m):.2f} m {'west' if east_m < 0 else 'east'} and "
            f"{abs(north_m):.2f} m {'south' if north_m < 0 else 'north'} of the centre"
        )
    if centre is not None:
        text += "; latitude {latitude:.7f}, longitude {longitude:.7f}"
    lines = [text.format(**content), _certainty(estimate, metres_per_pixel, localizer.calibrated)]
    _print(as_json, content, "\n".join([*lines, *filter(None, (geojson, out))]))


def _certainty(estimate: Any, metres_per_pixel: float | None, calibrated: bool) -> str:
    """One line on how sure an estimate is."""
    east, north, heading = (
        value**0.5 for value in estimate.covariance(metres_per_pixel).diagonal().tolist()
    )
    unit = "of the tile" if metres_per_pixel is None else "m"
    others = ", ".join(f"{mode.probability:.1%}" for mode in estimate.modes[1:])
    return (
        f"probability {estimate.modes[0].probability:.1%}"
        + ("" if calibrated else " (uncalibrated)")
        + f", standard deviations {east:.2g} {unit} east, {north:.2g} {unit} north, "
        f"{heading:.1f} degrees" + (f"; other modes {others}" if others else "")
    )


@main.command()
@click.argument("run", required=False)
@click.option("--grid", metavar="RxCxH", help="Candidates.  [default: 21x21x64, or the run's]")
@_frustum_options
@click.option("--encoder", default="vgg16", show_default=True, help="timm backbone.")
@click.option("--weights", default="none", show_default=True, help="imagenet, none or a file.")
@click.option("--stride", type=int, default=16, show_default=True, help="Of the feature maps.")
@click.option(
    "--ground-size",
    type=_Numbers("height,width", int),
    default="320,640",
    show_default=True,
    help="Pixels.",
)
@click.option(
    "--aerial-size", type=int, default=512, show_default=True, help="Pixels along each side."
)
@click.option("--batch-size", type=int, default=1, show_default=True, help="Pairs at once.")
@click.option(
    "--runs", type=int, default=5, show_default=True, help="Repetitions; their median counts."
)
@_device
@_precision
@_cache
@_as_json
@click.pass_context
def benchmark(
    ctx: click.Context,
    run: str | None,
    grid: str | None,
    device: str,
    precision: str,
    cache: str | None,
    batch_size: int,
    runs: int,
    as_json: bool,
    **settings: Any,
) -> None:
    """Time encoding, aggregation and scoring: of a trained RUN, or of the settings given."""
    _check_model_installed()
    from model.benchmark import time_run, time_settings

    shared = {
        "device": device,
        "precision": precision,
        "cache": cache,
        "batch_size": batch_size,
        "runs": runs,
    }
    if run is not None:
        for name in settings:
            if ctx.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT:
                raise click.UsageError(f"--{name.replace('_', '-')} cannot be changed in a run.")
        timings = time_run(run, grid=grid, **shared)
    else:
        settings["hfov_deg"] = settings.pop("hfov")
        with _progress("building", "poses") as progress:
            timings = time_settings(
                grid=grid or "21x21x64", **settings, **shared, progress=progress
            )
    _print(as_json, timings.as_dict(), timings.report())


class _Size(click.ParamType):
    """Columns and rows of an image, such as 1024x512."""

    name = "COLUMNSxROWS"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if not isinstance(value, str):
            return value
        try:
            columns, rows = map(int, value.split("x"))
        except ValueError:
            self.fail(f"{value!r} is not COLUMNSxROWS, such as 1024x512", param, ctx)
        return columns, rows


@main.command()
@click.option(
    "--format", "kind", type=click.Choice(["vigor", "kitti"]), required=True, help="On disk."
)
@click.option("--out", metavar="DIR", required=True, help="Root of the data set.")
@click.option("--cities", type=int, help="VIGOR: cities, 1 to 4.  [default: 1]")
@click.option("--panoramas", type=int, help="VIGOR: panoramas a city.  [default: 400]")
@click.option("--frames", type=int, help="KITTI: frames in all.  [default: 200]")
@click.option("--seed", type=int, default=0, show_default=True, help="A seed is a city.")
@click.option("--panorama-size", type=_Size(), help="VIGOR.  [default: 2048x1024]")
@click.option("--image-size", type=_Size(), help="KITTI's ground images.  [default: 1242x375]")
@click.option("--tile-size", type=int, help="Pixels a side.  [default: 640, of KITTI 1280]")
@click.option("--jobs", type=int, help="Processes.  [default: all processors]")
@_as_json
def synth(kind: str, out: str, as_json: bool, **options: Any) -> None:
    """Generate a city with exact poses, in VIGOR's or KITTI's on-disk format.

    Repeat a command that was cut short, and it goes on where it stopped.
    """
    try:
        from slicemask.synth import generate_kitti, generate_vigor
    except ModuleNotFoundError as error:
        raise click.ClickException(
            f"slicemask synth needs {error.name}: pip install 'slicemask[synth]'"
        ) from error
    others = (
        ("frames", "image_size") if kind == "vigor" else ("cities", "panoramas", "panorama_size")
    )
    asked = {name: value for name, value in options.items() if value is not None}
    for name in asked.keys() & set(others):
        raise click.UsageError(f"--{name.replace('_', '-')} does not belong to --format {kind}.")
    generate = generate_vigor if kind == "vigor" else generate_kitti
    start = time.perf_counter()
    with _progress("rendering", "images") as progress:
        result = generate(out, **asked, progress=progress)
    content = {
        "path": str(result.path),
        "images": result.images,
        "rendered": result.rendered,
        "seconds": round(time.perf_counter() - start, 3),
    }
    text = "{path}: {images} images, {rendered} of them rendered now, in {seconds:.1f} s"
    _print(as_json, content, text.format(**content))


if __name__ == "__main__":
    main()
