"""``python -m benchmarks.locating``: what a photograph costs on a map, and what workers save.

A map of 600 m and panoramas of 2048x1024, both of random colours, and an untrained model at the
paper's sizes for VIGOR (VGG16, 21x21x64 candidates): the work is that of real ones. First the
processor's seconds of each step, in one thread, so that other work does not stretch them. Then
`slicematch.locate` on Dask with one process and with two, in photographs a second between the first
and the last part that is done, so that the start of the processes does not count; that needs a
machine with nothing else to do.
"""

import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click
import dask
import numpy as np
import rasterio
import torch
from distributed import LocalCluster
from PIL import Image
from rasterio.transform import from_origin
from rasterio.warp import transform
from slicematch import Localizer, TrainConfig, locate
from slicematch.cluster import WORKER_ENVIRON
from slicematch.data.maps import AerialMap
from slicematch.localization.geodesy import offset_position
from slicematch.runs.folder import RunFolder, build_model

CENTRE = 51.999, 4.3735
MAP_PIXELS, METRES, SIDE_M = 4000, 0.15, 72.0


@click.command()
@click.option("--photos", default=64, show_default=True)
@click.option("--encoder", default="vgg16", show_default=True)
@click.option("--times", default=5, show_default=True, help="Of which the medians are printed.")
@click.option("--dask/--no-dask", default=True, help="Whether workers are measured too.")
def main(photos: int, encoder: str, times: int, dask: bool) -> None:
    """Print the seconds of each step, and the rates of one and two workers."""
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run = untrained_run(folder / "run", encoder)
        table = write_photos(folder, photos)
        for step, seconds in seconds_of_steps(folder, run, table, times).items():
            print(f"{step:<12} {seconds:6.3f} s of one core")
        if dask:
            rates = [rate(folder, run, table, workers) for workers in (1, 2)]
            print(f"one worker {rates[0]:.2f}, two {rates[1]:.2f} photographs a second: ", end="")
            print(f"efficiency {rates[1] / rates[0] / 2:.0%}")


def untrained_run(path: Path, encoder: str) -> RunFolder:
    """A run folder whose model has its first weights."""
    config = TrainConfig(
        data="vigor", root=".", encoder=encoder, weights="none", hfov_deg=360.0, tile_side_m=SIDE_M
    )
    run = RunFolder(path)
    run.checkpoint("best").parent.mkdir(parents=True)
    config.save(run.config_file)
    model = build_model(config)
    weights = {f"model.{name}": value for name, value in model.state_dict().items()}
    torch.save({"state_dict": weights}, run.checkpoint("best"))
    return run


def write_photos(folder: Path, count: int) -> Path:
    """A map, panoramas on it, and their table."""
    rng = np.random.default_rng(0)
    (x,), (y,) = transform("EPSG:4326", "EPSG:32631", [CENTRE[1]], [CENTRE[0]])
    half_m = MAP_PIXELS / 2 * METRES
    profile = {
        "driver": "GTiff", "dtype": "uint8", "count": 3, "crs": "EPSG:32631", "tiled": True,
        "width": MAP_PIXELS, "height": MAP_PIXELS, "compress": "jpeg", "photometric": "ycbcr",
        "transform": from_origin(x - half_m, y + half_m, METRES, METRES),
    }  # fmt: skip
    with rasterio.open(folder / "ortho.tif", "w", **profile) as file:
        file.write(np.moveaxis(texture(rng, MAP_PIXELS, MAP_PIXELS), -1, 0))
    lines = ["ground,lat,lon"]
    for number in range(count):
        pixels = texture(rng, 1024, 2048)
        Image.fromarray(pixels).save(folder / f"{number}.jpg", quality=90)
        lat, lon = offset_position(CENTRE, *rng.uniform(-250, 250, 2))
        lines.append(f"{number}.jpg,{lat:.8f},{lon:.8f}")
    table = folder / "photos.csv"
    table.write_text("\n".join(lines) + "\n")
    return table


def texture(rng: np.random.Generator, rows: int, columns: int) -> np.ndarray:
    """Random colours that change smoothly, uint8 [rows, columns, 3]."""
    coarse = rng.integers(0, 256, (rows // 16, columns // 16, 3), dtype=np.uint8)
    image = Image.fromarray(coarse).resize((columns, rows), Image.Resampling.BICUBIC)
    return np.asarray(image)


def seconds_of_steps(folder: Path, run: RunFolder, table: Path, times: int) -> dict[str, float]:
    """The processor's seconds of each step, medians."""
    localizer = Localizer.load(run.path, cache=folder / "banks", device="cpu")
    opened = AerialMap.open(folder / "ortho.tif")
    taken: dict[str, list[float]] = {}

    @contextmanager
    def timed(step: str) -> Iterator[None]:
        start = time.process_time()
        yield
        taken.setdefault(step, []).append(time.process_time() - start)

    size = localizer.config.aerial_size
    for number in range(times + 1):
        with timed("cut a tile"):
            tile = opened.cut(*offset_position(CENTRE, 40.0 * number, 0.0), SIDE_M, size)
        with timed("encode it"):
            encoded = localizer.encode_aerial(tile.image, metres_per_pixel=tile.metres_per_pixel)
        with timed("read a photo"):
            view = localizer.read_ground(table.parent / f"{number % 2}.jpg")
        with timed("answer"):
            localizer.localize(view, encoded)
    return {step: statistics.median(values[1:]) for step, values in taken.items()}


def rate(folder: Path, run: RunFolder, table: Path, workers: int) -> float:
    """Photographs a second on Dask, between the first and the last part."""
    seen: list[tuple[float, int]] = []

    def progress(done: int, _: int) -> None:
        seen.append((time.monotonic(), done))

    environ = {"distributed.nanny.pre-spawn-environ": WORKER_ENVIRON}
    with (
        dask.config.set(environ),
        # A thread each, so that two workers have twice what one has.
        LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
    ):
        locate(
            run.path, [table], folder / "ortho.tif", folder / f"answers{workers}.csv",
            cache=folder / "banks", device="cpu", dask=cluster.scheduler_address,
            progress=progress,
        )  # fmt: skip
    # The first parts of all workers wait for their runs to load.
    (start, before), (end, done) = seen[workers + 1], seen[-1]
    return (done - before) / (end - start)


if __name__ == "__main__":
    main()
