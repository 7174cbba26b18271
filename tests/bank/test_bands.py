"""Banks of banded slices: version 2 of the format."""

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

TINY = Path(__file__).parent / "data" / "tiny_v2.h5"
FRUSTA = {
    "circles": Frustum(360, 6, bands=(0.1, 0.4)),
    "planes": Frustum(81.5, 3, "pinhole", (0.1, 0.4, 1.2)),
    "one slice": Frustum(360, 1, bands=(0.3,)),
}
GRID = PoseGrid(4, 5, 12, places="endpoints")


@pytest.fixture(scope="module", params=FRUSTA)
def banded(request, tmp_path_factory):
    """A frustum and its bank by either engine."""
    frustum = FRUSTA[request.param]
    folder = tmp_path_factory.mktemp("banks")
    banks = {
        engine: build_bank(GRID, frustum, 8, engine=engine, out=folder / f"{engine}.h5").path
        for engine in ("shapely", "rays")
    }
    return frustum, banks


@pytest.mark.parametrize("engine", ["shapely", "rays"])
def test_a_bank_holds_the_masks_of_its_poses(banded, engine):
    frustum, banks = banded
    expected = slice_masks(GRID.poses(), frustum, 8, engine)
    with open_bank(banks[engine]) as bank:
        assert bank.index.shape == (240, *frustum.mask_axes)
        # Images of a polygon that stands for a circle are not the polygons of the images.
        assert np.abs(bank.masks(range(240)) - expected).max() <= 1e-6
        assert np.array_equal(bank.masks(17), bank.masks([17])[0])
        rows = bank.csr().toarray()
        assert np.abs(rows[bank.index].reshape(expected.shape) - expected).max() <= 1e-6
        # Bands beyond the tile are one row.
        assert np.count_nonzero(~rows.any(axis=1)) <= 1
        assert sorted(np.unique(bank.index)) == list(range(bank.rows))


@pytest.mark.parametrize("engine", ["shapely", "rays"])
def test_a_bank_verifies_by_the_other_engine(banded, engine):
    frustum, banks = banded
    with open_bank(banks[engine]) as bank:
        found = verify_bank(bank, None)
    assert found.passed
    assert found.engine != engine
    assert found.masks == 240 * frustum.slices * frustum.band_count
    assert found.tolerance == (2**-25 + (1e-9 if frustum.projection == "pinhole" else 1e-6))


def test_a_wrong_band_is_found_and_named(banded, tmp_path):
    _, banks = banded
    path = tmp_path / "wrong.h5"
    path.write_bytes(banks["rays"].read_bytes())
    with h5py.File(path, "r+", locking=False) as file:
        index = file["index"][:]
        pose, number, band = 7, 0, 1
        index[pose, number, band] = (index[pose, number, band] + 5) % len(file["masks/indptr"])
        file["index"][:] = index
    write_seal(path, 2)
    with open_bank(path) as bank:
        assert verify_bank(bank, None).first_wrong == (pose, number, band)
    done = CliRunner().invoke(main, ["verify", str(path), "--all"])
    assert done.exit_code == 1
    assert "first band 1 of slice 0 of pose 7" in done.output


def test_the_same_arguments_give_the_same_bytes(banded, tmp_path):
    frustum, banks = banded
    again = build_bank(GRID, frustum, 8, jobs=1, out=tmp_path / "again.h5").path
    assert again.read_bytes() == banks["shapely"].read_bytes()


def test_the_file_says_version_2_and_the_spec_its_bands(banded):
    frustum, banks = banded
    path = banks["rays"]
    assert path.read_bytes().startswith(b"slicemask-bank 2\n")
    with h5py.File(path) as file:
        assert file.attrs["version"] == 2
        assert json.loads(file.attrs["spec"])["frustum"]["bands"] == list(frustum.bands)
        assert file["index"].shape == (240, *frustum.mask_axes)
        assert file["index"].dtype == np.int32


def test_without_bands_the_file_is_version_1(tmp_path):
    path = build_bank(PoseGrid(2, 2, 4), Frustum(90, 2, bands=()), 4, out=tmp_path / "a.h5").path
    assert path.read_bytes().startswith(b"slicemask-bank 1\n")
    with h5py.File(path) as file:
        assert file.attrs["version"] == 1
        assert "bands" not in json.loads(file.attrs["spec"])["frustum"]


def test_the_name_says_the_bands():
    spec = BankSpec(PoseGrid(2, 3, 4), Frustum(90, 5, bands=(0.08, 0.25)))
    assert spec.name() == "2x3x4_hfov90_n5_bands0.08-0.25_l32.h5"
    assert BankSpec.from_json(spec.to_json()) == spec
    assert spec != BankSpec(PoseGrid(2, 3, 4), Frustum(90, 5))
    assert "5 slices with bands at 0.08,0.25" in spec.summary()


@pytest.mark.parametrize(("version", "bands"), [(1, (0.5,)), (2, ())])
def test_a_version_that_does_not_fit_the_spec_is_refused(tmp_path, version, bands):
    path = build_bank(PoseGrid(2, 2, 4), Frustum(90, 2, bands=bands), 4, out=tmp_path / "a.h5").path
    write_seal(path, version)
    with pytest.raises(BankFormatError, match=f"is sealed as version {version}"):
        open_bank(path)
    with h5py.File(path, "r+", locking=False) as file:
        file.attrs["version"] = version
    write_seal(path, version)
    with pytest.raises(BankFormatError, match="attribute version: expected"):
        open_bank(path)


# Version 2, as it was first written.
TINY_POSES = [[0.5, 0.5, 0.0], [0.5, 0.5, 90.0], [0.0, 0.0, 0.0], [0.0, 0.0, 135.0]]


def test_a_bank_of_version_2_is_read_for_ever():
    with open_bank(TINY) as bank:
        assert bank.poses.tolist() == TINY_POSES
        assert bank.spec.frustum == Frustum(90, 2, "pinhole", (0.5,))
        assert bank.index.shape == (4, 2, 2)
        masks = bank.masks(range(4))
    assert masks[0].tolist() == [
        [[[0.5, 0], [0, 0]], [[0, 0], [0, 0]]],
        [[[0, 0.5], [0, 0]], [[0, 0], [0, 0]]],
    ]
    assert masks[2].tolist() == np.zeros((2, 2, 2, 2)).tolist()
    expected = slice_masks(TINY_POSES, Frustum(90, 2, "pinhole", (0.5,)), 2)
    assert np.abs(masks - expected).max() <= 1e-7


def test_a_bank_of_version_2_is_reused(tmp_path):
    path = tmp_path / "tiny.h5"
    path.write_bytes(TINY.read_bytes())
    assert build_bank(TINY_POSES, Frustum(90, 2, "pinhole", (0.5,)), 2, out=path).reused


def test_commands_build_describe_and_verify_bands(tmp_path):
    run = CliRunner().invoke
    out = str(tmp_path / "bank.h5")
    build = ["build", "--grid", "3x3x8", "--cells", "8", "--out", out, "--json"]
    done = run(main, [*build, "--bands", "0.1,0.3"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["masks"] == 72 * 16 * 3
    done = run(main, ["info", out])
    assert "bands     0 to 0.1, 0.1 to 0.3, beyond 0.3" in done.stdout
    assert json.loads(run(main, ["info", out, "--json"]).stdout)["version"] == 2
    assert run(main, ["verify", out]).exit_code == 0
    other = run(main, [*build, "--bands", "0.1"])
    assert other.exit_code == 1
    assert "holds another bank" in other.stderr


@pytest.mark.parametrize("text", ["0.3,0.1", "0.1,x", "-1", "nan", "0.1;0.2"])
def test_bands_that_are_invalid_are_refused_in_one_sentence(tmp_path, text):
    done = CliRunner().invoke(
        main, ["build", "--grid", "2x2x4", "--out", str(tmp_path / "a.h5"), f"--bands={text}"]
    )
    assert done.exit_code != 0
    assert "0.08,0.17,0.33" in done.stderr
    assert not list(tmp_path.iterdir())
