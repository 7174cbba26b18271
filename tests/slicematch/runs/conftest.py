"""A run that trains in seconds, for tests of what can be made of runs."""

import pytest
from slicematch.runs.config import TrainConfig


@pytest.fixture(scope="module")
def config(make_vigor_tree, tmp_path_factory):
    root = tmp_path_factory.mktemp("data") / "vigor"
    make_vigor_tree(root, 8, panorama_size=(64, 128), tile_pixels=64)
    return TrainConfig(
        data="vigor",
        root=str(root),
        data_settings={"cities": ["Chicago"]},
        encoder="test_resnet",
        weights="none",
        stride=8,
        pyramid=8,
        ground_size=(32, 64),
        aerial_size=64,
        slices=4,
        bands=(12.0,),
        train_grid="3x3x4",
        test_grid="4x4x8",
        learning_rate=1e-3,
        batch_size=2,
        epochs=1,
        workers=0,
        validation_fraction=0.25,
        heat_map_every=0,
        accelerator="cpu",
    )


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("banks")
