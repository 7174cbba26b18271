"""A seed stays a city: what the first version of the generator made, it makes today.

``same_bytes.json`` was written by that version; ``python tests/synth/test_same_bytes.py`` writes it
anew. Digests of pictures hold for the libraries and the kind of processor named in it: another
Shapely may cut a polygon into other triangles, another NumPy round a sine another way, and both
NumPy and Embree round by what instructions there are. Labels and the pictures' mean colours hold
everywhere.
"""

import hashlib
import importlib.metadata
import json
import platform
import tempfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from slicemask.synth import generate_kitti, generate_vigor

KEPT = Path(__file__).with_name("same_bytes.json")
VIGOR = {"cities": 2, "panoramas": 2, "seed": 1, "panorama_size": (96, 48), "tile_size": 64}
KITTI = {"frames": 3, "seed": 1, "image_size": (124, 38), "tile_size": 512}
LIBRARIES = ("embreex", "numpy", "pillow", "shapely", "trimesh")


def generate(root):
    generate_vigor(root / "vigor", jobs=1, **VIGOR)
    generate_kitti(root / "kitti", jobs=1, **KITTI)


def made_with():
    """What the bytes of a picture depend on."""
    return {name: importlib.metadata.version(name) for name in LIBRARIES} | {
        "machine": platform.machine(),
        "avx512": has_avx512(),
    }


def has_avx512():
    processor = Path("/proc/cpuinfo")
    return processor.exists() and " avx512f " in processor.read_text()


def files(root, *suffixes):
    return {
        path.relative_to(root).as_posix(): path
        for path in sorted(root.rglob("*"))
        if path.suffix in suffixes
    }


def digests(root, *suffixes):
    return {
        name: hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        for name, path in files(root, *suffixes).items()
    }


def mean_colours(root):
    """Mean colours of the pictures' quarters, north-west first."""
    return {
        name: np.asarray(Image.open(path).resize((2, 2), Image.Resampling.BOX), dtype=int).tolist()
        for name, path in files(root, ".jpg", ".png").items()
    }


@pytest.fixture(scope="module")
def kept():
    return json.loads(KEPT.read_text())


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    root = tmp_path_factory.mktemp("same")
    generate(root)
    return root


def test_labels_are_the_same(tree, kept):
    found = digests(tree, ".txt")
    assert {name: found.get(name) for name in kept["labels"]} == kept["labels"]


def test_pictures_have_the_same_colours(tree, kept):
    found = mean_colours(tree)
    assert found.keys() == kept["colours"].keys()
    for name, colours in kept["colours"].items():
        assert np.abs(np.subtract(found[name], colours)).max() <= 1, name


def test_pictures_are_the_same_bytes(tree, kept):
    if made_with() != kept["made_with"]:
        pytest.skip(f"the digests are those of {kept['made_with']}")
    assert digests(tree, ".jpg", ".png") == kept["pictures"]


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        generate(Path(folder))
        content = {
            "made_with": made_with(),
            "labels": digests(Path(folder), ".txt"),
            "pictures": digests(Path(folder), ".jpg", ".png"),
            "colours": mean_colours(Path(folder)),
        }
    KEPT.write_text(json.dumps(content, indent=1) + "\n")
