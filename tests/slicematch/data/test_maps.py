"""Tiles of georeferenced maps: where their pixels lie, what pads them, and what is refused."""

import io
import math
import pickle
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
from PIL import Image
from slicematch.data.errors import MapError, PlaceError
from slicematch.errors import ConfigError
from slicematch.localization.geodesy import offset_position

pytest.importorskip("rasterio")
import rasterio
import rasterio.shutil
import rasterio.warp
from rasterio.enums import ColorInterp
from rasterio.transform import from_origin, rowcol
from slicematch.data.maps import AerialMap

DELFT = 51.9990, 4.3735
SIZE, METRES = 400, 0.5


def write(path, values, crs="EPSG:32631", metres=METRES, centre=DELFT, **options):
    """Write a raster [bands, rows, columns] whose middle lies at a place."""
    colours = options.pop("colours", None)
    palette = options.pop("palette", None)
    mask = options.pop("mask", None)
    (x,), (y,) = rasterio.warp.transform("EPSG:4326", crs, [centre[1]], [centre[0]])
    if rasterio.crs.CRS.from_user_input(crs).is_geographic:
        metres = metres / 111_320
    count, height, width = values.shape
    profile = {
        "driver": "GTiff", "dtype": values.dtype, "count": count, "height": height, "width": width,
        "crs": crs,
        "transform": from_origin(x - width / 2 * metres, y + height / 2 * metres, metres, metres),
    }  # fmt: skip
    with rasterio.open(path, "w", **profile | options) as file:
        file.write(values)
        if colours:
            file.colorinterp = colours
        if palette:
            file.write_colormap(1, palette)
        if mask is not None:
            file.write_mask(mask)
    return path


@pytest.fixture
def pixels(paint_texture):
    return np.moveaxis(paint_texture(np.random.default_rng(0), SIZE, 20), -1, 0).copy()


@pytest.fixture
def ortho(tmp_path, pixels):
    return write(tmp_path / "ortho.tif", pixels)


@pytest.mark.parametrize("crs", ["EPSG:32631", "EPSG:28992", "EPSG:3857", "EPSG:4326", "EPSG:2263"])
@pytest.mark.parametrize(("east_m", "north_m"), [(0.0, 0.0), (12.0, -20.0), (-25.0, 8.0)])
def test_a_place_lies_where_its_offset_from_the_centre_says(tmp_path, crs, east_m, north_m):
    # A blob painted at a place by the map's own coordinates is found in the tile where the
    # geodesic from the tile's centre leads: north up, east to the right, metres true.
    centre = (40.7128, -74.0060) if crs == "EPSG:2263" else DELFT
    metres = METRES / 0.3048 if crs == "EPSG:2263" else METRES
    place = offset_position(centre, east_m, north_m)
    path = write(tmp_path / "map.tif", np.zeros((3, SIZE, SIZE), np.uint8), crs, metres, centre)
    with rasterio.open(path, "r+") as file:
        (x,), (y,) = rasterio.warp.transform("EPSG:4326", crs, [place[1]], [place[0]])
        columns, rows = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
        row, column = rowcol(file.transform, x, y, op=float)
        blob = 255 * np.exp(-((columns - column) ** 2 + (rows - row) ** 2) / 18)
        file.write(np.repeat(blob[None], 3, axis=0).round().astype(np.uint8))
    tile = AerialMap.open(path).cut(*centre, 80.0, 320)
    assert tile.image.shape == (320, 320, 3)
    assert (tile.lat, tile.lon, tile.metres_per_pixel, tile.padded) == (*centre, 0.25, 0.0)
    weight = tile.image[..., 0].astype(float)
    rows, columns = np.mgrid[:320, :320] + 0.5
    found = [(weight * axis).sum() / weight.sum() * 0.25 for axis in (columns, rows)]
    np.testing.assert_allclose(found, [40 + east_m, 40 - north_m], atol=0.06)


def test_at_the_map_s_own_scale_a_tile_is_its_pixels(ortho, pixels):
    # UTM's north is turned by 1.2 degrees here and its metres are 0.04 % off: a small middle.
    tile = AerialMap.open(ortho).cut(*DELFT, 10.0, 20)
    own = pixels[:, SIZE // 2 - 10 : SIZE // 2 + 10, SIZE // 2 - 10 : SIZE // 2 + 10]
    difference = np.abs(tile.image.astype(int) - np.moveaxis(own, 0, -1))
    assert np.median(difference) <= 4


def test_shrinking_averages(tmp_path):
    # A chessboard of single pixels is grey from afar, not black or white.
    board = np.indices((SIZE, SIZE)).sum(axis=0) % 2 * np.uint8(255)
    path = write(tmp_path / "board.tif", np.repeat(board[None].astype(np.uint8), 3, axis=0))
    tile = AerialMap.open(path).cut(*DELFT, 120.0, 30)
    assert np.abs(tile.image.astype(int) - 127).max() < 12


def test_a_tile_over_the_edge_is_padded_and_says_so(ortho):
    opened = AerialMap.open(ortho)
    edge = offset_position(DELFT, 100.0, 0.0)
    tile = opened.cut(*edge, 40.0, 80, max_padded=0.6)
    assert tile.padded == pytest.approx(0.5, abs=0.03)
    # Neutral: what is missing is the mean of what is there.
    missing = tile.image[20:60, 60:].reshape(-1, 3)
    assert (missing == missing[0]).all()
    np.testing.assert_allclose(missing[0], tile.image[:, :40].mean(axis=(0, 1)), atol=3)
    with pytest.raises(PlaceError, match=r"has no data in 9\d% .* at most 50%"):
        opened.cut(*offset_position(DELFT, 117.0, 0.0), 40.0, 80)


@pytest.mark.parametrize("how", ["nodata", "alpha", "mask"])
def test_what_holds_no_data_is_padded(tmp_path, pixels, how):
    pixels = np.maximum(pixels, 1)
    pixels[:, :, : SIZE // 2] = 0
    there = (pixels[0] > 0) * np.uint8(255)
    options = {"nodata": 0} if how == "nodata" else {}
    if how == "alpha":
        kinds = [ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha]
        path = write(tmp_path / "a.tif", np.concatenate([pixels, there[None]]), colours=kinds)
    else:
        mask = there if how == "mask" else None
        path = write(tmp_path / "a.tif", pixels, mask=mask, **options)
    opened = AerialMap.open(path)
    tile = opened.cut(*offset_position(DELFT, 5.0, 0.0), 40.0, 80)
    assert tile.padded == pytest.approx(0.375, abs=0.03)
    assert tile.image[40, 5].min() > 30
    with pytest.raises(PlaceError, match="a map without the hole"):
        opened.cut(*offset_position(DELFT, -50.0, 0.0), 40.0, 80)


def test_one_dark_channel_is_no_lack_of_data(tmp_path):
    red = np.zeros((3, SIZE, SIZE), np.uint8)
    red[0] = 200
    tile = AerialMap.open(write(tmp_path / "a.tif", red, nodata=0)).cut(*DELFT, 40.0, 80)
    assert tile.padded == 0.0
    assert (tile.image == [200, 0, 0]).all()


def test_bands_are_found_by_what_they_show(tmp_path, pixels):
    kinds = [ColorInterp.undefined, ColorInterp.blue, ColorInterp.green, ColorInterp.red]
    infrared = np.full((1, SIZE, SIZE), 7, np.uint8)
    values = np.concatenate([infrared, pixels[::-1]])
    path = write(tmp_path / "a.tif", values, colours=kinds, photometric="minisblack")
    tile = AerialMap.open(path).cut(*DELFT, 40.0, 80)
    plain = AerialMap.open(write(tmp_path / "b.tif", pixels)).cut(*DELFT, 40.0, 80)
    assert (tile.image == plain.image).all()


def test_grey_and_palettes_become_colours(tmp_path, pixels):
    grey = AerialMap.open(write(tmp_path / "grey.tif", pixels[:1])).cut(*DELFT, 40.0, 80)
    assert (grey.image == grey.image[..., :1]).all()
    assert grey.image.std() > 10
    palette = {0: (10, 20, 30, 255), 1: (200, 100, 50, 255)}
    path = write(tmp_path / "p.tif", (pixels[:1] > 128).astype(np.uint8), palette=palette)
    colours = np.unique(AerialMap.open(path).cut(*DELFT, 40.0, 80).image.reshape(-1, 3), axis=0)
    assert colours.tolist() == [[10, 20, 30], [200, 100, 50]]


def test_16_bits_are_stretched_alike_all_over_the_map(tmp_path, pixels, caplog):
    # The left half is dark, the right one bright: each alone would be stretched to full range.
    deep = pixels.astype(np.uint16) * 4
    deep[:, :, : SIZE // 2] //= 8
    opened = AerialMap.open(write(tmp_path / "deep.tif", deep))
    assert "16 bits" in caplog.text
    left, right = (
        opened.cut(*offset_position(DELFT, east, 0.0), 40.0, 80).image for east in (-50, 50)
    )
    assert right.mean() / left.mean() == pytest.approx(8, rel=0.3)
    assert right.max() > 200


@pytest.mark.parametrize("driver", ["COG", "JP2OpenJPEG", "VRT", "PNG"])
def test_any_raster_that_gdal_reads_will_do(tmp_path, ortho, driver):
    suffix = {"COG": "tif", "JP2OpenJPEG": "jp2", "VRT": "vrt", "PNG": "png"}[driver]
    path = tmp_path / f"copy.{suffix}"
    lossless = {"QUALITY": "100", "REVERSIBLE": "YES"} if driver == "JP2OpenJPEG" else {}
    rasterio.shutil.copy(ortho, path, driver=driver, **lossless)
    expected = AerialMap.open(ortho).cut(*DELFT, 40.0, 80)
    found = AerialMap.open(path).cut(*DELFT, 40.0, 80)
    assert np.abs(found.image.astype(int) - expected.image).max() <= 2


def test_a_map_goes_to_other_processes(ortho):
    opened = AerialMap.open(ortho)
    first = opened.cut(*DELFT, 40.0, 80)
    again = pickle.loads(pickle.dumps(opened)).cut(*DELFT, 40.0, 80)
    assert (again.image == first.image).all()


def test_places_go_to_the_map_s_coordinates_and_back(ortho):
    opened = AerialMap.open(ortho)
    x, y = opened.to_map([DELFT[0]], [DELFT[1]])
    with rasterio.open(ortho) as file:
        row, column = rowcol(file.transform, x[0], y[0], op=float)
    assert (row, column) == pytest.approx((SIZE / 2, SIZE / 2), abs=1e-6)
    lat, lon = opened.to_globe(x, y)
    assert (lat[0], lon[0]) == pytest.approx(DELFT, abs=1e-9)
    south, west, north, east = opened.bounds()
    assert south < DELFT[0] < north
    assert west < DELFT[1] < east
    assert opened.crs == "EPSG:32631"
    assert opened.metres_per_pixel(*DELFT) == pytest.approx(METRES, rel=1e-3)


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ((48.85, 2.35), "does not show 48.850000,2.350000; it reaches from 51.99"),
        (DELFT[::-1], "if the two are swapped, give 51.999000,4.373500"),
        ((95.0, 4.0), "the place is 95,4; it must be a latitude"),
        ((float("nan"), 4.0), "the place is nan,4"),
    ],
)
def test_places_that_the_map_does_not_show(ortho, place, said):
    with pytest.raises(PlaceError) as error:
        AerialMap.open(ortho).cut(*place, 40.0, 80)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("side_m", "count"), [(0.0, 80), (float("nan"), 80), (40.0, 0)])
def test_tiles_that_are_none(ortho, side_m, count):
    with pytest.raises(ConfigError, match="the tile"):
        AerialMap.open(ortho).cut(*DELFT, side_m, count)


LOCAL = 'LOCAL_CS["site grid",UNIT["unknown",1]]'


def test_maps_that_lie_nowhere(tmp_path, ortho, pixels):
    bare = tmp_path / "bare.tif"
    with rasterio.open(ortho) as file:
        profile = file.profile
    with rasterio.open(bare, "w", **{**profile, "crs": None}) as file:
        file.write(pixels)
    with pytest.raises(MapError, match=r"no coordinate system.*--map-crs"):
        AerialMap.open(bare)
    told = AerialMap.open(bare, "EPSG:32631").cut(*DELFT, 40.0, 80)
    assert (told.image == AerialMap.open(ortho).cut(*DELFT, 40.0, 80).image).all()
    with pytest.raises(MapError, match="'EPSG:nonsense', which is unknown"):
        AerialMap.open(bare, "EPSG:nonsense")
    with rasterio.open(tmp_path / "site.tif", "w", **{**profile, "crs": LOCAL}) as file:
        file.write(pixels)
    with pytest.raises(MapError, match=r"a coordinate system of its own.*without units"):
        AerialMap.open(tmp_path / "site.tif")
    Image.fromarray(np.moveaxis(pixels, 0, -1)).save(tmp_path / "photo.png")
    with pytest.raises(MapError, match="does not say where its pixels lie"):
        AerialMap.open(tmp_path / "photo.png", "EPSG:32631")


def test_files_that_are_no_maps(tmp_path, pixels):
    with pytest.raises(MapError, match="there is no such file"):
        AerialMap.open(tmp_path / "none.tif")
    (tmp_path / "text.tif").write_text("no raster")
    with pytest.raises(MapError, match=r"cannot be read as a map \(.*\); name a raster"):
        AerialMap.open(tmp_path / "text.tif")
    path = write(tmp_path / "heights.tif", pixels[:1].astype(np.float32))
    with pytest.raises(MapError, match="pixels of float32; expected 8 or 16 bits"):
        AerialMap.open(path)


def test_a_map_that_breaks_off_says_so_when_it_is_read(tmp_path, pixels):
    path = write(tmp_path / "cut.tif", pixels, compress="deflate")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])
    with pytest.raises(MapError, match="cannot be read as a map"):
        AerialMap.open(path).cut(*DELFT, 150.0, 80)


SERVICE = """<GDAL_WMS>
<Service name="TMS"><ServerUrl>http://127.0.0.1:{port}/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service>
<DataWindow>
<UpperLeftX>-20037508.34</UpperLeftX><UpperLeftY>20037508.34</UpperLeftY>
<LowerRightX>20037508.34</LowerRightX><LowerRightY>-20037508.34</LowerRightY>
<TileLevel>19</TileLevel><TileCountX>1</TileCountX><TileCountY>1</TileCountY>
<YOrigin>top</YOrigin>
</DataWindow>
<Projection>EPSG:3857</Projection>
<BlockSizeX>256</BlockSizeX><BlockSizeY>256</BlockSizeY><BandsCount>3</BandsCount>
</GDAL_WMS>"""


class Tiles(BaseHTTPRequestHandler):
    """Serves XYZ tiles of a black world with one white blob, 8 m to the east of DELFT."""

    def do_GET(self):
        z, x, y = (int(part) for part in self.path.removesuffix(".png").split("/")[1:])
        lat, lon = offset_position(DELFT, 8.0, 0.0)
        side = 256 * 2**z
        column = (lon + 180) / 360 * side
        row = (0.5 - math.asinh(math.tan(math.radians(lat))) / (2 * math.pi)) * side
        rows, columns = np.mgrid[:256, :256] + 0.5
        away = (columns + 256 * x - column) ** 2 + (rows + 256 * y - row) ** 2
        blob = (255 * np.exp(-away / 72)).round().astype(np.uint8)
        content = io.BytesIO()
        Image.fromarray(np.repeat(blob[..., None], 3, axis=2)).save(content, format="PNG")
        self.send_response(200)
        self.end_headers()
        self.wfile.write(content.getvalue())

    def log_message(self, *_):
        pass


def test_tiles_of_a_web_service_are_a_map(tmp_path):
    server = ThreadingHTTPServer(("127.0.0.1", 0), Tiles)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        service = tmp_path / "service.xml"
        service.write_text(SERVICE.format(port=server.server_port))
        tile = AerialMap.open(service).cut(*DELFT, 40.0, 160)
    finally:
        server.shutdown()
        server.server_close()
    weight = tile.image[..., 0].astype(float)
    rows, columns = np.mgrid[:160, :160] + 0.5
    found = [(weight * axis).sum() / weight.sum() * 0.25 for axis in (columns, rows)]
    np.testing.assert_allclose(found, [28.0, 20.0], atol=0.1)
    with pytest.raises(MapError, match="cannot be read as a map"):
        AerialMap.open(service).cut(*DELFT, 40.0, 160)
