"""Small data trees in the exact on-disk formats of VIGOR and KITTI, with pictures to learn from.

Every ground image is painted from its aerial tile: a column shows the colours that a ray from the
camera at that column's azimuth meets, near ones at the bottom and far ones at the top. A model
that matches slices therefore has something true to find.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

# Triton reads this when it is imported: without a GPU, its kernels are interpreted.
if not torch.cuda.is_available():
    os.environ["TRITON_INTERPRET"] = "1"

VIGOR_METRES_PER_PIXEL = {
    "NewYork": 0.113248,
    "Seattle": 0.100817,
    "SanFrancisco": 0.118141,
    "Chicago": 0.111262,
}
KITTI_METRES_PER_PIXEL = 156543.03392 * np.cos(np.radians(49.015)) / 2**18 / 2
KITTI_FOCAL_PIXELS = 721.5377
KITTI_CENTRE = (609.5593, 172.854)
CAMERA_AHEAD_M, CAMERA_RIGHT_M = 1.08, 0.26


@dataclass(frozen=True)
class VigorTree:
    """A VIGOR tree as written: `labels[city]` lists (panorama, tile, d0, d1) of the pairs."""

    root: Path
    labels: dict[str, list[tuple[str, str, float, float]]]


@dataclass(frozen=True)
class KittiTree:
    """A KITTI tree as written: `frames` lists the paths, `tests` their (sx, sy, theta).

    The images reach from the first to the second of `edges_deg`, azimuths from the optical axis.
    """

    root: Path
    frames: list[str]
    tests: np.ndarray
    edges_deg: tuple[float, float]


@pytest.fixture(scope="session")
def make_vigor_tree():
    """The function that writes a VIGOR tree (see `write_vigor_tree`)."""
    return write_vigor_tree


@pytest.fixture(scope="session")
def make_kitti_tree():
    """The function that writes a KITTI tree (see `write_kitti_tree`)."""
    return write_kitti_tree


@pytest.fixture
def true_colours(monkeypatch):
    """Augmentation that turns and mirrors, but leaves the colours alone."""
    monkeypatch.setattr(
        "slicematch.data.dataset.recolour", lambda ground, aerial, *_: (ground, aerial)
    )


@pytest.fixture
def sample_view():
    """The function that samples a ground image from a tile (see `look_around`)."""
    return look_around


@pytest.fixture
def paint_texture():
    """The function that paints a random tile (see `texture`)."""
    return texture


def texture(rng, pixels, blocks=8):
    """Paint uint8 [pixels, pixels, 3]: random colours that change smoothly over `blocks` cells."""
    coarse = Image.fromarray(rng.integers(0, 256, (blocks, blocks, 3), dtype=np.uint8))
    return np.asarray(coarse.resize((pixels, pixels), Image.Resampling.BICUBIC))


def look_around(tile, place, azimuth_deg, ranges):
    """Sample a ground image uint8 [rows, columns, 3] from a tile.

    Parameters: the camera's `place` (u, v) in the tile, the azimuth of each column (clockwise from
    north) and the range of each row, as a share of the tile's side. Off the tile it is grey.
    """
    azimuth = np.radians(azimuth_deg)
    u = place[0] + np.outer(ranges, np.sin(azimuth))
    v = place[1] - np.outer(ranges, np.cos(azimuth))
    size = len(tile)
    inside = (u >= 0) & (u < 1) & (v >= 0) & (v < 1)
    row, col = (np.clip((x * size).astype(int), 0, size - 1) for x in (v, u))
    return np.where(inside[..., None], tile[row, col], np.uint8(128))


def write_vigor_tree(
    root,
    pairs=8,
    *,
    cities=("Chicago",),
    test_pairs=None,
    panorama_size=(256, 512),
    tile_pixels=320,
    reach_pixels=150,
    seed=0,
):
    """Write a VIGOR tree and return it as a `VigorTree`.

    `pairs` training pairs a city; the test file repeats them unless `test_pairs` asks for others.
    Corrected labels and the originals (which assume 0.114 m/px) are both written, no file ending
    in a newline. Labels lie within `reach_pixels` of the tile's centre, on the 640-pixel scale.
    """
    root = Path(root)
    rng = np.random.default_rng(seed)
    labels = {}
    for city in cities:
        (root / city / "panorama").mkdir(parents=True)
        (root / city / "satellite").mkdir(parents=True)
        found = []
        for number in range(pairs + (test_pairs or 0)):
            lat, lon = 41.8 + number / 1000, -87.6 - number / 1000
            panorama = f"pano_{number:03d}-{city},{lat:.6f},{lon:.6f},.jpg"
            aerial = f"satellite_{lat + 1e-5:.14f}_{lon - 1e-5:.14f}.png"
            d0, d1 = rng.integers(-reach_pixels, reach_pixels + 1, 2).astype(float)
            tile = texture(rng, tile_pixels)
            place = (320 - d1) / 640, (320 + d0) / 640
            height, width = panorama_size
            azimuth_deg = 360 * ((np.arange(width) + 0.5) / width - 0.5)
            ranges = 0.5 * (1 - (np.arange(height) + 0.5) / height)
            view = look_around(tile, place, azimuth_deg, ranges)
            Image.fromarray(tile).save(root / city / "satellite" / aerial)
            Image.fromarray(view).save(root / city / "panorama" / panorama, quality=95)
            found.append((panorama, aerial, d0, d1))
        labels[city] = found
        train, test = found[:pairs], found[pairs:] or found
        lists = {
            "same_area_balanced_train": train,
            "same_area_balanced_test": test,
            "pano_label_balanced": found,
        }
        assumed = VIGOR_METRES_PER_PIXEL[city] / 0.114
        for folder, suffix, scale in (
            ("splits__corrected", "__corrected", 1.0),
            ("splits", "", assumed),
        ):
            (root / folder / city).mkdir(parents=True)
            for name, listed in lists.items():
                text = "\n".join(vigor_line(*pair, scale=scale) for pair in listed)
                (root / folder / city / f"{name}{suffix}.txt").write_text(text)
            tiles = "\n".join(pair[1] for pair in found)
            (root / folder / city / "satellite_list.txt").write_text(tiles + "\n")
    return VigorTree(root, labels)


def vigor_line(panorama, aerial, d0, d1, scale=1.0):
    """One label line: the positive and three semi-positives around it."""
    fields = [panorama]
    for step0, step1 in ((0, 0), (0, 329), (-327, 0), (-327, 329)):
        fields += [aerial, f"{round(d0 * scale) + step0}.0", f"{round(d1 * scale) + step1}.0"]
    return " ".join(fields)


def write_kitti_tree(
    root,
    pairs=8,
    *,
    date="2011_09_26",
    ground_size=(125, 414),
    tile_pixels=1280,
    blocks=24,
    range_m=40.0,
    calib=True,
    seed=0,
):
    """Write a KITTI tree as cut by LM and return it as a `KittiTree`.

    The same `pairs` frames stand in the training file and, with seeded (sx, sy, theta), in both
    test files. Each aerial tile is centred on the GPS unit; the camera stands ahead and to the
    right of it and looks along the frame's heading, which differs from frame to frame.
    """
    root = Path(root)
    rng = np.random.default_rng(seed)
    drive = f"{date}/{date}_drive_0001_sync"
    images = root / "raw_data" / drive / "image_02" / "data"
    oxts = root / "raw_data" / drive / "oxts" / "data"
    satmap = root / "satmap" / drive
    for folder in (images, oxts, satmap):
        folder.mkdir(parents=True)
    span_m = tile_pixels * KITTI_METRES_PER_PIXEL
    height, width = ground_size
    column = 1242 * (np.arange(width) + 0.5) / width
    principal_column = KITTI_CENTRE[0] if calib else 621
    azimuth_deg = np.degrees(np.arctan((column - principal_column) / KITTI_FOCAL_PIXELS))
    ranges = range_m / span_m * (1 - (np.arange(height) + 0.5) / height)
    frames = []
    for number in range(pairs):
        heading = rng.uniform(-np.pi, np.pi)  # radians, 0 east, counter-clockwise
        east = CAMERA_AHEAD_M * np.cos(heading) + CAMERA_RIGHT_M * np.sin(heading)
        north = CAMERA_AHEAD_M * np.sin(heading) - CAMERA_RIGHT_M * np.cos(heading)
        place = 0.5 + east / span_m, 0.5 - north / span_m
        tile = texture(rng, tile_pixels, blocks)
        view = look_around(tile, place, 90 - np.degrees(heading) + azimuth_deg, ranges)
        frame = f"{number:010d}"
        Image.fromarray(view).save(images / f"{frame}.png")
        Image.fromarray(tile).save(satmap / f"{frame}.png", compress_level=1)
        fields = [49.01, 8.43, 112.8, 0.03, 0.01, heading] + [0.0] * 24
        (oxts / f"{frame}.txt").write_text(" ".join(f"{x:.13f}" for x in fields) + "\n")
        frames.append(f"{drive}/{frame}.png")
    if calib:
        focal, (cx, cy) = KITTI_FOCAL_PIXELS, KITTI_CENTRE
        row = f"{focal} 0 {cx} 44.85728 0 {focal} {cy} 0.2163791"
        (root / "raw_data" / date / "calib_cam_to_cam.txt").write_text(
            "calib_time: 09-Jan-2012 13:57:47\n"
            "S_rect_02: 1.242000e+03 3.750000e+02\n"
            f"P_rect_02: {row} 0 0 1 2.745884e-03\n"
            "S_rect_03: 1.242000e+03 3.750000e+02\n"
        )
    tests = np.round(rng.uniform(-1, 1, (pairs, 3)), 4)
    (root / "train_files.txt").write_text("\n".join(frames) + "\n")
    lines = [f"{frame} {sx} {sy} {t}" for frame, (sx, sy, t) in zip(frames, tests, strict=True)]
    for name in ("test1_files.txt", "test2_files.txt"):
        (root / name).write_text("\n".join(lines) + "\n")
    edges = ((column - principal_column) / KITTI_FOCAL_PIXELS for column in (0, 1242))
    return KittiTree(root, frames, tests, tuple(np.degrees(np.arctan(list(edges)))))


# A tiny run, trained for one epoch: its answers are poor, and as good as any to check.


@pytest.fixture(scope="session")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("banks")


@pytest.fixture(scope="session")
def vigor(make_vigor_tree, tmp_path_factory):
    root = tmp_path_factory.mktemp("data") / "vigor"
    return make_vigor_tree(root, 5, panorama_size=(64, 128), tile_pixels=80)


@pytest.fixture(scope="session")
def run(vigor, tmp_path_factory, cache):
    """The folder of a run on a VIGOR tree."""
    from slicematch.runs.config import TrainConfig
    from slicematch.training.train import train

    config = TrainConfig(
        data="vigor",
        root=str(vigor.root),
        data_settings={"cities": ["Chicago"]},
        encoder="test_convnext",
        weights="none",
        ground_size=(32, 64),
        aerial_size=64,
        slices=4,
        train_grid="3x3x4",
        test_grid="4x5x8",
        epochs=1,
        batch_size=2,
        validation_fraction=0.0,
        heat_map_every=0,
        workers=0,
        accelerator="cpu",
    )
    return train(config, tmp_path_factory.mktemp("runs") / "vigor", cache=cache, progress=False)


@pytest.fixture(scope="session")
def localizer(run, cache):
    from slicematch.localization.localizer import Localizer

    return Localizer.load(run, cache=cache, device="cpu")


@pytest.fixture(scope="session")
def images(vigor):
    panorama, tile, *_ = vigor.labels["Chicago"][0]
    city = vigor.root / "Chicago"
    return city / "panorama" / panorama, city / "satellite" / tile


@pytest.fixture
def slicemask(run, cache):
    """Run a command on the run's banks; give its result."""
    from click.testing import CliRunner

    from slicemask.cli.main import main

    def invoke(command, *arguments):
        arguments = [command, str(run), "--cache", str(cache), "--device", "cpu", *arguments]
        return CliRunner().invoke(main, [str(argument) for argument in arguments])

    return invoke


# A map of one place, and photographs taken on it.

MAP_CENTRE = 51.9990, 4.3735
MAP_METRES_PER_PIXEL, MAP_PIXELS = 0.5, 600


@dataclass(frozen=True)
class MappedPhotos:
    """A map and its photographs: where each was taken (lat, lon, heading_deg)."""

    map: Path
    folder: Path
    poses: dict[str, tuple[float, float, float]]


@pytest.fixture(scope="session")
def make_mapped_photos():
    """The function that writes a map and photographs taken on it (see `write_mapped_photos`)."""
    return write_mapped_photos


@pytest.fixture(scope="session")
def mapped(make_mapped_photos, tmp_path_factory):
    """A map of 300 m, and six photographs on it."""
    return make_mapped_photos(tmp_path_factory.mktemp("mapped"))


def write_mapped_photos(folder, count=6, *, reach_m=60.0, gps_noise_m=2.0, seed=0):
    """Write a GeoTIFF and panoramas taken on it, with GPS in their EXIF data, `MappedPhotos`."""
    rasterio = pytest.importorskip("rasterio")
    from PIL import ExifTags
    from rasterio.transform import from_origin
    from rasterio.warp import transform
    from slicematch.localization.geodesy import offset_position

    folder = Path(folder)
    rng = np.random.default_rng(seed)
    pixels = texture(rng, MAP_PIXELS, 40)
    (x,), (y,) = transform("EPSG:4326", "EPSG:32631", [MAP_CENTRE[1]], [MAP_CENTRE[0]])
    half_m = MAP_PIXELS / 2 * MAP_METRES_PER_PIXEL
    origin = from_origin(x - half_m, y + half_m, MAP_METRES_PER_PIXEL, MAP_METRES_PER_PIXEL)
    profile = {"driver": "GTiff", "dtype": "uint8", "count": 3, "crs": "EPSG:32631"}
    profile |= {"width": MAP_PIXELS, "height": MAP_PIXELS, "transform": origin, "tiled": True}
    with rasterio.open(folder / "ortho.tif", "w", **profile) as file:
        file.write(np.moveaxis(pixels, -1, 0))
    (folder / "photos").mkdir()
    poses = {}
    for number in range(count):
        east_m, north_m = rng.uniform(-reach_m, reach_m, 2)
        heading_deg = float(rng.uniform(0, 360))
        azimuth_deg = heading_deg + 360 * ((np.arange(128) + 0.5) / 128 - 0.5)
        ranges = 35 / (2 * half_m) * (1 - (np.arange(64) + 0.5) / 64)
        place = 0.5 + east_m / (2 * half_m), 0.5 - north_m / (2 * half_m)
        view = look_around(pixels, place, azimuth_deg, ranges)
        lat, lon = offset_position(MAP_CENTRE, east_m, north_m)
        noise = rng.normal(0, gps_noise_m, 2)
        exif = Image.Exif()
        exif.get_ifd(ExifTags.IFD.GPSInfo).update(gps_tags(*offset_position((lat, lon), *noise)))
        name = f"photo_{number:03d}.jpg"
        Image.fromarray(view).save(folder / "photos" / name, exif=exif, quality=95)
        poses[name] = lat, lon, heading_deg
    return MappedPhotos(folder / "ortho.tif", folder / "photos", poses)


def gps_tags(lat, lon):
    """EXIF's GPS tags of a place, to a millimetre."""
    from PIL.TiffImagePlugin import IFDRational

    def parts(value):
        return IFDRational(round(abs(value) * 10**8), 10**8), IFDRational(0), IFDRational(0)

    return {
        1: "S" if lat < 0 else "N", 2: parts(lat), 3: "W" if lon < 0 else "E", 4: parts(lon),
    }  # fmt: skip


@pytest.fixture
def one_thread():
    """Torch computes with one thread, as it does in each of Dask's processes."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
