"""Generated cities in VIGOR's on-disk format.

Tiles lie on a grid of latitudes and longitudes on which neighbours overlap by about half, as
VIGOR's do: their centres are 328 of their 640 pixels apart. A panorama's positive is the tile whose
centre is nearest, and the other three of the four tiles around it are its semi-positives.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from slicemask.errors import SynthError
from slicemask.synth.formats.files import is_complete, write_picture, write_text
from slicemask.synth.formats.tiles import missing_tiles, write_tiles
from slicemask.synth.layout.city import City
from slicemask.synth.render.cameras import Panorama
from slicemask.synth.render.grade import Grade
from slicemask.synth.render.light import Light
from slicemask.synth.render.scene import Scene, View, build_scene
from slicemask.synth.vary.pictures import AerialLook, panorama_pixels
from slicemask.synth.vary.places import in_season, lay_out
from slicemask.synth.vary.switches import Variation


@dataclass(frozen=True)
class VigorCity:
    """One of VIGOR's cities: metres per pixel of its 640-pixel tiles, and its place on Earth."""

    name: str
    metres_per_pixel: float
    latitude: float
    longitude: float


# In the order in which they are generated, so that any two serve VIGOR's cross-area split, which
# trains on NewYork and Seattle and tests on SanFrancisco and Chicago.
CITIES = (
    VigorCity("NewYork", 0.113248, 40.7486, -73.9857),
    VigorCity("SanFrancisco", 0.118141, 37.7719, -122.4264),
    VigorCity("Seattle", 0.100817, 47.6131, -122.3352),
    VigorCity("Chicago", 0.111262, 41.8760, -87.6523),
)
# Where loaders look for labels, and what ends the names of the files there. The first holds VIGOR's
# corrected labels; here all of them hold the same, exact ones.
LABEL_FOLDERS = {"splits__corrected": "__corrected", "splits": "", "splits_new": ""}
LABEL_PIXELS = 640  # the scale of the labels, whatever the size of the tiles
STEP_PIXELS = 328
CAMERA_HEIGHT_M = 2.5
MARGIN_M = 45.0  # of city around the outermost tiles
# VIGOR holds up to two panoramas a tile. Here the city grows no further than this number of tiles
# a side, and then its tiles get more panoramas each.
MOST_TILES = 26
LEAST_TILES = 5  # a side of a place, for its streets to have room
METRES_PER_DEGREE = 111_320.0  # of latitude
TRIES = 1000  # for each panorama to find a place
BLOCK = 4  # tiles a side that are rendered at once, because they overlap
MOST_PLANS = 64  # that are kept in memory
PLACE_STEP_DEG = 0.05  # of longitude between a city's places


@dataclass(frozen=True)
class VigorSpec:
    """What decides every byte of one city, or of one of its places.

    Parameters
    ----------
    seed, city
        The layout's seed; the number of the city in `CITIES`.
    panoramas
        How many.
    panorama_size : (columns, rows)
    tile_size
        Pixels a side.
    place
        Its number in a city of several places, each a layout of its own; None if it is the city.
    vary
        Switches of domain randomisation that are on.
    label_noise_m
        Deviation of the labels' errors, in metres, east and north.
    """

    seed: int
    city: int
    panoramas: int
    panorama_size: tuple[int, int]
    tile_size: int
    place: int | None = None
    vary: tuple[str, ...] = ()
    label_noise_m: float = 0.0

    @property
    def layout_seed(self) -> tuple[int, ...]:
        """The seed of the layout, and the start of all others."""
        place = () if self.place is None else (1000 + self.place,)
        return (self.seed, self.city, *place)

    @property
    def variation(self) -> Variation:
        """The switches that are on, with their random numbers."""
        return Variation(self.vary, self.layout_seed)

    @property
    def metres_per_pixel(self) -> float:
        """Of the tiles as rendered."""
        return CITIES[self.city].metres_per_pixel * LABEL_PIXELS / self.tile_size

    @property
    def step_m(self) -> float:
        """Between tiles' centres: whole pixels, so that tiles can be cut out of one picture."""
        return round(STEP_PIXELS / LABEL_PIXELS * self.tile_size) * self.metres_per_pixel

    def random(self, *what: int) -> np.random.Generator:
        """Random numbers of a part of the city."""
        return np.random.default_rng([*self.layout_seed, *what])


@dataclass(frozen=True)
class VigorPlan:
    """A city with its tiles and panoramas, before anything is rendered.

    Parameters
    ----------
    city : City
        Its ground view is clear of cars around the cameras.
    info : VigorCity
    tiles_a_side
        T; the tile in row i (from the north) and column j (from the west) has number i * T + j.
    step_m
        Between tiles' centres.
    places : float64 [P, 2]
        Cameras, metres east and north of the city's centre.
    positives : int [P, 4]
        Tiles of each panorama: the positive, then the semi-positives.
    panorama_names, tile_names
        File names of the P panoramas and of all tiles.
    """

    city: City
    info: VigorCity
    tiles_a_side: int
    step_m: float
    places: NDArray[np.float64]
    positives: NDArray[np.intp]
    panorama_names: tuple[str, ...]
    tile_names: tuple[str, ...]

    def tile_centres(self, tiles: NDArray[np.intp]) -> NDArray[np.float64]:
        """Centres of tiles, metres east and north, float64 [..., 2]."""
        return _tile_centres(tiles, self.tiles_a_side, self.step_m)

    def offsets(self) -> NDArray[np.float64]:
        """Labels d0, d1 of each panorama in its four tiles, pixels of 640, float64 [P, 4, 2].

        Row = 320 + d0 and column = 320 - d1, so d0 grows to the south and d1 to the west.
        """
        off = self.tile_centres(self.positives) - self.places[:, None]
        return off[..., ::-1] / self.info.metres_per_pixel


def _tile_centres(tiles: NDArray[np.intp], tiles_a_side: int, step_m: float) -> NDArray[np.float64]:
    row, column = np.divmod(tiles, tiles_a_side)
    middle = (tiles_a_side - 1) / 2
    return np.stack([(column - middle) * step_m, (middle - row) * step_m], axis=-1)


@lru_cache(maxsize=MOST_PLANS)
def plan_city(spec: VigorSpec) -> VigorPlan:
    """Lay out a city and choose where its panoramas are taken.

    Raises
    ------
    SynthError
        If its streets have no room for them, as those of a city of a few tiles may.
    """
    info = CITIES[spec.city]
    info = replace(info, longitude=info.longitude + PLACE_STEP_DEG * (spec.place or 0))
    step_m = spec.step_m
    # About 1.2 panoramas a tile, as in VIGOR.
    least = 2 if spec.place is None else LEAST_TILES
    side = int(np.clip(np.ceil(np.sqrt(spec.panoramas / 1.2)), least, MOST_TILES))
    half_extent_m = (side - 1) / 2 * step_m + LABEL_PIXELS / 2 * info.metres_per_pixel + MARGIN_M
    city = lay_out(spec.layout_seed, half_extent_m, spec.variation, spec.place or 0)
    rng = spec.random(1)
    places = _choose_places(city, spec.panoramas, side, step_m, rng, few_roads=bool(spec.vary))
    if len(places) < spec.panoramas:
        raise SynthError(
            f"panoramas is {spec.panoramas} and seed is {spec.seed}; the streets of {info.name} "
            "then have no room for them: choose more panoramas, for a larger city, or another seed"
        )
    row = (side - 1) / 2 - places[:, 1] / step_m
    column = places[:, 0] / step_m + (side - 1) / 2
    near = np.clip(np.rint([row, column]), 0, side - 1).astype(np.intp)
    first = np.clip(np.floor([row, column]), 0, side - 2).astype(np.intp)
    far = 2 * first + 1 - near  # the other one of the two rows and columns around the camera
    positives = np.stack(
        [
            near[0] * side + near[1],
            near[0] * side + far[1],
            far[0] * side + near[1],
            far[0] * side + far[1],
        ],
        axis=1,
    )
    centres = _tile_centres(np.arange(side**2), side, step_m)
    tile_names = [
        f"satellite_{latitude:.14f}_{longitude:.14f}.png"
        for latitude, longitude in _on_earth(centres, info)
    ]
    names = [
        f"{base64.urlsafe_b64encode(rng.bytes(17)).decode()[:22]},{latitude:.6f},{longitude:.6f},.jpg"
        for latitude, longitude in _on_earth(places, info)
    ]
    return VigorPlan(
        city.clear_of_cars(places),
        info,
        side,
        step_m,
        places,
        positives,
        tuple(names),
        tuple(tile_names),
    )


def _on_earth(places: NDArray[np.float64], info: VigorCity) -> list[tuple[float, float]]:
    """Latitude and longitude of places: near one point, degrees are as good as metres."""
    latitude = info.latitude + places[:, 1] / METRES_PER_DEGREE
    east = METRES_PER_DEGREE * np.cos(np.radians(info.latitude))
    longitude = info.longitude + places[:, 0] / east
    return list(zip(latitude.tolist(), longitude.tolist(), strict=True))


def _choose_places(
    city: City,
    count: int,
    side: int,
    step_m: float,
    rng: np.random.Generator,
    few_roads: bool = False,
) -> NDArray[np.float64]:
    """Choose places on lanes, evenly along them, float64 [count, 2] or fewer for want of room.

    Tiles and streets know nothing of each other, so places in their tiles are spread evenly over
    the part that is nearest to the tile's centre, as they are in VIGOR; and no tile gets more than
    about twice the mean, of all tiles or, with few roads, of those that lanes cross.
    """
    reach = (side - 1) / 2 * step_m  # cameras have tiles on all sides
    inside = shapely.intersection(
        np.array(city.drives(), dtype=object), shapely.box(-reach, -reach, reach, reach)
    )
    lanes = shapely.get_parts(inside)
    ends = np.cumsum(shapely.length(lanes))
    tiles = side**2
    if few_roads and len(lanes):
        on_lanes = shapely.get_coordinates(shapely.segmentize(lanes, step_m / 4))
        tiles = len(np.unique(np.rint((on_lanes + reach) / step_m), axis=0))
    most = 2 * int(np.ceil(count / max(tiles, 1))) + 1
    taken = np.zeros((side, side), dtype=int)
    places: list[NDArray[np.float64]] = []
    for _ in range(TRIES * count if len(lanes) and ends[-1] else 0):
        along = rng.uniform(0, ends[-1])
        lane = int(np.searchsorted(ends, along))
        point = shapely.line_interpolate_point(lanes[lane], ends[lane] - along)
        place = shapely.get_coordinates(point)[0] + rng.normal(0, 0.25, 2)
        column, row = np.clip(np.rint((place + reach) / step_m).astype(int), 0, side - 1)
        if taken[row, column] < most:
            taken[row, column] += 1
            places.append(np.clip(place, -reach, reach))
            if len(places) == count:
                break
    return np.array(places)


@lru_cache(maxsize=1)
def _scene(spec: VigorSpec, view: View) -> Scene:
    return build_scene(in_season(plan_city(spec).city, spec.variation, view), view)


@dataclass(frozen=True)
class PanoramaTask:
    """Renders one panorama."""

    root: Path
    spec: VigorSpec
    number: int

    images = 1

    def run(self) -> int:
        """Write the panorama unless it is complete; give the number of images written."""
        plan = plan_city(self.spec)
        path = self.root / plan.info.name / "panorama" / plan.panorama_names[self.number]
        if is_complete(path, self.spec.panorama_size):
            return 0
        rng = self.spec.random(2, self.number)
        x, y = plan.places[self.number].tolist()
        position = (x, y, CAMERA_HEIGHT_M + float(rng.normal(0, 0.08)))
        camera = Panorama(position, self.spec.panorama_size[::-1])
        pixels = panorama_pixels(
            _scene(self.spec, "ground"),
            camera,
            plan.city.heading_deg(x, y),
            self.spec.variation,
            self.number,
            rng,
        )
        write_picture(path, pixels)
        return 1


@dataclass(frozen=True)
class TilesTask:
    """Renders neighbouring tiles, which overlap, in one picture and cuts them out of it."""

    root: Path
    spec: VigorSpec
    tiles: tuple[int, ...]

    @property
    def images(self) -> int:
        """Number of tiles."""
        return len(self.tiles)

    def run(self) -> int:
        """Write the tiles that are not complete; give the number of images written."""
        plan, spec = plan_city(self.spec), self.spec
        folder = self.root / plan.info.name / "satellite"
        paths = [folder / plan.tile_names[tile] for tile in self.tiles]
        missing = missing_tiles(paths, spec.tile_size)
        if missing:
            rng = spec.random(3)  # the pictures from above are of one day
            write_tiles(
                _scene(spec, "aerial"),
                plan.tile_centres(np.array(self.tiles)),
                spec.metres_per_pixel,
                spec.tile_size,
                AerialLook(
                    Light.draw(rng, aerial=True), Grade.draw(rng), spec.variation, self.tiles[0]
                ),
                {k: (paths[k], spec.random(4, self.tiles[k])) for k in missing},
            )
        return len(missing)


@dataclass(frozen=True)
class PlaceTask:
    """Renders one of a city's many places, which is small: its scenes are built once."""

    tasks: tuple[PanoramaTask | TilesTask, ...]

    @property
    def images(self) -> int:
        """Number of tiles and panoramas."""
        return sum(task.images for task in self.tasks)


def city_specs(spec: VigorSpec, places: int, plain_places: int = 0) -> list[VigorSpec]:
    """Split a city into places that share its panoramas evenly; one place is the city itself.

    So many of the places, drawn at random, are plain: no switch is on there.
    """
    if places == 1:
        return [spec]
    least, more = divmod(spec.panoramas, places)
    plain = set(spec.random(7).permutation(places)[:plain_places].tolist())
    return [
        replace(
            spec,
            place=place,
            panoramas=least + (place < more),
            vary=() if place in plain else spec.vary,
        )
        for place in range(places)
    ]


def list_tasks(root: Path, spec: VigorSpec) -> list[PanoramaTask | TilesTask | PlaceTask]:
    """The tasks that render a city or a place."""
    plan = plan_city(spec)
    blocks: dict[tuple[int, int], list[int]] = {}
    for tile in np.unique(plan.positives).tolist():
        row, column = divmod(tile, plan.tiles_a_side)
        blocks.setdefault((row // BLOCK, column // BLOCK), []).append(tile)
    tiles = [TilesTask(root, spec, tuple(block)) for block in blocks.values()]
    panoramas = (PanoramaTask(root, spec, number) for number in range(spec.panoramas))
    tasks: tuple[PanoramaTask | TilesTask, ...] = (*tiles, *panoramas)
    return [*tasks] if spec.place is None else [PlaceTask(tasks)]


def write_labels(root: Path, specs: Sequence[VigorSpec]) -> None:
    """Write a city's label files and lists of tiles, under each of `LABEL_FOLDERS`.

    Parameters
    ----------
    root : Path
        Of the data set.
    specs
        The city's places; the only one, where it is not split.
    """
    lines, listed = [], ""
    for spec in specs:
        plan = plan_city(spec)
        all_offsets = plan.offsets()
        if spec.label_noise_m:
            # As with GPS, a camera's error is the same in all of its tiles.
            errors = spec.random(6).normal(0, spec.label_noise_m, (len(all_offsets), 1, 2))
            all_offsets = all_offsets + errors / plan.info.metres_per_pixel
        for name, tiles, offsets in zip(
            plan.panorama_names, plan.positives, all_offsets, strict=True
        ):
            fields = [name]
            for tile, (d0, d1) in zip(tiles, offsets, strict=True):
                fields += [plan.tile_names[tile], f"{d0:.3f}", f"{d1:.3f}"]
            lines.append(" ".join(fields))
        listed += "".join(plan.tile_names[tile] + "\n" for tile in np.unique(plan.positives))
    order = specs[0].random(5).permutation(len(lines))
    half = (len(lines) + 1) // 2
    for label_folder, suffix in LABEL_FOLDERS.items():
        folder = root / label_folder / CITIES[specs[0].city].name
        for part, numbers in (
            ("same_area_balanced_train", np.sort(order[:half])),
            ("same_area_balanced_test", np.sort(order[half:])),
            ("pano_label_balanced", np.arange(len(lines))),
        ):
            text = "".join(lines[number] + "\n" for number in numbers)
            write_text(folder / f"{part}{suffix}.txt", text)
        write_text(folder / "satellite_list.txt", listed)
