"""The samples of a table of photographs: what is drawn, cut and turned for each."""

import logging
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicemask.images import read_aerial, read_image
from slicematch.data.elevations import check_elevations, crop_elevations
from slicematch.data.errors import DatasetError
from slicematch.data.panoramas import (
    LEVEL_WITHIN_DEG,
    draw_heading_deg,
    level,
    read_panorama,
    says_its_tilt,
    turn_panorama,
)
from slicematch.data.photographs import Photographs
from slicematch.data.source import Part, Source
from slicematch.data.table import DEFAULT_SIDE_M, TableConfig
from slicematch.data.table_cameras import table_cameras
from slicematch.data.table_checks import check_rows
from slicematch.data.views import View, cut_view, is_whole, level_pinhole
from slicematch.data.windows import Metres, check_tile_side, cut_window, place_window, tile_pixels

if TYPE_CHECKING:
    from slicematch.data.maps import AerialMap

log = logging.getLogger(__name__)


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
        self.hfov_deg = 360.0 if config.hfov_deg is None else config.hfov_deg
        self.left_deg, self.horizon = config.left_deg, config.horizon
        if config.view is not None:
            check_elevations(
                config.elevations,
                config.projection,
                self.hfov_deg,
                config.ground_aspect,
                self.left_deg,
                self.horizon,
            )
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
        turned = self.config.view is None
        partial = [
            name for name, camera in zip(names, cameras, strict=True) if not is_whole(camera)
        ]
        if turned and partial:
            raise DatasetError(
                f"{self.photographs.file.path}: camera {partial[0]} shows a part of what the whole "
                "panoramas of most rows do; make a table of each"
            )
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
            east_north = camera_m - place_window(tile_side_m, self.side_m, camera_m, shift)
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
            assert config.view is not None
            camera = self._cameras.by_name[self._cameras.of_rows[row]]
            image = camera.undistort(read_image(path), path)
            image = level_pinhole(image, camera, *self._tilt(row))
            view = View(*config.view)
            return cut_view(image, camera, view, config.elevations, config.ground_size, path)
        panorama = read_panorama(path, config.ground_fit).image
        tilt = self._tilt(row)
        if any(tilt) and not says_its_tilt(path):
            panorama = level(panorama, *tilt)
        cropped = crop_elevations(panorama, config.elevations, config.projection, 360.0)
        rotation_deg = heading_deg - float(self.photographs.numbers["heading_deg"][row])
        return turn_panorama(cropped, rotation_deg, config.ground_size, self.hfov_deg)

    def _tilt(self, row: int) -> tuple[float, float]:
        """Pitch and roll of a row's camera, degrees; 0 where it counts as level."""
        tilt = [self.photographs.number(name, row) or 0.0 for name in ("pitch_deg", "roll_deg")]
        return (tilt[0], tilt[1]) if max(map(abs, tilt)) > LEVEL_WITHIN_DEG else (0.0, 0.0)

    def _aerial(self, row: int, shift: Metres) -> Image.Image:
        size = self.config.aerial_size
        path = self.photographs.tile[row]
        if path is None:
            assert self._map is not None  # the rows were checked
            (lat, lon), _ = self._centre(row, shift)
            return Image.fromarray(self._map.cut(lat, lon, self.side_m, size).image)
        tile = read_aerial(path)
        tile_side_m, camera_m = self._camera_in_tile(row)
        name = f"{self.photographs.file.where(row)}: tile {path}"
        check_tile_side(tile_side_m, self.side_m, name)
        window = place_window(tile_side_m, self.side_m, camera_m, shift)
        return cut_window(tile, tile_side_m, self.side_m, window, size)

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


def _offset(centre: tuple[float, float], place: tuple[float, float]) -> Metres:
    from slicematch.localization.geodesy import offset_m

    return np.array(offset_m(centre, place))


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
