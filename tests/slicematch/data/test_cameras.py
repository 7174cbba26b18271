"""Cameras of one's own: what files say of them, what they show, and undoing distortion."""

import math

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import binary_erosion
from slicematch.data.cameras import Camera, load_cameras
from slicematch.data.errors import DatasetError

from slicemask import Frustum
from slicemask.errors import ImageError

SIZE = {"width": 160, "height": 120}


def write(tmp_path, text):
    path = tmp_path / "cameras.yaml"
    path.write_text(text)
    return path


def test_a_file_of_cameras(tmp_path):
    path = write(
        tmp_path,
        "front: {projection: pinhole, width: 1242, height: 375, fx: 721.5, cx: 609.6, cy: 172.9}\n"
        "phone: {projection: pinhole, width: 400, height: 300, hfov_deg: 90}\n"
        "colmap: {projection: pinhole, width: 400, height: 300, f: 300, cx: 190, cy: 150, k: 0.1}\n"
        "roof: {projection: equirectangular}\n"
        "half: {projection: equirectangular, hfov_deg: 180}\n"
        "7: {projection: pinhole, model: OPENCV_FISHEYE, width: 40, height: 30, fx: 30, k4: 1}\n",
    )
    cameras = load_cameras(path)
    assert list(cameras) == ["front", "phone", "colmap", "roof", "half", "7"]
    assert cameras["front"].frustum(8, (0.1,)) == Frustum.from_intrinsics(
        721.5, 609.6, 1242, 8, (0.1,)
    )
    assert cameras["phone"].frustum(4) == Frustum(90, 4, "pinhole")
    assert cameras["phone"].fx == pytest.approx(200)
    assert (cameras["colmap"].fx, cameras["colmap"].fy, cameras["colmap"].k1) == (300, 300, 0.1)
    assert cameras["roof"].frustum() == Frustum()
    assert cameras["half"].frustum(4) == Frustum(180, 4)
    assert [cameras[name].distorted for name in cameras] == [False, False, True, False, False, True]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no cameras; expected lines such as"),
        ("a: 5", "camera a: is 5; expected parameters"),
        ("a: {fx: 5}", "camera a: projection is missing; it must be equirectangular or pinhole"),
        ("a: {projection: fisheye}", "projection is 'fisheye'; it must be one of"),
        ("a: {projection: pinhole, fx: 5}", "width is None; it must be given, in pixels"),
        ("a: {projection: pinhole, width: 4, height: 3}", "fx is None; it must be given, in pix"),
        ("a: {projection: pinhole, width: 4, height: 3, fx: -1}", "fx is -1; it must be pixels"),
        ("a: {projection: pinhole, width: 4, height: 3, fx: wide}", "fx is 'wide'; it must be"),
        ("a: {projection: pinhole, width: 4.5, height: 3, fx: 1}", "width is 4.5; it must be pix"),
        ("a: {projection: pinhole, width: 4, height: 3, fx: 4, cx: .nan}", "cx is nan; it must be"),
        ("a: {projection: pinhole, width: 4, height: 3, fx: 4, q: 1}", "'q' is unknown; it must"),
        ("a: {projection: pinhole, width: 4, height: 3, fx: 4, f: 1}", "f stands for fx and fy"),
        ("a: {projection: pinhole, width: 4, height: 3, fx: 4, hfov_deg: 9}", "hfov_deg is 9; it"),
        ("a: {projection: pinhole, width: 4, height: 3, hfov_deg: 180}", "hfov_deg is 180; it mus"),
        ("a: {projection: pinhole, width: 4, height: 3, hfov_deg: 90, cx: 1}", "cx is 1; it must"),
        ("a: {projection: equirectangular, fx: 5}", "fx is 5; it must be left out"),
        ("a: {projection: equirectangular, k1: 0.5}", "k1 is 0.5; it must be left out"),
        ("a: {projection: equirectangular, hfov_deg: 400}", r"hfov is 400.0 degrees; .*\(0, 360\]"),
        (
            "a: {projection: pinhole, model: OPENCV_FISHEYE, width: 4, height: 3, fx: 4, p1: 1}",
            "p1 is 1; it must be left out: model OPENCV_FISHEYE has none",
        ),
        ("a: {projection: pinhole, model: FOV, width: 4, height: 3, fx: 4}", "model is 'FOV'; it"),
        ("a: [", "is unreadable as YAML"),
    ],
)
def test_a_wrong_parameter_is_named_with_its_camera_and_file(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(DatasetError, match=message) as error:
        load_cameras(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_of_cameras(tmp_path):
    with pytest.raises(DatasetError, match=r"none.yaml: the file of cameras is missing"):
        load_cameras(tmp_path / "none.yaml")


def painted(x, y):
    """The colours of a smooth scene at places in front of the camera, focal length 1."""
    return np.stack(
        [127 + 120 * np.sin(5 * x), 127 + 120 * np.cos(4 * y), 127 + 120 * np.sin(3 * x + 2 * y)],
        axis=-1,
    )


def coordinates(camera):
    """x, y of each pixel's centre, over the focal length, as the camera's numbers say."""
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    return np.meshgrid(x, y)


def inverse(distort, x, y):
    """The undistorted places of distorted ones, by fixed-point iteration."""
    found = x.copy(), y.copy()
    for _ in range(60):
        bent = distort(*found)
        found = found[0] + x - bent[0], found[1] + y - bent[1]
    return found


def brown(camera):
    def distort(x, y):
        r2 = x * x + y * y
        radial = (1 + r2 * (camera.k1 + r2 * (camera.k2 + r2 * camera.k3))) / (
            1 + r2 * (camera.k4 + r2 * (camera.k5 + r2 * camera.k6))
        )
        p1, p2 = camera.p1, camera.p2
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )

    return distort


def fisheye(camera):
    def distort(x, y):
        r = np.maximum(np.hypot(x, y), 1e-12)
        theta = np.arctan(r)
        t2 = theta * theta
        bent = theta * (1 + t2 * (camera.k1 + t2 * (camera.k2 + t2 * camera.k3)))
        return x * bent / r, y * bent / r

    return distort


@pytest.mark.parametrize(
    ("distortion", "model"),
    [
        ({"k1": -0.2, "k2": 0.05}, brown),
        ({"k1": 0.1, "p1": 0.01, "p2": -0.005, "k3": 0.02}, brown),
        ({"k1": -0.1, "k4": 0.05, "k5": 0.01, "k6": -0.01}, brown),
        ({"model": "OPENCV_FISHEYE", "k1": 0.05, "k2": -0.01}, fisheye),
        ({"model": "OPENCV_FISHEYE"}, fisheye),
    ],
)
@pytest.mark.parametrize("fy", [150.0, 140.0])
def test_distortion_is_undone(distortion, model, fy):
    pytest.importorskip("cv2")
    camera = Camera(projection="pinhole", **SIZE, fx=150.0, fy=fy, cx=71.0, cy=64.0, **distortion)
    assert camera.distorted
    place = inverse(model(camera), *coordinates(camera))
    image = Image.fromarray(np.rint(painted(*place)).astype(np.uint8))
    found = np.asarray(camera.undistort(image), dtype=float)
    assert found.shape == (round(120 * 150 / fy), 160, 3)
    x = (np.arange(160) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(len(found)) + 0.5 - camera.cy * 150 / fy) / camera.fx
    expected = painted(*np.meshgrid(x, y))
    # Clear of the black that the camera did not see.
    inner = binary_erosion(found.any(axis=-1), iterations=4)
    assert inner.mean() > 0.6
    assert np.abs(found - expected)[inner].max() <= 6


def test_nothing_is_done_where_there_is_nothing_to_undo():
    image = Image.new("RGB", (80, 60))
    assert Camera(projection="pinhole", **SIZE, fx=150.0).undistort(image) is image
    assert Camera(projection="equirectangular").undistort(image) is image


def test_a_smaller_image_of_the_camera_is_taken_and_one_of_another_shape_is_not():
    pytest.importorskip("cv2")
    camera = Camera(projection="pinhole", **SIZE, fx=150.0, k1=-0.2)
    image = Image.fromarray(np.rint(painted(*coordinates(camera))).astype(np.uint8))
    half = np.asarray(camera.undistort(image.resize((80, 60))), dtype=float)
    whole = np.asarray(camera.undistort(image).resize((80, 60)), dtype=float)
    assert np.abs(half - whole)[8:-8, 8:-8].mean() < 1.5
    with pytest.raises(ImageError, match=r"a.jpg: 100x120 pixels; .* are 160x120, or scaled"):
        camera.undistort(image.resize((100, 120)), "a.jpg")


def test_the_frustum_is_that_of_the_intrinsics():
    camera = Camera(projection="pinhole", **SIZE, fx=80.0, cx=0.0)
    assert camera.frustum(2).edge_offsets_deg().tolist() == pytest.approx(
        [0.0, 45.0, math.degrees(math.atan(2))]
    )
