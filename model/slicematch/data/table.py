"""A table of photographs: data of one's own.

A row is a photograph: its file, its heading, and where it was taken: u, v in an aerial tile; a
latitude and longitude in a tile whose centre is known; or those alone, with a map.
"""

import functools
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slicematch.data.errors import DatasetError
from slicematch.data.photographs import Photographs, read_photographs
from slicematch.data.source import DataConfig, Part, Source
from slicematch.data.table_cameras import table_cameras
from slicematch.data.table_files import find_table
from slicematch.data.views import View, camera_view, is_whole
from slicematch.data.vigor import VigorConfig
from slicematch.data.windows import MOST_MISSING, tile_pixels

if TYPE_CHECKING:
    from slicematch.data.maps import AerialMap

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
        object.__setattr__(self, "projection", camera.projection)
        if is_whole(camera):
            if self.view is not None:
                raise DatasetError(
                    f"view is {self.view}, and {self.root} lists whole panoramas, of which "
                    "hfov_deg and elevations tell the part that is used: leave it out, or name the "
                    "photographs' cameras in cameras.yaml beside the table"
                )
            return
        view = camera_view(camera, main) if self.view is None else View(*self.view)
        if self.hfov_deg is not None and abs(self.hfov_deg - view.hfov_deg) > 1e-6:
            raise DatasetError(
                f"hfov_deg is {self.hfov_deg:g}; the images of {self.root} show "
                f"{view.hfov_deg:.4g} degrees: leave it out, or name a part of them by view"
            )
        facts = {
            "view": tuple(view),
            "hfov_deg": view.hfov_deg,
            "left_deg": view.off_centre_left_deg,
            "ground_aspect": view.aspect(camera.projection),
            "horizon": view.horizon(camera.projection),
        }
        for name, value in facts.items():
            object.__setattr__(self, name, value)

    @classmethod
    def default_ground_size(cls, hfov_deg: float | None = None) -> tuple[int, int]:
        """As many pixels a degree as of VIGOR's: see `DataConfig.default_ground_size`."""
        return VigorConfig.default_ground_size(hfov_deg)

    def check_root(self) -> None:
        """Refuse a root that is neither a table nor the folder of one."""
        find_table(self.root)

    def open(self, part: Part) -> Source:
        """Open the samples of a part; see `DataConfig.open`."""
        from slicematch.data.table_source import TableSource

        return TableSource(self, part)

    def cut_to(self, side_m: float) -> dict[str, Any]:
        """As `DataConfig.cut_to`; where the smallest tile is too small for it, as large as that."""
        smallest = _smallest_side_m(self.photographs(), default=side_m)
        return {"side_m": side_m if smallest >= (1.0 - MOST_MISSING) * side_m else smallest}

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


def _smallest_side_m(photographs: Photographs, default: float = DEFAULT_SIDE_M) -> float:
    """The side that all tiles of a table have, in metres; the default where it has none."""
    rows = [row for row, tile in enumerate(photographs.tile) if tile is not None]
    chosen = np.linspace(0, len(rows) - 1, _SAMPLED_TILES).astype(int) if rows else ()
    some = {rows[k] for k in chosen}
    metres = photographs.numbers["metres_per_pixel"]
    sides = [tile_pixels(str(photographs.tile[row])) * float(metres[row]) for row in some]
    return min((side for side in sides if side > 0), default=default)
