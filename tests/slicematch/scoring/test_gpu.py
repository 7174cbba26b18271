"""What a GPU gives is what the CPU gives. Skipped where there is none."""

import json

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from slicematch.network.aggregation import unit
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.off_grid import PairScorer
from slicematch.scoring.pooling import _has_kernel
from slicematch.scoring.scores import score_candidates

from slicemask import Frustum, PoseGrid, build_bank, open_bank, slice_masks
from slicemask.cli.main import main

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")

FRUSTA = [Frustum(360, 16), Frustum(81.5, 16, "pinhole")]
CHANNELS, CELLS = 64, 16


@pytest.fixture(params=FRUSTA, ids=["panorama", "pinhole"])
def frustum(request):
    return request.param


@pytest.fixture
def pair():
    """Ground descriptors [1, N, C], features [1, C, L, L] and attention [1, N, L, L]."""
    generator = torch.Generator().manual_seed(0)
    ground = unit(torch.randn(1, 16, CHANNELS, generator=generator))
    features = torch.randn(1, CHANNELS, CELLS, CELLS, generator=generator)
    return ground, features, torch.rand(1, 16, CELLS, CELLS, generator=generator)


def test_masks_and_their_gradients(frustum):
    rng = np.random.default_rng(0)
    poses = torch.from_numpy(rng.random((50, 3)) * [1, 1, 360])
    weights = torch.from_numpy(rng.random((50, 16, CELLS, CELLS)))
    found = {}
    for device in ("cpu", "cuda"):
        at = poses.to(device).requires_grad_()
        masks = slice_masks(at, frustum, CELLS, engine="rays")
        (gradient,) = torch.autograd.grad((masks * weights.to(device)).sum(), at)
        assert masks.device.type == gradient.device.type == device
        found[device] = masks.detach().cpu(), gradient.cpu()
    torch.testing.assert_close(found["cuda"][0], found["cpu"][0], rtol=0, atol=1e-12)
    torch.testing.assert_close(found["cuda"][1], found["cpu"][1], rtol=1e-9, atol=1e-9)


def test_scores_and_their_gradients(frustum, pair, tmp_path):
    path = build_bank(PoseGrid.parse("6x5x32"), frustum, CELLS, cache=tmp_path).path
    with open_bank(path) as bank:
        candidates = Candidates.from_bank(bank)
    weights = torch.randn(1, len(candidates.poses))
    found = {}
    for device in ("cpu", "cuda"):
        inputs = [x.to(device).requires_grad_() for x in pair]
        scores = score_candidates(*inputs, candidates.to(device))
        gradients = torch.autograd.grad((scores * weights.to(device)).sum(), inputs)
        found[device] = [x.detach().cpu() for x in (scores, *gradients)]
    for one, other in zip(found["cuda"], found["cpu"], strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("cancelled", [0.0, 0.99])
def test_scores_by_the_kernel(frustum, pair, tmp_path, cancelled):
    """Without gradients; also where the features of a mask nearly cancel."""
    path = build_bank(PoseGrid.parse("6x5x32"), frustum, CELLS, cache=tmp_path).path
    with open_bank(path) as bank:
        candidates = Candidates.from_bank(bank)
        mask = torch.from_numpy(bank.masks(np.array([400]))[0, 3])
    ground, features, _ = pair
    mean = torch.einsum("ij,bcij->bc", mask, features) / mask.sum()
    pair = ground, features - cancelled * mean[..., None, None], torch.ones(1, 16, CELLS, CELLS)
    assert _has_kernel(features.cuda(), 16)
    expected = score_candidates(*(x.double() for x in pair), candidates)
    found = score_candidates(*(x.cuda() for x in pair), candidates.to("cuda"))
    torch.testing.assert_close(found.cpu().double(), expected, rtol=1e-4, atol=1e-6)


def test_scoring_does_not_wait(frustum, pair, tmp_path):
    path = build_bank(PoseGrid.parse("6x5x32"), frustum, CELLS, cache=tmp_path).path
    with open_bank(path) as bank:
        candidates = Candidates.from_bank(bank, "cuda")
    inputs = [x.cuda() for x in pair]
    score_candidates(*inputs, candidates)  # the plan is made once, and waits
    torch.cuda.set_sync_debug_mode("error")
    try:
        score_candidates(*inputs, candidates)
    finally:
        torch.cuda.set_sync_debug_mode("default")


def test_scores_off_the_grid(frustum, pair):
    poses = torch.tensor([[0.4, 0.6, 30.0], [0.41, 0.6, 31.0]], dtype=torch.float64)
    scores = [
        PairScorer(*(x[0].to(device) for x in pair), frustum)(poses).cpu()
        for device in ("cpu", "cuda")
    ]
    torch.testing.assert_close(*scores, rtol=1e-4, atol=1e-6)


def test_the_benchmark_says_where_it_ran(tmp_path):
    result = CliRunner().invoke(
        main,
        ["benchmark", "--encoder", "test_convnext", "--ground-size", "32,64", "--aerial-size",
         "64", "--slices", "4", "--grid", "3x2x8", "--runs", "1", "--device", "cuda", "--json",
         "--cache", str(tmp_path)],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert json.loads(result.output)["device"].startswith("cuda")
