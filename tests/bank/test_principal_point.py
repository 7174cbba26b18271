"""Banks of cameras whose principal point is off the centre: version 3 of the format."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

from slicemask import (
    BankFormatError,
    BankSpec,
    Frustum,
    PoseGrid,
    build_bank,
    open_bank,
    slice_masks,
)
from slicemask.bank.seal import write_seal
from slicemask.bank.verify import verify_bank
from slicemask.cli.main import main

TINY = Path(__file__).parent / "data" / "tiny_v3.h5"
TINY_POSES = [[0.5, 0.5, 0.0], [0.5, 0.5, 90.0], [0.0, 0.0, 0.0], [0.0, 0.0, 135.0]]
TINY_FRUSTUM = Frustum.from_intrinsics(100, 0, 100, 1, (0.25,))
GRID = PoseGrid(4, 5, 12, places="endpoints")
FRUSTA = {
    "slices": Frustum.from_intrinsics(721.5, 609.6, 1242, 4),
    "bands": Frustum.from_intrinsics(700, 500, 1242, 3, (0.1, 0.4, 1.2)),
    "the axis on an edge of slices": Frustum.from_intrinsics(100, 50, 150, 3, (0.3,)),
    "the axis outside the image": Frustum.from_intrinsics(100, -20, 150, 3, (0.3,)),
}


@pytest.mark.parametrize("engine", ["shapely", "rays"])
@pytest.mark.parametrize("case", FRUSTA)
def test_a_bank_holds_the_masks_of_its_poses_and_verifies(tmp_path, case, engine):
    frustum = FRUSTA[case]
    path = build_bank(GRID, frustum, 8, engine=engine, cache=tmp_path).path
    expected = slice_masks(GRID.poses(), frustum, 8, engine)
    with open_bank(path) as bank:
        assert bank.spec.frustum == frustum
        assert np.abs(bank.masks(range(240)) - expected).max() <= 1e-7
        found = verify_bank(bank, None)
    assert found.passed
    assert found.engine != engine
    assert build_bank(GRID, frustum, 8, engine=engine, cache=tmp_path).reused


def test_the_file_says_version_3_and_the_spec_where_the_image_begins(tmp_path):
    path = build_bank(GRID, FRUSTA["slices"], 4, cache=tmp_path).path
    assert path.read_bytes().startswith(b"slicemask-bank 3\n")
    with h5py.File(path) as file:
        assert file.attrs["version"] == 3
        spec = json.loads(file.attrs["spec"])
        assert spec["frustum"]["left_deg"] == FRUSTA["slices"].left_deg
        assert "bands" not in spec["frustum"]
        assert file["index"].shape == (240, 4)


def test_the_name_says_where_the_image_begins_and_centred_ones_keep_theirs():
    spec = BankSpec(PoseGrid(2, 3, 4), Frustum(70, 5, "pinhole", (0.25,), left_deg=-30.5))
    assert spec.name() == "2x3x4_hfov70_left-30.5_pinhole_n5_bands0.25_l32.h5"
    assert BankSpec.from_json(spec.to_json()) == spec
    assert spec.version == 3
    assert "hfov 70 deg from -30.5 pinhole" in spec.summary()
    centred = BankSpec(PoseGrid(2, 3, 4), Frustum(70, 5, "pinhole", left_deg=-35.0))
    assert centred.name() == "2x3x4_hfov70_pinhole_n5_l32.h5"
    assert centred.version == 1
    assert "left_deg" not in centred.to_json()
    assert centred != spec


@pytest.mark.parametrize("version", [1, 2])
def test_a_version_that_does_not_fit_the_spec_is_refused(tmp_path, version):
    path = build_bank(GRID, FRUSTA["bands"], 4, out=tmp_path / "a.h5").path
    write_seal(path, version)
    with pytest.raises(BankFormatError, match=f"is sealed as version {version}"):
        open_bank(path)
    with h5py.File(path, "r+", locking=False) as file:
        file.attrs["version"] = version
    write_seal(path, version)
    with pytest.raises(BankFormatError, match="attribute version: expected 3"):
        open_bank(path)


def test_a_bank_of_version_3_is_read_for_ever():
    with open_bank(TINY) as bank:
        assert bank.poses.tolist() == TINY_POSES
        assert bank.spec.frustum == TINY_FRUSTUM
        masks = bank.masks(range(4))
    assert masks[0].tolist() == [[[[0, 0.125], [0, 0]], [[0, 0.375], [0, 0]]]]
    assert not masks[2].any()
    assert np.abs(masks - slice_masks(TINY_POSES, TINY_FRUSTUM, 2)).max() <= 1e-7


def test_commands_build_describe_verify_and_draw_such_a_camera(tmp_path):
    run = CliRunner().invoke
    out = str(tmp_path / "bank.h5")
    build = ["build", "--grid", "3x3x8", "--cells", "8", "--out", out]
    done = run(main, [*build, "--intrinsics", "721.5,609.6,1242"])
    assert done.exit_code == 0, done.output
    done = run(main, ["info", out])
    assert "axis      49.08 % of the image's width from its left" in done.stdout
    assert "which sees -40.195 to 41.235 degrees" in done.stdout
    content = json.loads(run(main, ["info", out, "--json"]).stdout)
    assert content["version"] == 3
    assert content["spec"]["frustum"]["left_deg"] == pytest.approx(-40.195, abs=1e-3)
    assert run(main, ["verify", out]).exit_code == 0
    other = run(main, [*build, "--hfov", "81.4", "--projection", "pinhole"])
    assert other.exit_code == 1
    assert "holds another bank" in other.stderr
    picture = tmp_path / "view.png"
    done = run(main, ["visualize", out, "--out", str(picture)])
    assert done.exit_code == 0, done.output
    assert picture.exists()
    at = ["visualize", "--at", "0.5,0.5,0", "--intrinsics", "100,0,100", "--out", str(picture)]
    assert run(main, at).exit_code == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--intrinsics", "100,50"], "'100,50' is not fx,cx,width"),
        (["--intrinsics", "0,50,100"], "fx is 0.0; it must be a number of pixels above 0"),
        (["--intrinsics", "100,50,100", "--hfov", "90"], "only one of --hfov and --intrinsics"),
        (
            ["--intrinsics", "100,50,100", "--projection", "equirectangular"],
            "--intrinsics are those of a pinhole camera",
        ),
    ],
)
def test_invalid_intrinsics_are_refused_in_one_sentence(tmp_path, options, message):
    done = CliRunner().invoke(
        main, ["build", "--grid", "2x2x4", "--out", str(tmp_path / "a.h5"), *options]
    )
    assert done.exit_code != 0
    assert message in done.stderr
    assert not list(tmp_path.iterdir())
