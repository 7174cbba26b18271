"""Positions that photographs hold in their EXIF data or their names."""

import pytest
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational
from slicematch.data.errors import SampleError
from slicematch.data.positions import Fix, read_fix


@pytest.fixture
def photo(tmp_path):
    """The function that saves a photograph with these GPS tags, by their names."""

    def save(name="photo.jpg", **tags):
        exif = Image.Exif()
        gps = exif.get_ifd(ExifTags.IFD.GPSInfo)
        gps.update({ExifTags.GPS[tag]: value for tag, value in tags.items()})
        path = tmp_path / name
        Image.new("RGB", (8, 4)).save(path, exif=exif)
        return path

    return save


PLACE = {
    "GPSLatitudeRef": "S", "GPSLatitude": (33.0, 51.0, 30.6),
    "GPSLongitudeRef": "E", "GPSLongitude": (151.0, 12.0, 36.0),
}  # fmt: skip


def test_gps_and_compass_are_read(photo):
    path = photo(**PLACE, GPSImgDirection=IFDRational(1255, 10), GPSHPositioningError=6.5)
    fix = read_fix(path)
    assert (fix.lat, fix.lon) == pytest.approx((-33.8585, 151.21))
    assert (fix.heading_deg, fix.accuracy_m) == (125.5, 6.5)
    assert read_fix(photo(**PLACE)).heading_deg is None


def test_a_name_that_holds_a_place_will_do(photo):
    name = "pano_ab12,41.876540,-87.632100,.jpg"
    assert read_fix(photo(name)) == Fix(41.87654, -87.6321)
    assert read_fix(photo(name, **PLACE)).lat == pytest.approx(-33.8585)
    assert read_fix(photo(name, GPSImgDirection=90.0)).heading_deg == 90.0


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {"GPSLatitude": (0.0, 0.0, 0.0), "GPSLongitude": (0.0, 0.0, 0.0)},
        {"GPSLatitude": (IFDRational(0, 0), 0.0, 0.0), "GPSLongitude": (1.0, 0.0, 0.0)},
        {"GPSLatitude": (1.0, 0.0, 0.0)},
    ],
)
@pytest.mark.parametrize("name", ["photo.jpg", "IMG_2024.1203,10.55.jpg", "20240112_101500.jpg"])
def test_photographs_that_say_nothing_of_their_place(photo, tags, name):
    with pytest.raises(SampleError, match="says nothing of where it was taken"):
        read_fix(photo(name, **tags))


def test_files_that_are_no_photographs(tmp_path):
    with pytest.raises(SampleError, match="there is no such file"):
        read_fix(tmp_path / "none.jpg")
    (tmp_path / "a.jpg").write_text("no image")
    with pytest.raises(SampleError, match="cannot be read as an image"):
        read_fix(tmp_path / "a.jpg")
