"""Predicting on a map: one photograph, a map of its surroundings, one answer."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slicemask.images import Picture
from slicematch.data.maps import AerialMap
from slicematch.errors import ConfigError
from slicematch.localization.answers import ANSWER_COLUMNS, check_answers_target, write_answers
from slicematch.localization.on_map import MapAnswer, PlaceOnGlobe, place_prior, tile_side
from slicematch.localization.photos import Photo, Priors, photo_of
from slicematch.localization.predict import Prediction, predict
from slicematch.runs.folder import RunFolder
from slicematch.runs.shipped import find_run


@dataclass(frozen=True)
class MapPrediction:
    """A prediction on a map.

    Attributes
    ----------
    prediction : Prediction
        In the tile that was cut.
    answer : MapAnswer
        The same on the map.
    answers : Path or None
        The file of answers that was written.
    """

    prediction: Prediction
    answer: MapAnswer
    answers: Path | None = None

    def __str__(self) -> str:
        return self.report()

    def as_dict(self) -> dict[str, Any]:
        """The prediction as plain values, for JSON; see `Prediction.as_dict`."""
        tile = self.answer.tile
        content = self.prediction.as_dict()
        content |= {"x": self.answer.x, "y": self.answer.y, "crs": self.answer.crs}
        content |= {"tile_lat": tile.lat, "tile_lon": tile.lon, "tile_padded": tile.padded}
        return content if self.answers is None else content | {"answers": str(self.answers)}

    def report(self) -> str:
        """The prediction as a few lines of text."""
        answer = self.answer
        text = f"{self.prediction.report()}\non the map at {answer.x:.2f}, {answer.y:.2f} "
        text += f"({answer.crs})"
        if answer.tile.padded:
            text += f"\n{answer.tile.padded:.1%} of the tile has no data in the map"
        return text if self.answers is None else f"{text}\n{self.answers}"


def predict_on_map(
    run: str | Path,
    ground: Picture,
    aerial_map: str | Path,
    *,
    priors: Priors | None = None,
    map_crs: str | None = None,
    side_m: float | None = None,
    answers: str | Path | None = None,
    **options: Any,
) -> MapPrediction:
    """Find where a photograph was taken on a map, with a trained run.

    Parameters
    ----------
    run : path
        A run folder.
    ground : path, PIL image or uint8 [height, width, 3]
        As `predict` takes it.
    aerial_map : path
        A georeferenced raster (`slicematch.data.maps.AerialMap.open`).
    priors : Priors, optional
        What is known of the place and the heading; what the photograph says of itself by default.
    map_crs : str, optional
        The map's coordinate system, where its file does not say.
    side_m : float, optional
        Side of the tile on the ground; that of the run's own by default.
    answers : path, optional
        A file of answers to write, as `slicematch.localization.locate.locate` does.
    **options
        Further arguments of `predict`, but for those that the map gives.

    Returns
    -------
    MapPrediction

    Raises
    ------
    RunError, ConfigError, BankError, ImageError, PlotError, OutputError
        As `predict` raises them.
    MapError, SampleError
        If the map is unusable or does not show the place, or the photograph says of none.
    """
    priors = priors or Priors()
    if answers is not None:
        check_answers_target(answers)
    config = RunFolder(find_run(run)).load_config()
    side_m = tile_side(config, side_m)
    opened = AerialMap.open(aerial_map, map_crs)
    photo = _photo(ground, priors)
    lat, lon = photo.place()
    place = PlaceOnGlobe(lat, lon, priors.distance_m(photo, side_m))
    tile = opened.cut(lat, lon, side_m, config.aerial_size)
    prediction = predict(
        run,
        ground,
        tile.image,
        metres_per_pixel=tile.metres_per_pixel,
        centre=(lat, lon),
        heading_prior=priors.heading(photo),
        place_prior=place_prior(place, tile),
        **options,
    )
    answer = MapAnswer.of(prediction.estimate, tile, opened)
    written = None
    if answers is not None:
        import pandas

        row = photo.known(priors, place.within_m) | answer.as_row()
        written = Path(answers)
        write_answers(pandas.DataFrame([row], columns=list(ANSWER_COLUMNS)), written, opened.crs)
    return MapPrediction(prediction, answer, written)


def _photo(ground: Picture, priors: Priors) -> Photo:
    """The photograph with what it says of itself."""
    if isinstance(ground, str | Path):
        return photo_of(0, {"ground": str(ground)}, priors.near)
    if priors.near is None:
        raise ConfigError("an image in memory says nothing of its place; say where it was taken")
    return Photo(0, "the image", "", *priors.near)
