"""Photographs to be located, and what is known of each before it is looked at."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from slicemask.errors import ImageError, SlicemaskError
from slicemask.image_formats import FORMATS_TEXT
from slicemask.images import Picture, read_image
from slicematch.data.cameras import Camera
from slicematch.data.errors import DatasetError, SampleError
from slicematch.data.panoramas import LEVEL_WITHIN_DEG, level, read_panorama, says_its_tilt
from slicematch.data.photographs import read_photographs
from slicematch.data.positions import read_fix
from slicematch.data.table_cameras import table_cameras
from slicematch.data.table_files import SUFFIXES
from slicematch.data.views import View, cut_view, is_whole, level_pinhole
from slicematch.errors import ConfigError
from slicematch.localization.geodesy import check_centre
from slicematch.localization.localizer import COMPASS_DEG, HeadingPrior
from slicematch.runs.config import TrainConfig

_IMAGES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")
# A camera is sought within so many times the accuracy that its receiver reckons.
_ACCURACIES, _LEAST_REACH = 3.0, 1 / 8


@dataclass(frozen=True)
class Photo:
    """A photograph to be located.

    Attributes
    ----------
    row : int
        Its place in the list.
    id : str
        Its name in the answers, which no other has.
    ground : str
        Its file.
    lat, lon : float or None
        Where it is sought, degrees on WGS 84.
    accuracy_m : float or None
        What its receiver says of that.
    heading_deg : float or None
        Of its centre column, as its compass says.
    pitch_deg, roll_deg : float
        Of its camera, if it was tilted (`slicematch.data.panoramas.level`).
    camera : Camera or None
        That took it, if a table says so; None for the run's own, or a whole panorama.
    error : str or None
        Why it cannot be located, if that is known already.
    """

    row: int
    id: str
    ground: str
    lat: float | None = None
    lon: float | None = None
    accuracy_m: float | None = None
    heading_deg: float | None = None
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    camera: Camera | None = None
    error: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Its attributes by name."""
        return asdict(self)

    def place(self) -> tuple[float, float]:
        """Latitude and longitude where it is sought.

        Raises
        ------
        SampleError
            If it says nothing of that, or cannot be located for another reason.
        """
        if self.error is not None or self.lat is None or self.lon is None:
            raise SampleError(self.error or f"{self.ground}: says nothing of where it was taken")
        return self.lat, self.lon

    def image(self, config: TrainConfig) -> Picture:
        """What a run takes of it: its file, or an image that is levelled and of the run's view.

        Raises
        ------
        ImageError
            If it cannot be read, or does not show the run's view.
        """
        tilt = self.pitch_deg, self.roll_deg
        tilted = max(map(abs, tilt)) > LEVEL_WITHIN_DEG
        view, size = config.data_settings.get("view"), config.ground_size
        if self.camera is not None and self.camera.projection != config.projection:
            raise ImageError(
                f"{self.ground}: its camera is {self.camera.projection}, and the run was trained "
                f"with {config.projection} images; name a run of such cameras"
            )
        if self.camera is not None and view is not None and size is not None:
            image = self.camera.undistort(read_image(self.ground), self.ground)
            if tilted and self.camera.projection == "pinhole":
                image = level_pinhole(image, self.camera, *tilt)
            # Not yet as small as the run takes it: that follows once elevations are cropped.
            width = max(size[1], min(image.width, 2 * size[1]))
            height = round(width / View(*view).aspect(self.camera.projection))
            return cut_view(image, self.camera, View(*view), None, (height, width), self.ground)
        if tilted and self.camera is None and not says_its_tilt(self.ground):
            return level(read_panorama(self.ground, config.ground_fit).image, *tilt)
        return self.ground

    def known(self, priors: "Priors", within_m: float | None) -> dict[str, Any]:
        """What is known of it, as columns of `slicematch.localization.answers.ANSWER_COLUMNS`."""
        row = {"row": self.row, "id": self.id, "ground": self.ground}
        row |= {"prior_lat": self.lat, "prior_lon": self.lon, "prior_within_m": within_m}
        if heading := priors.heading(self):
            row |= {"prior_heading_deg": heading[0], "prior_heading_half_width_deg": heading[1]}
        return row


@dataclass(frozen=True)
class Priors:
    """What is known of all photographs alike.

    Attributes
    ----------
    near : (lat, lon) or None
        Where they were taken; None for what each says of itself.
    within_m : float or None
        How far from there; None for three times the accuracy that each says, or else anywhere in
        the tile.
    heading_deg : float or None
        Which way they look; None for what each says of itself.
    heading_half_width_deg : float or None
        Within how many degrees of that; None for 30, a compass's.
    """

    near: tuple[float, float] | None = None
    within_m: float | None = None
    heading_deg: float | None = None
    heading_half_width_deg: float | None = None

    def __post_init__(self) -> None:
        if self.near is not None:
            object.__setattr__(self, "near", check_centre(self.near, "the place"))
        if self.within_m is not None and not (math.isfinite(self.within_m) and self.within_m > 0):
            raise ConfigError(f"within is {self.within_m:g} m; it must be above 0")
        width = self.heading_half_width_deg
        if width is not None and not 0 <= width <= 180:
            raise ConfigError(f"headings are within {width:g} degrees; it must be from 0 to 180")
        if self.heading_deg is not None and not math.isfinite(self.heading_deg):
            raise ConfigError(f"the heading is {self.heading_deg:g} degrees; it must be finite")

    def distance_m(self, photo: Photo, side_m: float) -> float | None:
        """How far from its place a photograph is sought, metres; None for anywhere in the tile.

        An accuracy that a photograph says of itself leaves an eighth of the tile's side at least.
        """
        if self.within_m is not None:
            return self.within_m
        if photo.accuracy_m is None:
            return None
        return max(_ACCURACIES * photo.accuracy_m, _LEAST_REACH * side_m)

    def heading(self, photo: Photo) -> HeadingPrior | None:
        """The prior (centre, half width) of a photograph's heading, degrees; None for the run's."""
        centre_deg = photo.heading_deg if self.heading_deg is None else self.heading_deg
        width_deg = self.heading_half_width_deg
        if width_deg is not None and width_deg >= 180:
            return 0.0, 180.0
        if centre_deg is None:
            return None
        return centre_deg, COMPASS_DEG if width_deg is None else width_deg


def find_photos(
    sources: Sequence[str | Path], near: tuple[float, float] | None = None
) -> list[Photo]:
    """The photographs that are named, and what they or their table say of their places.

    Parameters
    ----------
    sources : sequence of path
        Images, folders of images, patterns such as ``photos/*.jpg``, or tables
        (`slicematch.data.photographs.read_photographs`), of which the columns ``ground`` and, where
        they are known, ``id``, ``lat``, ``lon``, ``accuracy_m``, ``heading_deg``, ``pitch_deg``,
        ``roll_deg`` and ``camera`` are used.
    near : (lat, lon), optional
        Where all of them were taken, whatever they say themselves.

    Returns
    -------
    list of Photo
        In the order named, folders and patterns by name. One that cannot be located, since it
        says nothing of its place, has an `error`.

    Raises
    ------
    DatasetError
        If nothing is found, a table is invalid, or an id comes twice.
    """
    found: list[dict[str, Any]] = []
    for source in sources:
        path = Path(source)
        if path.suffix.lower() in SUFFIXES and path.is_file():
            found += _rows_of(path)
        else:
            found += [{"ground": str(image)} for image in _images(path)]
    photos = [photo_of(number, row, near) for number, row in enumerate(found)]
    _check_ids(photos)
    return photos


def _images(path: Path) -> Iterable[Path]:
    """The images that a path names: itself, those of a folder, or those of a pattern."""
    if path.is_file():
        return [path]
    if path.is_dir():
        images = [one for one in sorted(path.iterdir()) if one.suffix.lower() in _IMAGES]
        if not images:
            raise DatasetError(f"{path}: holds no image; name a folder of {FORMATS_TEXT} files")
        return images
    if any(sign in str(path) for sign in "*?["):
        pattern = path.relative_to(path.anchor) if path.is_absolute() else path
        images = sorted(one for one in Path(path.anchor).glob(str(pattern)) if one.is_file())
        if images:
            return images
        raise DatasetError(f"{path}: no file has such a name; check the pattern")
    raise DatasetError(f"{path}: there is no such file or folder; name photographs or a table")


def _rows_of(path: Path) -> list[dict[str, Any]]:
    """The rows of a table, with what they say of themselves."""
    photographs = read_photographs(path)
    named = "id" in photographs.file.columns
    cameras = table_cameras(photographs)
    rows = []
    for number, ground in enumerate(photographs.ground):
        row: dict[str, Any] = {"ground": ground}
        if named:
            row["id"] = photographs.ids[number]
        camera = cameras.by_name[cameras.of_rows[number]]
        if not is_whole(camera):
            row["camera"] = camera
        for column in ("lat", "lon", "accuracy_m", "heading_deg", "pitch_deg", "roll_deg"):
            value = photographs.number(column, number)
            if value is not None:
                row[column] = value
        rows.append(row)
    return rows


def photo_of(number: int, row: dict[str, Any], near: tuple[float, float] | None) -> Photo:
    """A photograph with what it says of itself, where its row, or `near`, does not say more."""
    row = {"id": row["ground"]} | row
    if near is not None:
        row |= {"lat": near[0], "lon": near[1]}
    try:
        if "lat" not in row or "lon" not in row:
            fix = asdict(read_fix(row["ground"]))
            row = {name: value for name, value in fix.items() if value is not None} | row
        check_centre((row["lat"], row["lon"]), "its place")
    except SlicemaskError as error:
        row["error"] = str(error)
    return Photo(number, **row)


def _check_ids(photos: list[Photo]) -> None:
    seen: dict[str, int] = {}
    for photo in photos:
        if photo.id in seen:
            raise DatasetError(
                f"photographs {seen[photo.id] + 1} and {photo.row + 1} are both {photo.id!r}; each "
                "needs an id of its own: name it once, or give a table a column id"
            )
        seen[photo.id] = photo.row
