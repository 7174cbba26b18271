"""The scores of all candidates against the dense product of eq. 4 and the cosine."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import sparse
from slicematch.errors import ConfigError
from slicematch.network.aggregation import unit
from slicematch.scoring import plan
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.plan import as_means
from slicematch.scoring.scores import heat_map, score_candidates, score_masks
from torch._subclasses.fake_tensor import DataDependentOutputException, FakeTensorMode

from slicemask import Frustum, PoseGrid, build_bank, open_bank

CELLS, CHANNELS, BATCH = 6, 5, 2
MODES = {
    "panorama": ("5x4x8", Frustum(360, 8)),
    "panorama of 16 slices": ("3x4x32", Frustum(360, 16)),
    "panorama whose headings share no edges": ("3x3x5", Frustum(360, 7)),
    "one slice": ("3x3x2", Frustum(360, 1)),
    "pinhole": ("4x4x8", Frustum(81.5, 5, "pinhole")),
    "aligned": ("7x7x1", Frustum(360, 4)),
}


def features(slices, seed=0, dtype=torch.float32):
    """Random descriptors [B, N, C], features [B, C, L, L] and attention [B, N, L, L]."""
    generator = torch.Generator().manual_seed(seed)
    ground = unit(torch.randn(BATCH, slices, CHANNELS, generator=generator, dtype=dtype))
    aerial = torch.randn(BATCH, CHANNELS, CELLS, CELLS, generator=generator, dtype=dtype)
    attention = torch.rand(BATCH, slices, CELLS, CELLS, generator=generator, dtype=dtype)
    return ground, aerial, attention


def dense_scores(ground, aerial, attention, masks):
    """Eq. 4 and the cosine, K x N x C at once: masks [K, N, L, L].

    Descriptors are scaled to length 1 as the model does it, by sqrt(|d|^2 + 1e-8).
    """
    pooled = np.einsum("knij,bnij,bcij->bknc", masks, attention, aerial)
    area = masks.sum(axis=(2, 3))[None, :, :, None]
    mean = np.divide(pooled, area, out=np.zeros_like(pooled), where=area > 0)
    slices = mean / np.sqrt((mean**2).sum(axis=-1, keepdims=True) + 1e-8)
    a, g = slices.reshape(*slices.shape[:2], -1), ground.reshape(len(ground), -1)
    present = (slices != 0).any(axis=-1).sum(axis=-1)
    lengths = np.sqrt(present * ((g**2).sum(axis=-1) + 1e-8)[:, None])
    dots = np.einsum("bi,bki->bk", g, a)
    return np.divide(dots, lengths, out=np.zeros_like(dots), where=lengths > 0)


@pytest.fixture(params=MODES)
def bank(request, tmp_path):
    grid, frustum = MODES[request.param]
    grid = PoseGrid.parse(grid, places="endpoints")
    with open_bank(build_bank(grid, frustum, CELLS, cache=tmp_path).path) as bank:
        yield bank


def all_masks(bank):
    return bank.masks(np.arange(len(bank))).astype(np.float64)


def in_float64(bank):
    """Candidates whose masks are divided by their sums in float64, for tests of the last digits."""
    candidates, csr = Candidates.from_bank(bank), bank.csr()
    starts, cells, _ = candidates.masks
    return replace(candidates, masks=as_means((starts, cells, torch.from_numpy(csr.data).double())))


@pytest.mark.parametrize("values_at_once", [None, 70])
def test_every_mode_equals_the_dense_product(bank, values_at_once):
    # Places on the tile's edges give slices that miss the tile, and whole frusta that do.
    inputs = features(bank.spec.frustum.slices)
    found = score_candidates(*inputs, Candidates.from_bank(bank), values_at_once=values_at_once)
    expected = dense_scores(*(x.double().numpy() for x in inputs), all_masks(bank))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    dense = torch.from_numpy(all_masks(bank)).expand(BATCH, -1, -1, -1, -1)
    np.testing.assert_allclose(score_masks(*inputs, dense), expected, rtol=0, atol=1e-6)


@pytest.fixture(params=[True, False], ids=["kept for the gradients", "pooled again"])
def kept(request, monkeypatch):
    """Either way to the gradients, whatever the size."""
    monkeypatch.setattr("slicematch.scoring.pooling._VALUES_KEPT", 1 << 40 if request.param else 0)


def test_gradients_equal_those_of_the_dense_product(bank, kept):
    inputs = [x.requires_grad_() for x in features(bank.spec.frustum.slices, dtype=torch.float64)]
    weights = torch.randn(BATCH, len(bank), dtype=torch.float64)
    dense = torch.from_numpy(all_masks(bank)).expand(BATCH, -1, -1, -1, -1)
    expected = torch.autograd.grad((score_masks(*inputs, dense) * weights).sum(), inputs)
    candidates = in_float64(bank)
    found = torch.autograd.grad((score_candidates(*inputs, candidates) * weights).sum(), inputs)
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-10)


def build(tmp_path, grid, frustum, cells=CELLS):
    with open_bank(build_bank(grid, frustum, cells, cache=tmp_path).path) as bank:
        return Candidates.from_bank(bank)


def test_priors_are_subsets_and_leave_the_scores_as_they_are(tmp_path):
    frustum = Frustum(360, 8)
    candidates = build(tmp_path, PoseGrid.parse("8x4x16"), frustum)
    inputs = features(8)
    whole = candidates.scatter_to_grid(score_candidates(*inputs, candidates))
    assert whole.shape == (BATCH, 8, 4, 16)

    # 16 headings are 22.5 degrees apart; the prior reaches across north.
    prior = candidates.within(heading_prior=(350.0, 35.0), place_prior=(0.125, 0.0625, 0.25))
    assert sorted(set(prior.poses[:, 2])) == [0.0, 22.5, 315.0, 337.5]
    places = {tuple(place) for place in prior.poses[:, :2].tolist()}
    assert places == {(0.125, 0.0625), (0.375, 0.0625), (0.125, 0.1875), (0.125, 0.3125)}
    some = prior.scatter_to_grid(score_candidates(*inputs, prior))
    kept = torch.isfinite(some)
    assert kept.sum() == BATCH * 4 * 4
    torch.testing.assert_close(some[kept], whole[kept])
    assert (some[~kept] == -torch.inf).all()
    assert heat_map(some).shape == (BATCH, 8, 4)
    assert torch.isfinite(heat_map(some)).sum() == BATCH * 4


@pytest.mark.parametrize("centre", [0.0, 360.0, -360.0, 720.0])
def test_a_known_heading_is_a_prior_of_no_width(tmp_path, centre):
    candidates = build(tmp_path, PoseGrid.parse("3x3x16"), Frustum(360, 4))
    aligned = candidates.within(heading_prior=(centre, 0.0))
    assert (aligned.poses[:, 2] == 0).all()
    assert len(aligned.poses) == 9
    np.testing.assert_array_equal(aligned.grid_index, np.arange(0, 144, 16))


def test_a_prior_of_half_a_circle_keeps_every_heading(tmp_path):
    candidates = build(tmp_path, PoseGrid.parse("2x2x8"), Frustum(360, 4))
    assert candidates.within(heading_prior=(123.0, 180.0)) is candidates


@pytest.mark.parametrize(
    ("priors", "said"),
    [
        ({"heading_prior": (5.0, 1.0)}, "no candidate pose agrees"),
        ({"place_prior": (0.0, 0.0, 0.01)}, "no candidate pose agrees"),
        ({"heading_prior": (5.0, -1.0)}, "heading prior is"),
        ({"heading_prior": (float("nan"), 1.0)}, "heading prior is"),
        ({"place_prior": (0.5, 0.5)}, "place prior is"),
    ],
)
def test_priors_that_cannot_be(tmp_path, priors, said):
    candidates = build(tmp_path, PoseGrid.parse("2x2x8"), Frustum(360, 4))
    with pytest.raises(ConfigError, match=said):
        candidates.within(**priors)


def test_a_bank_of_another_model_is_refused(tmp_path):
    candidates = build(tmp_path, PoseGrid.parse("2x2x8"), Frustum(360, 4), cells=3)
    with pytest.raises(ConfigError, match="4 slices and 3 cells a side, the model 4 descriptors"):
        score_candidates(*features(4), candidates)


def test_a_frustum_that_misses_the_tile_scores_zero(tmp_path):
    # In the south-east corner, looking south-east.
    grid = PoseGrid(2, 2, 8, places="endpoints")
    candidates = build(tmp_path, grid, Frustum(90, 4))
    inputs = [x.requires_grad_() for x in features(4)]
    scores = candidates.scatter_to_grid(score_candidates(*inputs, candidates))
    assert (scores[:, 1, 1, 3] == 0).all()
    scores[:, 1, 1, 3].sum().backward()
    assert all((x.grad == 0).all() for x in inputs)


def test_poses_that_all_miss_the_tile(tmp_path):
    poses = [[1.0, 1.0, 135.0], [1.0, 1.0, 130.0]]
    bank = build_bank(poses, Frustum(60, 4), CELLS, cache=tmp_path).path
    with open_bank(bank) as opened:
        assert opened.nonzeros == 0
        candidates = Candidates.from_bank(opened)
    assert (score_candidates(*features(4), candidates) == 0).all()


def test_masks_are_pooled_the_way_that_suits_their_use(tmp_path):
    candidates = build(tmp_path, PoseGrid.parse("3x4x32"), Frustum(360, 16))
    inputs = features(16)
    whole = score_candidates(*inputs, candidates)
    assert not any(len(rows) for rows, _ in candidates.plans[0].single)
    # Few headings use a mask as few slice numbers; with more of them, some masks are shared.
    for half_width, ways in ((20.0, "single"), (105.0, "both")):
        some = candidates.within(heading_prior=(0.0, half_width))
        plan = some.plans[0]
        assert bool(len(plan.many)) == (ways == "both")
        assert any(len(rows) for rows, _ in plan.single)
        found = score_candidates(*inputs, some)
        torch.testing.assert_close(found, whole[:, some.grid_index], rtol=1e-5, atol=1e-6)
        torch.testing.assert_close(score_candidates(*inputs, some.to("cpu")), found)


def test_masks_that_are_all_in_use_are_not_copied(tmp_path):
    candidates = build(tmp_path, PoseGrid.parse("3x4x8"), Frustum(360, 4))
    (whole,) = candidates.shared_plans
    assert whole.masks is candidates.masks
    (some,) = candidates.within(place_prior=(0.2, 0.2, 0.2)).shared_plans
    assert len(some.masks[0]) < len(whole.masks[0])


def test_scoring_asks_for_no_value_that_a_gpu_would_have_to_be_waited_for(bank, kept):
    """Fake tensors know their shapes, and refuse to say their values."""
    candidates = Candidates.from_bank(bank)
    plan = candidates.plans[0]
    with FakeTensorMode() as mode:
        fake = mode.from_tensor
        unknown = replace(
            candidates,
            index=fake(candidates.index),
            masks=tuple(map(fake, candidates.masks)),
            grid_index=fake(candidates.grid_index),
        )
        unknown.__dict__["plans"] = [
            replace(
                plan,
                masks=unknown.masks,
                many=fake(plan.many),
                single=[(fake(rows), sums) for rows, sums in plan.single],
                slot=fake(plan.slot),
            )
        ]
        inputs = [fake(x).requires_grad_() for x in features(bank.spec.frustum.slices)]
        scores = score_candidates(*inputs, unknown, values_at_once=70)
        torch.autograd.grad(unknown.scatter_to_grid(scores).amax(), inputs)
        with pytest.raises(DataDependentOutputException):
            scores.amax().item()
    assert scores.shape == (BATCH, len(bank))


@pytest.mark.parametrize("frustum", [Frustum(360, 16), Frustum(80, 16, "pinhole")])
def test_features_that_nearly_cancel(tmp_path, frustum):
    """A slice whose features sum to a hundredth of their size keeps four digits."""
    grid = PoseGrid.parse("1x1x16")
    with open_bank(build_bank(grid, frustum, CELLS, cache=tmp_path).path) as bank:
        candidates, masks = Candidates.from_bank(bank), all_masks(bank)
    ground, aerial, _ = (x.double() for x in features(16))
    attention = torch.ones(BATCH, 16, CELLS, CELLS, dtype=torch.float64)
    chosen = torch.from_numpy(masks[5, 3])
    mean = torch.einsum("ij,bcij->bc", chosen, aerial) / chosen.sum()
    aerial = (aerial - 0.99 * mean[..., None, None]).float()
    inputs = ground.float(), aerial, attention.float()
    expected = dense_scores(*(x.double().numpy() for x in inputs), masks)
    found = score_candidates(*inputs, candidates)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)
    # The share of that slice alone, which the others cannot hide.
    alone = torch.zeros_like(inputs[0])
    alone[:, 3] = inputs[0][:, 3]
    expected = dense_scores(alone.double().numpy(), aerial.double(), attention.numpy(), masks)
    found = score_candidates(alone, *inputs[1:], candidates)
    np.testing.assert_allclose(found[:, 5], expected[:, 5], rtol=1e-4)


def test_gradients_of_masks_that_are_pooled_both_ways(tmp_path, kept):
    """Masks pooled both ways, in blocks, give the gradients of the dense product."""
    frustum = Frustum(360, 16)
    with open_bank(build_bank(PoseGrid.parse("2x2x32"), frustum, 4, cache=tmp_path).path) as bank:
        some = in_float64(bank).within(heading_prior=(0.0, 105.0))
        masks = torch.from_numpy(all_masks(bank))[some.grid_index]
    ground, aerial, attention = features(16, dtype=torch.float64)
    inputs = [x.requires_grad_() for x in (ground, aerial[..., :4, :4], attention[..., :4, :4])]
    weights = torch.randn(BATCH, len(masks), dtype=torch.float64)
    dense = masks.expand(BATCH, -1, -1, -1, -1)
    expected = torch.autograd.grad((score_masks(*inputs, dense) * weights).sum(), inputs)
    scores = score_candidates(*inputs, some, values_at_once=300)
    found = torch.autograd.grad((scores * weights).sum(), inputs)
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-10)


@pytest.mark.parametrize("shared", [False, True], ids=["attention by slice", "shared attention"])
@pytest.mark.parametrize("bands", [1, 3])
def test_bands_equal_the_dense_product(bank, bands, shared, monkeypatch):
    monkeypatch.setattr(plan, "_ROWS", 7)  # plans are made a few rows at a time
    masks = all_masks(bank)[:, :, None]  # [K, N, 1, L, L]
    if bands > 1:  # any parts of a slice that sum to it
        parts = np.random.default_rng(0).dirichlet(np.ones(bands), masks.shape[:2])
        masks = masks * parts[..., None, None]
    poses, slices = masks.shape[:2]
    rows = sparse.csr_array(masks.reshape(-1, CELLS * CELLS))
    candidates = replace(
        Candidates.from_bank(bank),
        index=torch.arange(poses * slices * bands).view(poses, slices, bands),
        masks=as_means(tuple(map(torch.from_numpy, (rows.indptr, rows.indices, rows.data)))),
    )
    inputs = list(features(slices * bands, dtype=torch.float64))
    if shared:
        inputs[2] = inputs[2][:, :1]
    inputs = [x.requires_grad_() for x in inputs]
    flat = masks.reshape(poses, slices * bands, CELLS, CELLS)
    wide = np.broadcast_to(inputs[2].detach(), (BATCH, slices * bands, CELLS, CELLS))
    expected = dense_scores(*(x.detach().numpy() for x in inputs[:2]), wide, flat)
    found = score_candidates(*inputs, candidates, values_at_once=70)
    np.testing.assert_allclose(found.detach(), expected, rtol=0, atol=1e-12)
    dense = torch.from_numpy(masks).expand(BATCH, -1, -1, -1, -1, -1)
    few = score_masks(*inputs, dense)
    np.testing.assert_allclose(few.detach(), expected, rtol=0, atol=1e-12)
    weights = torch.randn(BATCH, poses, dtype=torch.float64)
    for one, other in zip(
        torch.autograd.grad((found * weights).sum(), inputs),
        torch.autograd.grad((few * weights).sum(), inputs),
        strict=True,
    ):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-10)


def test_masks_of_other_bands_are_refused(tmp_path):
    candidates = build(tmp_path, PoseGrid.parse("2x2x8"), Frustum(360, 4))
    with pytest.raises(ConfigError, match="4 slices and 6 cells a side, the model 8 descriptors"):
        score_candidates(*features(8), candidates)


MEMORY = r"""
import re, sys
from pathlib import Path
import torch
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.plan import as_means
from slicematch.scoring.scores import score_candidates
from slicemask import open_bank

def kib(name):
    return int(re.search(name + r":\s*(\d+) kB", Path("/proc/self/status").read_text())[1])

with open_bank(sys.argv[1]) as bank:
    candidates = Candidates.from_bank(bank)
inputs = torch.rand(1, 16, 512), torch.randn(1, 512, 32, 32), torch.rand(1, 16, 32, 32)
Path("/proc/self/clear_refs").write_text("5")  # the peak so far is forgotten
before = kib("VmRSS")
with torch.no_grad():
    score_candidates(*inputs, candidates)
print(1024 * (kib("VmHWM") - before))
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="reads Linux's /proc")
def test_memory_at_the_papers_size(tmp_path):
    """28,224 poses of 16 slices, 512 channels on 32x32 cells: 400 MB at most, by VGG16."""
    bank = build_bank(PoseGrid.parse("21x21x64"), Frustum(360, 16), 32, cache=tmp_path, jobs=1)
    process = subprocess.run(
        [sys.executable, "-c", MEMORY, str(bank.path)],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=True,
    )
    assert 1e6 < int(process.stdout) <= 400e6


def test_nothing_of_size_poses_by_slices_by_channels_is_held(tmp_path):
    """The largest tensor of a call stays far below K x N x C values."""
    candidates = build(tmp_path, PoseGrid.parse("9x9x32"), Frustum(360, 16), cells=8)
    poses, slices, channels = len(candidates.poses), 16, 128
    ground = unit(torch.randn(1, slices, channels))
    aerial, attention = torch.randn(1, channels, 8, 8), torch.rand(1, slices, 8, 8)
    largest = 0

    class Watch(torch.utils._python_dispatch.TorchDispatchMode):
        def __torch_dispatch__(self, function, types, args=(), kwargs=None):
            nonlocal largest
            result = function(*args, **(kwargs or {}))
            if isinstance(result, torch.Tensor) and result.layout == torch.strided:
                largest = max(largest, result.numel())
            return result

    with Watch():
        score_candidates(ground, aerial, attention, candidates, values_at_once=256 * channels)
    assert 128 * channels <= largest <= poses * slices * channels / 40


@pytest.mark.parametrize("rows_at_once", [1, 2, 3, 8192])
def test_rows_become_means_wherever_empty_ones_are(monkeypatch, rows_at_once):
    monkeypatch.setattr("slicematch.scoring.plan._ROWS", rows_at_once)
    starts = torch.tensor([0, 0, 2, 2, 2, 3, 6, 6, 6], dtype=torch.int32)
    values = torch.tensor([0.25, 0.75, 1e-6, 1.0, 1.0, 2.0])
    cells = torch.arange(6)
    _, same, means = as_means((starts, cells, values))
    assert same is cells
    assert means.dtype == torch.float32
    assert means.tolist() == [0.25, 0.75, 1.0, 0.25, 0.25, 0.5]
