"""A table of photographs: data of one's own.

A row is a photograph: its file, its heading, and where it was taken: u, v in an aerial tile; a
latitude and longitude in a tile whose centre is known; or those alone, with a map.
"""

import functools
import logging
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicemask.images import read_aerial, read_image
from slicematch.data.elevations import crop_elevations
from slicematch.data.errors import DatasetError
from slicematch.data.panoramas import draw_heading_deg, read_panorama, turn_panorama
from slicematch.data.photographs import Photographs, read_photographs
from slicematch.data.source import DataConfig, Part, Source
from slicematch.data.table_cameras import table_cameras
from slicematch.data.table_checks import check_rows
from slicematch.data.table_files import find_table
from slicematch.data.views import WHOLE_SPHERE, View, camera_view, cut_view
from slicematch.data.windows import Metres, cut_window, place_window, tile_pixels

if TYPE_CHECKING:
    from slicematch.data.maps import AerialMap

log = logging.getLogger(__name__)

# Of a map's tiles, where nobody says: about that of VIGOR's.
DEFAULT_SIDE_M = 70.0
# Tiles whose size is looked at to find the side that all have.
_SAMPLED_TILES = 200
# The map of a folder.
_MAP_NAMES = ("map.tif", "map.vrt", "map.jp2")


@dataclass(frozen=True, kw_only=True)
class TableConfig(DataConfig):
    """Settings of a table of photographs: those of `DataConfig` and the following.

    The root is the table, or the folder of one; ``cameras.yaml`` beside it holds the cameras that
    the column ``camera`` names (`slicematch.data.cameras.load_cameras`), and without it all
    photographs are whole panoramas. The column ``split`` tells the parts; without it, every row is
    of all of them, and the test part is what was trained on.

    Whole panoramas are turned: training draws the heading of each anew in every epoch, within the
    heading prior around north, validation and test once and for all, as with VIGOR. Other images
    keep the heading of the table, so that they take no such prior. Aerial tiles larger than the
    side are cut to it, with the camera off the centre by a random shift, drawn likewise.

    A run has one camera. Images of another one are cropped to its view and resized.

    Parameters
    ----------
    side_m : float or None
        Side of the aerial tiles on the ground, in metres, as the model sees them; None for that of
        the table's smallest tile, or, where it has a map alone, 70.
    view : (left, right, lowest, highest) or None
        The part of images that is used, in degrees: azimuths of the left and the right edge from
        the heading (of a pinhole camera from the optical axis), and elevations of the lower and the
        upper edge; None for all that the camera of most rows shows.
    shift_m : float or None
        How far the camera may stand off the centre of a tile that is cut, in metres to the east and
        to the north; None for a quarter of the side.
    map : str or None
        The aerial map of rows without a tile, any raster that GDAL reads; None for map.tif, map.vrt
        or map.jp2 beside the table.
    map_crs : str or None
        Coordinate system of the map, such as EPSG:25832; None for what its file says.

    Raises
    ------
    DatasetError
        If a value is out of its range, or the table is unreadable.
    """

    projection = "equirectangular"
    hfov_deg = None
    ground_aspect = 2.0
    camera_height_m = 2.5
    prior_centre_deg = 0.0
    train_grid = "7x7x16"
    test_grid = "21x21x64"

    ground_size: tuple[int, int] = (320, 640)
    side_m: float | None = None
    view: tuple[float, float, float, float] | None = None
    shift_m: float | None = None
    map: str | None = None
    map_crs: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.split != "same-area":
            raise DatasetError(
                f"split is {self.split!r}; a table tells its parts by its column split: make a "
                "table of each area"
            )
        if self.view is not None:
            object.__setattr__(self, "view", tuple(self.view))
            left, right, lowest, highest = self.view
            if not (left < right <= left + 360.0 and -90.0 <= lowest < highest <= 90.0):
                raise DatasetError(
                    f"view is {self.view}; it must be the azimuths of the left and of the right "
                    "edge, and the lowest and highest elevation, such as -35,35,-20,20 degrees"
                )
        for name, least in (("side_m", "above 0"), ("shift_m", "at least 0")):
            value = getattr(self, name)
            if value is not None and not (value > 0 or (value == 0 and least == "at least 0")):
                raise DatasetError(f"{name} is {value!r}; it must be {least}, in metres")
        if Path(self.root).exists():
            self._look_at_the_table()

    def _look_at_the_table(self) -> None:
        """Fill in what only the table and its cameras say."""
        photographs = self.photographs()
        if self.side_m is None:
            object.__setattr__(self, "side_m", _smallest_side_m(photographs))
        cameras = table_cameras(photographs)
        main, _ = Counter(cameras.of_rows).most_common(1)[0]
        camera = cameras.by_name[main]
        view = camera_view(camera, main) if self.view is None else View(*self.view)
        facts = {
            "view": tuple(view),
            "projection": camera.projection,
            "hfov_deg": view.hfov_deg,
            "left_deg": _left_deg(view),
            "ground_aspect": view.aspect(camera.projection),
            "horizon": view.horizon(camera.projection),
        }
        for name, value in facts.items():
            object.__setattr__(self, name, value)

    def check_root(self) -> None:
        """Refuse a root that is neither a table nor the folder of one."""
        find_table(self.root)

    def open(self, part: Part) -> "TableSource":
        """Open the samples of a part; see `DataConfig.open`."""
        return TableSource(self, part)

    def photographs(self) -> Photographs:
        """The table's rows."""
        path = find_table(self.root)
        stat = path.stat()
        return _read(path, stat.st_mtime_ns, stat.st_size)

    def aerial_map(self) -> "AerialMap | None":
        """The map of rows without a tile, if there is one.

        Raises
        ------
        MapError
            If it cannot be opened.
        """
        from slicematch.data.maps import AerialMap

        folder = find_table(self.root).parent
        beside = [folder / name for name in _MAP_NAMES if (folder / name).exists()]
        if self.map is None and not beside:
            return None
        return AerialMap.open(beside[0] if self.map is None else self.map, self.map_crs)


@functools.lru_cache(maxsize=2)
def _read(path: Path, _modified: int, _size: int) -> Photographs:
    """A table, read once for the parts of a run."""
    return read_photographs(path)


class TableSource(Source):
    """The photographs of one part of a table, and the aerial tile of each.

    Parameters
    ----------
    config : TableConfig
        Settings.
    part : {"train", "validation", "test"}
        Without rows of the validation part, it shares those for training (`validation_fraction`).

    Raises
    ------
    DatasetError
        If the table is unreadable, or a row of the part lacks what it needs.
    MapError
        If the map cannot be opened.
    """

    def __init__(self, config: TableConfig, part: Part) -> None:
        self.config = config
        self.view = WHOLE_SPHERE if config.view is None else View(*config.view)
        self.hfov_deg, self.left_deg = self.view.hfov_deg, _left_deg(self.view)
        self.horizon = self.view.horizon(config.projection)
        self.photographs = photographs = config.photographs()
        self.side_m = config.side_m or DEFAULT_SIDE_M
        self._rows = _rows(photographs, config, part)
        self._map = _map_of(config, photographs, self._rows)
        check_rows(photographs, self._rows, self._map)
        self._cameras = table_cameras(photographs)
        self._turned = self._check_cameras()
        self.names = [photographs.ids[row] for row in self._rows]
        self.tile_metres = np.full(len(self._rows), self.side_m)
        if self._turned:
            self.labels = np.arange(len(self._rows))
            self.label_count = len(self._rows)

    def _check_cameras(self) -> bool:
        """Whether all photographs can be turned; refuse cameras that do not go together."""
        names = sorted({self._cameras.of_rows[row] for row in self._rows})
        cameras = [self._cameras.by_name[name] for name in names]
        kinds = {camera.projection for camera in cameras}
        if len(kinds) > 1:
            listed = ", ".join(
                f"{name} {camera.projection}" for name, camera in zip(names, cameras, strict=True)
            )
            raise DatasetError(
                f"{self.photographs.file.path}: its cameras are of different projections "
                f"({listed}); a run has one: make a table of each"
            )
        turned = self.hfov_deg == 360.0
        if not turned and self.config.heading_prior is not None:
            raise DatasetError(
                f"heading_half_width_deg is {self.config.heading_half_width_deg:g}; only whole "
                "panoramas are turned to a prior, and these images have the headings of the "
                "table: train without one, and give one for each photograph that is located"
            )
        return turned

    def pose(self, index: int, random: np.random.Generator) -> NDArray[np.float64]:
        """The true pose of a sample; see `Source.pose`."""
        heading_deg, shift = self._draw(index, random)
        row = self._rows[index]
        if self.photographs.tile[row] is None:
            east_north = -self._centre(row, shift)[1]
        else:
            tile_side_m, camera_m = self._camera_in_tile(row)
            east_north = camera_m - self._window(row, tile_side_m, camera_m, shift)
        u, v = 0.5 + east_north * [1.0, -1.0] / self.side_m
        return np.array([u, v, heading_deg])

    def images(self, index: int, random: np.random.Generator) -> tuple[Image.Image, Image.Image]:
        """The images of a sample; see `Source.images`."""
        heading_deg, shift = self._draw(index, random)
        row = self._rows[index]
        return self._ground(row, heading_deg), self._aerial(row, shift)

    def _draw(self, index: int, random: np.random.Generator) -> tuple[float, Metres]:
        """The heading that a sample is turned to, and how far its tile's centre is moved."""
        heading_deg = draw_heading_deg(random, self.config.heading_prior)
        if not self._turned:
            heading_deg = float(self.photographs.numbers["heading_deg"][self._rows[index]])
        elif self.headings_deg is not None:
            heading_deg = float(self.headings_deg[index])
        reach = self.side_m / 4 if self.config.shift_m is None else self.config.shift_m
        return heading_deg, random.uniform(-reach, reach, 2)

    def _ground(self, row: int, heading_deg: float) -> Image.Image:
        config, path = self.config, self.photographs.ground[row]
        if not self._turned:
            camera = self._cameras.by_name[self._cameras.of_rows[row]]
            image = camera.undistort(read_image(path), path)
            return cut_view(image, camera, self.view, config.elevations, config.ground_size, path)
        panorama = read_panorama(path).image
        cropped = crop_elevations(panorama, config.elevations, config.projection, self.hfov_deg)
        rotation_deg = heading_deg - float(self.photographs.numbers["heading_deg"][row])
        return turn_panorama(cropped, rotation_deg, config.ground_size)

    def _aerial(self, row: int, shift: Metres) -> Image.Image:
        size = self.config.aerial_size
        path = self.photographs.tile[row]
        if path is None:
            assert self._map is not None  # the rows were checked
            (lat, lon), _ = self._centre(row, shift)
            return Image.fromarray(self._map.cut(lat, lon, self.side_m, size).image)
        tile_side_m, camera_m = self._camera_in_tile(row)
        window = self._window(row, tile_side_m, camera_m, shift)
        return cut_window(read_aerial(path), tile_side_m, self.side_m, window, size)

    def _window(self, row: int, tile_side_m: float, camera_m: Metres, shift: Metres) -> Metres:
        name = f"{self.photographs.file.where(row)}: tile {self.photographs.tile[row]}"
        return place_window(tile_side_m, self.side_m, camera_m, shift, name)

    def _centre(self, row: int, shift: Metres) -> tuple[tuple[float, float], Metres]:
        """Where a tile of the map is centred, and how far that is from the camera."""
        from slicematch.localization.geodesy import offset_m, offset_position

        place = self._place(row, "lat", "lon")
        centre = offset_position(place, *shift)
        return centre, -np.array(offset_m(centre, place))

    def _camera_in_tile(self, row: int) -> tuple[float, Metres]:
        """The side of a row's tile, and the camera in metres east and north of its centre."""
        numbers = self.photographs.numbers
        pixels = tile_pixels(str(self.photographs.tile[row]))
        # Of an unreadable tile nobody knows; reading its image will say so.
        side_m = pixels * float(numbers["metres_per_pixel"][row]) or self.side_m
        if not np.isnan(numbers["u"][row]):
            return side_m, side_m * np.array([numbers["u"][row] - 0.5, 0.5 - numbers["v"][row]])
        centre, place = self._place(row, "tile_lat", "tile_lon"), self._place(row, "lat", "lon")
        camera_m = _offset(centre, place)
        if np.abs(camera_m).max() > side_m / 2:
            swapped = np.abs(_offset(centre, place[::-1])).max() <= side_m / 2
            hint = ": the two are swapped" if swapped else ""
            expected = (
                f"a place in its tile, {side_m:.4g} m wide around {centre[0]:.6f},{centre[1]:.6f}, "
                f"and lat,lon is {np.hypot(*camera_m):.4g} m off its centre{hint}"
            )
            raise self.photographs.wrong(row, "lat", expected)
        return side_m, camera_m

    def _place(self, row: int, lat: str, lon: str) -> tuple[float, float]:
        numbers = self.photographs.numbers
        return float(numbers[lat][row]), float(numbers[lon][row])


def _left_deg(view: View) -> float | None:
    """The left edge of a view, or None if it is half the field of view off the heading."""
    return None if view.left_deg == -view.right_deg else view.left_deg


def _offset(centre: tuple[float, float], place: tuple[float, float]) -> Metres:
    from slicematch.localization.geodesy import offset_m

    return np.array(offset_m(centre, place))


def _smallest_side_m(photographs: Photographs) -> float:
    """The side that all tiles of a table have, in metres."""
    rows = [row for row, tile in enumerate(photographs.tile) if tile is not None]
    chosen = np.linspace(0, len(rows) - 1, _SAMPLED_TILES).astype(int) if rows else ()
    some = {rows[k] for k in chosen}
    metres = photographs.numbers["metres_per_pixel"]
    sides = [tile_pixels(str(photographs.tile[row])) * float(metres[row]) for row in some]
    return min((side for side in sides if side > 0), default=DEFAULT_SIDE_M)


def _rows(photographs: Photographs, config: TableConfig, part: Part) -> NDArray[np.intp]:
    """The rows of a part."""
    if photographs.split is None:
        if part == "test":
            log.warning(
                "%s: has no column split, so that all its rows are the test part, whether or not "
                "they were trained on",
                photographs.file.path,
            )
        rows = photographs.part(part)
        return rows[config.choose(part, len(rows))]
    if part == "test" or len(photographs.part("validation")):
        return photographs.part(part)
    rows = photographs.part("train")
    return rows[config.choose(part, len(rows))]


def _map_of(
    config: TableConfig, photographs: Photographs, rows: NDArray[np.intp]
) -> "AerialMap | None":
    """The map, if a row needs one."""
    needed = any(photographs.tile[row] is None for row in rows)
    return config.aerial_map() if needed else None
