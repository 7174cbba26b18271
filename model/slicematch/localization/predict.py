"""Predicting: one ground image, one aerial tile, one answer, and the files that show it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slicemask.geometry.poses import check_poses
from slicemask.images import Picture, read_aerial
from slicematch.digits import digits
from slicematch.errors import ConfigError
from slicematch.localization.estimate import Estimate
from slicematch.localization.localizer import HeadingPrior, Localizer, PlacePrior
from slicematch.localization.refinement import DEFAULT, Refine
from slicematch.localization.tiles import check_resolution
from slicematch.precision import Precision
from slicematch.runs.folder import Checkpoint, RunFolder
from slicematch.runs.shipped import find_run


@dataclass(frozen=True)
class Prediction:
    """An estimate, and what it was asked for with.

    Attributes
    ----------
    estimate : Estimate
        The answer.
    refine : {"none", "mean", "fine", "continuous"}
        How it was refined.
    calibrated : bool
        Whether its probabilities come from a temperature that was fitted to such scores.
    metres_per_pixel : float or None
        Of the tile as it was handed in.
    centre : (latitude, longitude) or None
        Of the tile, degrees.
    geojson, picture : Path or None
        The files that were written.
    """

    estimate: Estimate
    refine: Refine
    calibrated: bool
    metres_per_pixel: float | None = None
    centre: tuple[float, float] | None = None
    geojson: Path | None = None
    picture: Path | None = None

    def __str__(self) -> str:
        return self.report()

    def as_dict(self) -> dict[str, Any]:
        """The prediction as plain values, for JSON; see `Estimate.as_dict`."""
        content = self.estimate.as_dict(self.metres_per_pixel, self.centre)
        content |= {"refine": self.refine, "calibrated": self.calibrated}
        files = {"geojson": self.geojson, "picture": self.picture}
        return content | {name: str(path) for name, path in files.items() if path is not None}

    def report(self) -> str:
        """The prediction as a few lines of text: the pose, how sure it is, and the files."""
        text = self.estimate.place_text(self.metres_per_pixel)
        if self.centre is not None:
            content = self.estimate.as_dict(self.metres_per_pixel, self.centre)
            text += "; latitude {latitude:.7f}, longitude {longitude:.7f}".format(**content)
        files = [str(path) for path in (self.geojson, self.picture) if path is not None]
        return "\n".join([text, self._certainty(), *files])

    def _certainty(self) -> str:
        """One line on how sure the estimate is."""
        east, north, heading = (
            value**0.5
            for value in self.estimate.covariance(self.metres_per_pixel).diagonal().tolist()
        )
        unit = "of the tile" if self.metres_per_pixel is None else "m"
        best, *others = (f"{mode.probability:.1%}" for mode in self.estimate.modes)
        return (
            f"probability {best}"
            + ("" if self.calibrated else " (uncalibrated)")
            + f", standard deviations {digits(east)} {unit} east, {digits(north)} {unit} north, "
            f"{heading:.1f} degrees" + (f"; other modes {', '.join(others)}" if others else "")
        )


def predict(
    run: str | Path,
    ground: Picture,
    aerial: Picture,
    *,
    metres_per_pixel: float | None = None,
    heading_prior: HeadingPrior | None = None,
    place_prior: PlacePrior | None = None,
    truth: tuple[float, float, float] | None = None,
    centre: tuple[float, float] | None = None,
    geojson: str | Path | None = None,
    out: str | Path | None = None,
    grid: str | None = None,
    bank: str | Path | None = None,
    checkpoint: Checkpoint = "best",
    device: str = "auto",
    cache: str | Path | None = None,
    refine: Refine = DEFAULT,
    precision: Precision = "32-true",
    alone: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Prediction:
    """Find where a ground image was taken, with a trained run; on request write files of it.

    For many images load a `Localizer` once instead. What is wrong with the request is found before
    anything is written.

    Parameters
    ----------
    run : path
        A run folder.
    ground : path, PIL image or uint8 [height, width, 3]
        A panorama (VIGOR runs) or a camera image (KITTI runs). The heading found is that of its
        centre column, of a camera image that of its optical axis.
    aerial : path, PIL image or uint8 [A, A, 3]
        A square tile, north up.
    metres_per_pixel : float, optional
        Of the tile as it is handed in.
    heading_prior : (centre, half_width), optional
        Only headings within half_width degrees of the centre; the run's own by default.
    place_prior : (u, v, radius), optional
        Only places within the radius of (u, v), in the aerial frame; the run's own by default.
    truth : (u, v, heading_deg), optional
        The true pose, drawn in the picture.
    centre : (latitude, longitude), optional
        Of the tile, degrees; with a resolution it gives the answer's latitude and longitude.
    geojson : path, optional
        A GeoJSON file to write; needs a centre and a resolution.
    out : path, optional
        A picture to write: PNG, SVG or PDF, by its suffix.
    grid : str, optional
        Candidates such as "21x21x64"; the run's test grid by default.
    bank : path, optional
        A bank of candidates instead.
    checkpoint : {"best", "last"}
        Which weights.
    device : str
        "auto", "cpu", "cuda" or "cuda:N".
    cache : path, optional
        The folder of banks.
    refine : {"none", "mean", "fine", "continuous"}
        How the estimate is refined.
    precision : {"32-true", "16-mixed", "bf16-mixed"}
        In which the encoders compute.
    alone : bool
        Of an ensemble, ask the first network alone.
    progress : callable, optional
        Called with what is being done, such as "loading the run".

    Returns
    -------
    prediction : Prediction

    Raises
    ------
    RunError, ConfigError, BankError
        If the run cannot be loaded, or the request does not fit it.
    ImageError
        If an image is unreadable or has the wrong proportions.
    PoseError
        If the truth is no pose on the tile.
    PlotError, OutputError
        If a file cannot be written where it should go.
    """
    _check_request(metres_per_pixel, truth, centre, geojson, out)
    say = progress or (lambda _: None)
    RunFolder(find_run(run)).load_config()  # the likeliest slip of all, before large images
    say("reading the tile")
    tile = read_aerial(aerial)
    say("loading the run")
    localizer = Localizer.load(
        run,
        bank,
        grid=grid,
        checkpoint=checkpoint,
        device=device,
        cache=cache,
        refine=refine,
        precision=precision,
        alone=alone,
    )
    say("reading the ground image")
    view = localizer.read_ground(ground)
    say("scoring poses")
    estimate = localizer.localize(
        view, tile, heading_prior, place_prior, metres_per_pixel=metres_per_pixel
    )
    if out is not None:
        say("drawing")
        from slicemask.plot import save_figure
        from slicematch.evaluation.drawing import draw_estimate

        save_figure(
            draw_estimate(
                tile,
                estimate.heat_map,
                estimate.grid,
                estimate.pose,
                localizer.frustum,
                truth=truth,
                ground=localizer.shown(view),
                title=_title(ground, aerial),
                estimate=estimate,
                tile_metres=None if metres_per_pixel is None else tile.width * metres_per_pixel,
            ),
            out,
        )
    if geojson is not None and metres_per_pixel is not None and centre is not None:
        from slicematch.localization.outputs import feature_collection, save_geojson

        save_geojson(feature_collection(estimate, metres_per_pixel, centre), geojson)
    return Prediction(
        estimate=estimate,
        refine=localizer.refine,
        calibrated=localizer.calibrated,
        metres_per_pixel=metres_per_pixel,
        centre=centre,
        geojson=None if geojson is None else Path(geojson),
        picture=None if out is None else Path(out),
    )


def _check_request(
    metres_per_pixel: float | None,
    truth: tuple[float, float, float] | None,
    centre: tuple[float, float] | None,
    geojson: str | Path | None,
    out: str | Path | None,
) -> None:
    """Find what is wrong with a request before anything is loaded."""
    if metres_per_pixel is not None:
        check_resolution(metres_per_pixel)
    elif centre is not None:
        raise ConfigError(
            "the tile's centre alone gives no latitude and longitude; give its metres per pixel "
            "(--metres-per-pixel) too"
        )
    if truth is not None:
        if out is None:
            raise ConfigError("the truth is drawn in the picture; name one (--out)")
        check_poses([truth], iter(["the truth"]))
    # Here, since pyproj and matplotlib take long to import, and few requests need them.
    if centre is not None:
        from slicematch.localization.geodesy import check_centre

        check_centre(centre)
    if geojson is not None:
        if centre is None:
            raise ConfigError(
                "GeoJSON needs the tile's centre (--centre) and metres per pixel "
                "(--metres-per-pixel)"
            )
        from slicematch.localization.outputs import check_geojson_target

        check_geojson_target(geojson)
    if out is not None:
        from slicemask.plot import check_figure_target

        check_figure_target(out)
    if out is not None and geojson is not None and Path(out) == Path(geojson):
        raise ConfigError(f"{out}: is named for the picture and for the GeoJSON; name two files")


def _title(ground: Picture, aerial: Picture) -> str:
    names = [Path(one).name for one in (ground, aerial) if isinstance(one, str | Path)]
    return " in ".join(names) if len(names) == 2 else "Estimate"
