"""EXIF data as phones write them: a position, a compass, and a focal length."""

from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from slicemask.errors import SynthError

_SECONDS = 100_000  # parts of a second of arc that are kept: a third of a millimetre


def photograph_exif(
    lat: float, lon: float, heading_deg: float, accuracy_m: float, focal_mm: float | None = None
) -> bytes:
    """The EXIF data of a photograph.

    Parameters
    ----------
    lat, lon : float
        Degrees.
    heading_deg : float
        Of the image's centre, clockwise from true north.
    accuracy_m : float
        Of the position.
    focal_mm : float, optional
        Focal length for 35-mm film; none of a panorama.
    """
    exif = Image.Exif()
    exif[ExifTags.Base.Make] = "slicemask"
    exif[ExifTags.Base.Model] = "generated city"
    if focal_mm is not None:
        exif[ExifTags.IFD.Exif] = {ExifTags.Base.FocalLengthIn35mmFilm: round(focal_mm)}
    tags = ExifTags.GPS
    exif[ExifTags.IFD.GPSInfo] = {
        tags.GPSVersionID: b"\x02\x03\x00\x00",
        tags.GPSLatitudeRef: "N" if lat >= 0 else "S",
        tags.GPSLatitude: _arc(lat),
        tags.GPSLongitudeRef: "E" if lon >= 0 else "W",
        tags.GPSLongitude: _arc(lon),
        tags.GPSImgDirectionRef: "T",
        tags.GPSImgDirection: IFDRational(round(heading_deg * 100), 100),
        tags.GPSHPositioningError: IFDRational(round(accuracy_m * 100), 100),
    }
    return exif.tobytes()


def _arc(degrees: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    """Degrees, minutes and seconds."""
    if abs(degrees) > 180.0:
        raise SynthError(f"an angle is {degrees:g} degrees; it must be within 180")
    parts = round(abs(degrees) * 3600 * _SECONDS)
    minutes, seconds = divmod(parts, 60 * _SECONDS)
    return (
        IFDRational(minutes // 60, 1),
        IFDRational(minutes % 60, 1),
        IFDRational(seconds, _SECONDS),
    )
