"""Answers of many photographs as files: GeoJSON, GeoPackage, CSV or Parquet, by the suffix."""

import json
import shutil
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from slicemask.errors import OutputError
from slicemask.files import atomic_write, check_target
from slicematch.localization.geodesy import ellipse_geometry
from slicematch.localization.probabilities import CONFIDENCE

ANSWER_SUFFIXES = (".gpkg", ".geojson", ".json", ".csv", ".parquet")
# One row a photograph. Those without a pose have an error in place of it.
ANSWER_COLUMNS = {
    "row": "int64",
    "id": "string",
    "ground": "string",
    "lat": "float64",
    "lon": "float64",
    "x": "float64",
    "y": "float64",
    "heading_deg": "float64",
    "score": "float64",
    "probability": "float64",
    "std_east_m": "float64",
    "std_north_m": "float64",
    "std_heading_deg": "float64",
    "ellipse_major_m": "float64",
    "ellipse_minor_m": "float64",
    "ellipse_azimuth_deg": "float64",
    "prior_lat": "float64",
    "prior_lon": "float64",
    "prior_within_m": "float64",
    "prior_heading_deg": "float64",
    "prior_heading_half_width_deg": "float64",
    "tile_lat": "float64",
    "tile_lon": "float64",
    "tile_padded": "float64",
    "error": "string",
}


def check_answers_target(path: str | Path) -> Path:
    """Return the path of a file of answers to be written, or raise OutputError if it is invalid."""
    return check_target(path, ANSWER_SUFFIXES, OutputError)


def write_answers(answers: Any, path: str | Path, crs: str) -> None:
    """Write answers, whole or not at all; a file already there is replaced.

    Parameters
    ----------
    answers : pandas.DataFrame
        Rows of `ANSWER_COLUMNS`.
    path : path
        Where they go. GeoJSON has a point and the ellipse of each answer in latitude and longitude;
        GeoPackage two layers, answers and ellipses, in the map's coordinate system; Parquet the
        points in that (GeoParquet); CSV the rows alone.
    crs : str
        The map's coordinate system, of the columns x and y.

    Raises
    ------
    OutputError
        If the suffix is another, or the file cannot be written.
    """
    path = check_answers_target(path)
    # Some drivers insist on their suffix, which a temporary name has not; some write two files.
    with (
        atomic_write(path, OutputError) as partial,
        tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder,
    ):
        file = Path(folder, path.name)
        if path.suffix.lower() == ".csv":
            answers.to_csv(file, index=False, lineterminator="\n")
        elif path.suffix.lower() in (".geojson", ".json"):
            with file.open("w", encoding="utf-8", newline="") as text:
                text.writelines(_geojson(answers))
        elif path.suffix.lower() == ".parquet":
            _points(answers, crs).to_parquet(file, index=False)
        else:
            with warnings.catch_warnings():  # of GDAL's, on layers that begin with no point
                warnings.filterwarnings("ignore", module="pyogrio")
                _points(answers, crs).to_file(file, layer="answers", driver="GPKG")
                _ellipses(answers, crs).to_file(file, layer="ellipses", driver="GPKG")
        shutil.move(file, partial)


def _points(answers: Any, crs: str) -> Any:
    import geopandas

    points = geopandas.points_from_xy(answers["x"], answers["y"], crs=crs)
    points[answers["x"].isna().to_numpy()] = None
    return geopandas.GeoDataFrame(answers, geometry=points)


def _ellipses(answers: Any, crs: str) -> Any:
    import geopandas
    import shapely

    drawn = answers[answers["ellipse_minor_m"] > 0]
    shapes = [shapely.geometry.shape(_ellipse(row)) for row in _records(drawn)]
    columns = drawn[["id", "ellipse_major_m", "ellipse_minor_m", "ellipse_azimuth_deg"]]
    frame = geopandas.GeoDataFrame(
        columns.assign(confidence=CONFIDENCE), geometry=shapes, crs="EPSG:4326"
    )
    return frame.to_crs(crs)


def _geojson(answers: Any) -> Iterator[str]:
    """A FeatureCollection, feature by feature."""
    yield '{"type": "FeatureCollection", "features": ['
    between = "\n"
    for row in _records(answers):
        point = None  # a feature without a place, which RFC 7946 allows
        if row["error"] is None:
            point = {"type": "Point", "coordinates": [row["lon"], row["lat"]]}
        kind = "error" if point is None else "estimate"
        yield between + _feature(point, kind=kind, **row)
        between = ",\n"
        if row["ellipse_minor_m"]:
            axes = {name: value for name, value in row.items() if name.startswith("ellipse")}
            yield between + _feature(
                _ellipse(row), kind="uncertainty", id=row["id"], confidence=CONFIDENCE, **axes
            )
    yield "\n]}\n"


def _feature(geometry: Any, **properties: Any) -> str:
    feature = {"type": "Feature", "geometry": geometry, "properties": properties}
    return json.dumps(feature, allow_nan=False)


def _ellipse(row: dict[str, Any]) -> dict[str, Any]:
    return ellipse_geometry(
        [row["lon"], row["lat"]],
        row["ellipse_major_m"],
        row["ellipse_minor_m"],
        row["ellipse_azimuth_deg"],
    )


def _records(answers: Any) -> Iterator[dict[str, Any]]:
    """Rows as plain values, None where there is none."""
    columns = list(answers.columns)
    for row in answers.itertuples(index=False, name=None):
        yield {
            name: None if value is None or value != value else value
            for name, value in zip(columns, row, strict=True)
        }
