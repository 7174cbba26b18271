"""Locating many photographs on a map, with a trained run."""

import functools
import logging
import uuid
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from slicemask._version import __version__
from slicemask.errors import ImageError
from slicematch.data.errors import SampleError
from slicematch.data.lattice import lattice_point, lattice_step
from slicematch.data.loading import raise_lack_of_resources
from slicematch.data.maps import AerialMap
from slicematch.digits import digits
from slicematch.errors import ConfigError, RunError
from slicematch.localization.answers import ANSWER_COLUMNS, check_answers_target, write_answers
from slicematch.localization.localizer import Localizer
from slicematch.localization.on_map import MapLocalizer, PlaceOnGlobe, tile_side
from slicematch.localization.photos import Photo, Priors, find_photos
from slicematch.localization.refinement import DEFAULT, Refine
from slicematch.parts import Parts, Row, digest, import_pyarrow, run_parts, split_groups
from slicematch.precision import Precision
from slicematch.runs.folder import Checkpoint, RunFolder
from slicematch.runs.shipped import find_run

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Locating:
    """What is done to photographs: it goes to other processes, and loads the run once in each.

    Attributes
    ----------
    run, map : str
        The run's folder, and the map's file.
    map_crs : str or None
        The map's coordinate system, where its file does not say.
    priors : Priors
        What is known of all photographs alike.
    side_m, shared_m : float or None
        As `MapLocalizer` takes them.
    settings : tuple of (name, value)
        Further arguments of `Localizer.load`.
    call : str
        Tells calls apart: the run or the map may have changed since the last one.
    """

    run: str
    map: str
    map_crs: str | None = None
    priors: Priors = field(default_factory=Priors)
    side_m: float | None = None
    shared_m: float | None = None
    settings: tuple[tuple[str, Any], ...] = ()
    call: str = field(default_factory=lambda: uuid.uuid4().hex)

    columns: ClassVar[Mapping[str, str]] = ANSWER_COLUMNS

    def __call__(self, items: Sequence[Photo]) -> list[Row]:
        """The answers of some photographs, or why there are none."""
        return [self.answer(photo) for photo in items]

    def answer(self, photo: Photo) -> Row:
        """The answer of one photograph; of one that cannot be located, the error."""
        row = photo.known(self.priors, None)
        try:
            lat, lon = photo.place()
            on_map = self.localizer()
            place = PlaceOnGlobe(lat, lon, self.priors.distance_m(photo, on_map.side_m))
            row["prior_within_m"] = place.within_m
            ground = photo.image(on_map.localizer.config)
            found = on_map.localize(ground, place, self.priors.heading(photo))
        except (ImageError, SampleError, ConfigError) as error:
            raise_lack_of_resources(error)
            return row | {"error": str(error)}
        return row | found.as_row()

    def localizer(self) -> MapLocalizer:
        """The run and the map, loaded in this process."""
        return _loaded(self)


@functools.lru_cache(maxsize=1)
def _loaded(work: Locating) -> MapLocalizer:
    localizer = Localizer.load(work.run, **dict(work.settings))
    opened = AerialMap.open(work.map, work.map_crs)
    return MapLocalizer(localizer, opened, work.side_m, work.shared_m)


@dataclass(frozen=True)
class Located:
    """Answers of many photographs.

    Attributes
    ----------
    answers : pandas.DataFrame
        One row a photograph, in their order (`slicematch.localization.answers`).
    crs : str
        The map's coordinate system, of the columns x and y.
    calibrated : bool
        Whether the probabilities come from a fitted temperature.
    out, picture : Path or None
        The files that were written.
    """

    answers: Any
    crs: str
    calibrated: bool
    out: Path | None = None
    picture: Path | None = None

    @property
    def failed(self) -> Any:
        """The rows of photographs without an answer."""
        return self.answers[self.answers["error"].notna()]

    def summary(self) -> dict[str, Any]:
        """How many were located, and how sure that is: plain values, for JSON."""
        found = self.answers[self.answers["error"].isna()]
        content: dict[str, Any] = {
            "photographs": len(self.answers),
            "located": len(found),
            "crs": self.crs,
            "calibrated": self.calibrated,
            "padded_tiles": int((found["tile_padded"] > 0).sum()),
        }
        if len(found):
            likely = found["probability"].to_numpy()
            spread = np.hypot(found["std_east_m"], found["std_north_m"])
            content |= {
                "probability_median": round(float(np.median(likely)), 4),
                "probability_above_half": int((likely > 0.5).sum()),
                "std_place_median_m": round(float(np.median(spread)), 3),
                "std_heading_median_deg": round(float(found["std_heading_deg"].median()), 3),
            }
        failures = self.failed[["id", "error"]].to_dict("records")
        files = {"out": self.out, "picture": self.picture}
        content["failed"] = failures
        return content | {name: str(path) for name, path in files.items() if path is not None}

    def __str__(self) -> str:
        return self.report()

    def report(self, most: int = 10) -> str:
        """The summary as a few lines of text, with the first of those without an answer."""
        content = self.summary()
        lines = [f"{content['located']:,} of {content['photographs']:,} photographs located"]
        if content["located"]:
            lines.append(
                f"probability {content['probability_median']:.1%} at the median"
                + ("" if self.calibrated else " (uncalibrated)")
                + f", above one half for {content['probability_above_half']:,}; standard "
                f"deviation {digits(content['std_place_median_m'])} m and "
                f"{digits(content['std_heading_median_deg'])} degrees at the median"
            )
        if content["padded_tiles"]:
            lines.append(
                f"{content['padded_tiles']:,} were sought in tiles that reach over the map's edge "
                "(column tile_padded)"
            )
        failures = content["failed"]
        lines += [f"not located: {entry['error']}" for entry in failures[:most]]
        if len(failures) > most:
            lines.append(f"and {len(failures) - most:,} more (column error)")
        return "\n".join(
            [*lines, *(content[name] for name in ("out", "picture") if name in content)]
        )


def locate(
    run: str | Path,
    photos: Sequence[str | Path],
    aerial_map: str | Path,
    out: str | Path,
    *,
    priors: Priors | None = None,
    picture: str | Path | None = None,
    map_crs: str | None = None,
    side_m: float | None = None,
    shared_m: float | None = None,
    grid: str | None = None,
    bank: str | Path | None = None,
    checkpoint: Checkpoint = "best",
    device: str = "auto",
    cache: str | Path | None = None,
    refine: Refine = DEFAULT,
    precision: Precision = "32-true",
    alone: bool = False,
    dask: str | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Located:
    """Find where photographs were taken on a map, and write the answers.

    Answers are kept in parts beside the file as they come, and become the file at the end. Stopped
    and repeated, the same call goes on where it was. A photograph that cannot be located is listed
    with the reason, and the rest goes on.

    Parameters
    ----------
    run : path
        A run folder.
    photos : sequence of path
        Images, folders, patterns or tables (`slicematch.localization.photos.find_photos`).
    aerial_map : path
        A georeferenced raster (`slicematch.data.maps.AerialMap.open`).
    out : path
        The answers: ``.gpkg``, ``.geojson``, ``.csv`` or ``.parquet``
        (`slicematch.localization.answers.write_answers`).
    priors : Priors, optional
        What is known of all photographs alike; what each says of itself by default.
    picture : path, optional
        A picture of the map with all answers and their ellipses: PNG, SVG or PDF.
    map_crs : str, optional
        The map's coordinate system, where its file does not say.
    side_m : float, optional
        Side of the tiles on the ground; the run's own by default.
    shared_m : float, optional
        Photographs share tiles on a lattice of so many metres; a sixteenth of the side by default.
    grid, bank, checkpoint, device, cache, refine, precision, alone
        As `Localizer.load` takes them.
    dask : str, optional
        Do it on Dask: "local", a number of processes here, or a scheduler's address. The files must
        have the same names on all machines.
    overwrite : bool
        Replace a file of answers that is there, and parts of another request.
    progress : callable, optional
        Called with (photographs done, photographs in all).

    Returns
    -------
    Located

    Raises
    ------
    RunError, ConfigError, BankError, MapError, DatasetError
        If the run, the request, the map or a table is unusable.
    OutputError, PlotError
        If a file cannot be written where it should go, or is there already.
    """
    import_pyarrow()
    priors = priors or Priors()
    target = _check_targets(out, picture, overwrite)
    config = RunFolder(find_run(run)).load_config()
    step_m = lattice_step(tile_side(config, side_m), shared_m)
    opened = AerialMap.open(aerial_map, map_crs)  # the likeliest slips, before anything is loaded
    found = find_photos(photos, priors.near)
    settings = {
        "bank": None if bank is None else str(bank),
        "grid": grid,
        "checkpoint": checkpoint,
        "device": device,
        "cache": None if cache is None else str(cache),
        "refine": refine,
        "precision": precision,
        "alone": alone,
    }
    work = Locating(
        run=str(run),
        map=opened.path,
        map_crs=map_crs,
        priors=priors,
        side_m=side_m,
        shared_m=shared_m,
        settings=tuple(settings.items()),
    )
    localizer = work.localizer().localizer  # and what else can be wrong, and the bank, once
    folder = target.with_name(f"{target.name}.parts")
    request = asdict(work) | {
        # Not when and where it is done, which may change before it goes on.
        "call": None,
        "settings": {k: v for k, v in settings.items() if k not in ("device", "cache")},
        "version": __version__,
        "weights": digest(RunFolder(find_run(run)).checkpoint(checkpoint)),
        "temperature": localizer.temperature,
        "photographs": digest([photo.as_dict() for photo in found]),
    }
    parts = Parts(folder, request, afresh=overwrite)
    table = run_parts(work, parts, partition(found, step_m), dask, progress)
    answers = table.sort_by("row").to_pandas()
    _check_complete(answers, found)
    write_answers(answers, target, opened.crs)
    drawn = None
    if picture is not None:
        from slicemask.plot import save_figure
        from slicematch.localization.map_picture import draw_answers

        save_figure(draw_answers(opened, answers), picture)
        drawn = Path(picture)
    parts.remove()
    _loaded.cache_clear()
    return Located(answers, opened.crs, localizer.calibrated, target, drawn)


def partition(photos: Sequence[Photo], step_m: float) -> list[list[Photo]]:
    """Photographs in parts, those that share a tile together.

    Parameters
    ----------
    photos : sequence of Photo
        In any order, which the parts do not depend on but within a tile.
    step_m : float
        Of the lattice of tiles.
    """
    windows: dict[tuple[float, float], list[Photo]] = defaultdict(list)
    for photo in photos:
        nowhere = photo.error is not None or photo.lat is None or photo.lon is None
        key = (90.0, 0.0) if nowhere else lattice_point(photo.lat, photo.lon, step_m)  # type: ignore[arg-type]
        windows[key].append(photo)
    return split_groups([windows[key] for key in sorted(windows)])


def _check_targets(out: str | Path, picture: str | Path | None, overwrite: bool) -> Path:
    target = check_answers_target(out)
    if picture is not None:
        from slicemask.plot import check_figure_target

        check_figure_target(picture)
    if target.exists() and not overwrite:
        raise RunError(
            f"{target}: is there already; replace it with --overwrite, or name another file"
        )
    return target


def _check_complete(answers: Any, photos: Sequence[Photo]) -> None:
    """See that every photograph is there once."""
    if answers["row"].tolist() != list(range(len(photos))):
        raise RunError(
            "the parts do not hold each photograph once; were they altered? start afresh "
            "(--overwrite)"
        )
