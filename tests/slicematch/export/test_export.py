"""Exported runs: equal to PyTorch, with other candidates too, and whole or not at all."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from slicematch.errors import ConfigError, RunError
from slicematch.export.export import export
from slicematch.export.formats import read
from slicematch.export.graphs import ScoreGraph
from slicematch.export.masks import mask_tables
from slicematch.localization.localizer import Localizer
from slicematch.network.bands import RangeBands
from slicematch.network.slicematch import SliceMatch
from slicematch.scoring.candidates import Candidates

from slicemask import Frustum, PoseGrid, build_bank, open_bank

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxscript")
pytest.importorskip("onnxruntime")

ROOT = Path(__file__).parents[3]
GRID = "5x5x8"


@pytest.fixture(scope="module")
def exported(run, cache, tmp_path_factory):
    out = tmp_path_factory.mktemp("export") / "onnx"
    content = export(run, out, grid=GRID, variants=["fp16", "int8"], samples=4, cache=cache)
    return out, content


def _candidates(frustum, cells, cache, grid=GRID):
    path = build_bank(PoseGrid.parse(grid), frustum, cells, engine="rays", cache=cache).path
    with open_bank(path) as bank:
        return Candidates.from_bank(bank)


@pytest.mark.parametrize("cross_view", [True, False])
@pytest.mark.parametrize("bands", [(), (0.1, 0.3)])
@pytest.mark.parametrize("frustum", [Frustum(360, 4), Frustum(80, 4, "pinhole")])
def test_the_graph_of_scores_gives_the_model_s_scores(frustum, bands, cross_view, cache):
    frustum = Frustum(frustum.hfov_deg, 4, frustum.projection, bands)
    rows = None
    if bands:
        rows = RangeBands(
            ranges_m=(5.0, 15.0), camera_height_m=2.0, elevations_deg=(-45, 45),
            projection=frustum.projection,
        )  # fmt: skip
    torch.manual_seed(0)
    model = SliceMatch(
        "test_resnet", "none", (64, 128), 64, 8, 4, cross_view_attention=cross_view, bands=rows
    ).eval()
    candidates = _candidates(frustum, model.cells, cache)
    tables = {k: torch.from_numpy(v) for k, v in mask_tables(candidates).arrays().items()}
    cells, weights = ([v for k, v in tables.items() if k.startswith(n)] for n in ("ce", "we"))
    with torch.no_grad():
        ground = model.encode_ground(torch.rand(1, 3, 64, 128))
        features = model.encode_aerial(torch.rand(1, 3, 64, 64))
        wanted = model.score(ground, features, candidates)[0]
        found = ScoreGraph(model)(ground[0], features[0], tables["index"], cells, weights)
    assert torch.allclose(found, wanted, rtol=0, atol=1e-6)


def test_files_answer_as_pytorch_does(exported, run, cache):
    out, content = exported
    assert max(content["largest_difference"].values()) <= 1e-5
    assert json.loads((out / "export.json").read_text()) == content
    # Of images and candidates that the export has not seen.
    localizer = Localizer.load(run, grid="4x4x12", device="cpu", cache=cache)
    rng = np.random.default_rng(1)
    sizes = {"ground": content["ground_size"], "aerial": [content["aerial_size"]] * 2}
    pixels = {k: rng.integers(0, 256, (1, *size, 3), np.uint8) for k, size in sizes.items()}
    mean, std = (torch.tensor(x)[:, None, None] for x in localizer.config.normalisation())
    images = [(torch.from_numpy(x).permute(0, 3, 1, 2) / 255 - mean) / std for x in pixels.values()]
    with torch.no_grad():
        wanted = localizer.model(*images, localizer.candidates)[0].numpy()
    files = {part: read(out / content["files"][part]) for part in ("ground", "aerial", "scores")}
    ground, features = (files[part]({"images": pixels[part]})[0] for part in sizes)
    masks = mask_tables(localizer.candidates).arrays()
    pair = {"ground": ground, "features": features}
    found = files["scores"]({**pair, **masks})
    assert np.abs(found - wanted).max() < 1e-5
    # A prior leaves out rows of the index.
    some = files["scores"]({**pair, **masks, "index": masks["index"][5:30]})
    assert np.allclose(some, found[5:30], rtol=0, atol=1e-6)


def test_variants_are_smaller_and_measured(exported):
    out, content = exported
    assert content["accuracy"].keys() == {"samples", "fp32", "fp16", "int8"}
    for part in ("ground", "aerial"):
        size, eighth = ((out / f"{part}{v}.onnx").stat().st_size for v in ("", ".int8"))
        assert eighth < size
        # So small a network is no smaller in half precision, for all the casts around it.
        half = onnx.load(out / f"{part}.fp16.onnx")
        assert onnx.TensorProto.FLOAT16 in {part.data_type for part in half.graph.initializer}
    for variant in ("fp16", "int8"):
        assert content["accuracy"][variant]["place_median_m"] >= 0


def test_the_example_needs_onnxruntime_and_numpy_alone(exported):
    code = (
        "import sys, runpy; sys.modules.update(dict.fromkeys(('torch', 'slicemask', 'PIL')));"
        f"sys.argv = ['run_onnx.py', {str(exported[0])!r}];"
        f"runpy.run_path({str(ROOT / 'examples' / 'run_onnx.py')!r}, run_name='__main__')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "200 candidates" in done.stdout
    assert float(done.stdout.split("at most ")[1].split()[0]) < 1e-5


def test_the_example_says_what_it_takes(tmp_path):
    command = [sys.executable, ROOT / "examples" / "run_onnx.py"]
    helped = subprocess.run([*command, "--help"], capture_output=True, text=True, check=True)
    assert "what slicemask export wrote" in helped.stdout
    done = subprocess.run([*command, tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "ground.onnx: no such file" in done.stderr
    assert "Traceback" not in done.stderr


def test_torch_export_with_masks_baked_in(run, cache, tmp_path):
    out = tmp_path / "pt2"
    content = export(run, out, format="torch-export", baked=True, grid=GRID, cache=cache)
    assert {path.suffix for path in out.iterdir()} == {".pt2", ".npz", ".json"}
    assert max(content["largest_difference"].values()) <= 1e-5
    assert set(np.load(out / "candidates.npz")) == {"poses"}


def test_what_cannot_be_is_refused_and_nothing_written(run, cache, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("kept")
    with pytest.raises(RunError, match="is not empty; name another folder"):
        export(run, tmp_path / "full", grid=GRID, cache=cache)
    with pytest.raises(ConfigError, match="variants are of the format onnx"):
        export(run, tmp_path / "a", format="torch-export", variants=["int8"], cache=cache)
    with pytest.raises(ConfigError, match="samples is 0"):
        export(run, tmp_path / "a", samples=0, cache=cache)
    assert [path.name for path in tmp_path.rglob("*")] == ["full", "mine.txt"]
