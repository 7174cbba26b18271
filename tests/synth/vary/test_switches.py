"""Switches of domain randomisation: what each changes, and what none of them may."""

import re

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from slicematch.data.dataset import PoseDataset
from slicematch.data.vigor import METRES_PER_PIXEL, VigorConfig

from slicemask.cli.main import main
from slicemask.errors import SynthError
from slicemask.synth import generate_vigor
from slicemask.synth.vary.switches import SWITCHES, Variation, check_switches

SMALL = {"panoramas": 3, "seed": 2, "panorama_size": (96, 48), "tile_size": 64, "jobs": 1}
# What changes without the layout, so that labels stay.
PICTURES = ("light", "exposure", "camera", "imagery", "roads", "trees", "season")


def contents(root, *suffixes):
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.suffix in suffixes
    }


def label_lines(root, city="NewYork"):
    path = root / "splits__corrected" / city / "pano_label_balanced__corrected.txt"
    return [line.split(" ") for line in path.read_text().splitlines()]


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    root = tmp_path_factory.mktemp("plain")
    generate_vigor(root, **SMALL)
    return root


@pytest.fixture(scope="module")
def varied(tmp_path_factory):
    """A city of two places, with all switches on."""
    root = tmp_path_factory.mktemp("varied")
    generate_vigor(root, **{**SMALL, "panoramas": 4}, places=2, vary=["all"])
    return root


@pytest.mark.parametrize("name", PICTURES)
def test_a_switch_changes_pictures_and_no_label(plain, tmp_path, name):
    generate_vigor(tmp_path / "city", **SMALL, vary=[name])
    assert contents(tmp_path / "city", ".txt") == contents(plain, ".txt")
    before, after = (contents(root, ".jpg", ".png") for root in (plain, tmp_path / "city"))
    changed = {name.split("/")[1] for name in before if before[name] != after[name]}
    # A city's grass and leaves can be alike in two seasons; all else shows in both views.
    views = {"camera": {"panorama"}, "imagery": {"satellite"}}
    assert changed == views.get(name, {"panorama", "satellite"})


def test_what_a_switch_draws_does_not_depend_on_the_others():
    alone, together = (Variation(names, (4, 1)) for names in (("camera",), tuple(SWITCHES)))
    assert alone.random("camera", 3).random() == together.random("camera", 3).random()
    assert alone.random("camera", 3).random() != alone.random("camera", 4).random()
    drawn = {together.random(name).random() for name in SWITCHES}
    assert len(drawn) == len(SWITCHES)


def test_all_switches_depend_on_the_seed_alone(varied, tmp_path):
    options = {**SMALL, "panoramas": 4, "jobs": 2}
    generate_vigor(tmp_path / "again", **options, places=2, vary=list(SWITCHES))
    assert contents(tmp_path / "again", ".jpg", ".png", ".txt", ".json") == contents(
        varied, ".jpg", ".png", ".txt", ".json"
    )


def test_places_of_a_city_are_read_as_one_city(varied):
    lines = label_lines(varied)
    assert len({line[0] for line in lines}) == 4
    longitudes = {round(float(line[0].split(",")[2]) / 0.05) for line in lines}
    assert len(longitudes) == 2
    for line in lines:
        latitude, longitude = map(float, line[0].split(",")[1:3])
        for name, d0, d1 in zip(line[1::3], line[2::3], line[3::3], strict=True):
            assert (varied / "NewYork" / "satellite" / name).is_file()
            tile_latitude, tile_longitude = map(float, name[:-4].split("_")[1:])
            south_m = (tile_latitude - latitude) * 111_320
            west_m = (tile_longitude - longitude) * 111_320 * np.cos(np.radians(latitude))
            assert float(d0) * METRES_PER_PIXEL["NewYork"] == pytest.approx(south_m, abs=0.15)
            assert float(d1) * METRES_PER_PIXEL["NewYork"] == pytest.approx(west_m, abs=0.15)
    config = VigorConfig(root=varied, cities=("NewYork",), validation_fraction=0.0)
    parts = [PoseDataset(config, part) for part in ("train", "test")]
    assert [len(part) for part in parts] == [2, 2]
    assert parts[0][0]["ground"].shape == (3, 320, 640)


def test_places_differ(varied):
    tiles = [
        np.asarray(Image.open(path), dtype=float).mean(axis=(0, 1))
        for path in sorted((varied / "NewYork" / "satellite").iterdir())
    ]
    assert np.std(tiles, axis=0).min() > 5


def test_plain_places_do_not_vary(tmp_path):
    """So many of the places are as without switches, bytes and all; the others vary."""
    size = {**SMALL, "panoramas": 3, "places": 3}
    generate_vigor(tmp_path / "plain", **size)
    generate_vigor(tmp_path / "mixed", **size, vary=["light", "imagery"], plain_places=2)
    plain, mixed = (contents(tmp_path / name, ".jpg", ".png") for name in ("plain", "mixed"))
    same = [path for path in plain if "panorama" in str(path) and plain[path] == mixed.get(path)]
    assert len(same) == 2


def test_label_noise_is_in_the_labels_alone(plain, tmp_path):
    generate_vigor(tmp_path / "noisy", **SMALL, label_noise_m=3.0)
    assert contents(tmp_path / "noisy", ".jpg", ".png") == contents(plain, ".jpg", ".png")
    errors_m = []
    for exact, noisy in zip(label_lines(plain), label_lines(tmp_path / "noisy"), strict=True):
        assert exact[0::3] == noisy[0::3] or exact[1::3] == noisy[1::3]
        shift = np.array([exact[2::3], exact[3::3], noisy[2::3], noisy[3::3]], dtype=float)
        shift = shift[2:] - shift[:2]
        assert np.ptp(shift, axis=1).max() < 0.01  # the same in all four tiles
        errors_m.append(shift[:, 0] * METRES_PER_PIXEL["NewYork"])
    assert 0.5 < np.std(errors_m) < 8


def test_names_come_in_the_registry_s_order():
    assert check_switches(["imagery", "light"]) == ("light", "imagery")
    assert check_switches(["light", "all"]) == tuple(SWITCHES)
    assert check_switches([]) == ()


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"vary": ["weather"]}, "vary names 'weather'; it must be all, or of light, exposure"),
        ({"places": 4}, "places is 4; it must be 1 to the number of panoramas a city, 3"),
        ({"places": 0}, "places is 0; it must be 1 to"),
        ({"places": 2, "plain_places": 1}, "plain_places is 1; without vary all places are plain"),
        ({"vary": ["light"], "plain_places": 1}, "plain_places is 1; it must be 0 to less than"),
        ({"label_noise_m": -1.0}, "label_noise_m is -1.0; it must be 0 to 20 metres"),
    ],
)
def test_wrong_options_are_one_sentence(tmp_path, wrong, sentence):
    with pytest.raises(SynthError, match=re.escape(sentence)):
        generate_vigor(tmp_path / "city", **{**SMALL, **wrong})
    assert not (tmp_path / "city").exists()


def test_help_names_every_switch():
    help_text = " ".join(CliRunner().invoke(main, ["synth", "--help"]).output.split())
    for switch in SWITCHES.values():
        assert f"{switch.name} ({switch.help})" in help_text
