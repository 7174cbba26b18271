"""The GPU's kernel: run on a GPU where there is one, else by Triton's interpreter (conftest.py)."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from slicematch.network.aggregation import unit
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.pooling import _builds, pool_by_slice
from slicematch.scoring.scores import score_candidates

from slicemask import Frustum, PoseGrid, build_bank, open_bank

pytest.importorskip("triton")
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
CELLS = 8
HALF_WIDTH = 105.0  # of a heading prior, in degrees, that leaves masks of both ways to pool


@pytest.fixture
def pool_fused():
    from slicematch.scoring.pooling_triton import pool_fused

    return pool_fused


@pytest.fixture
def untried():
    """Nothing is known of the kernel, before the test and after it."""
    _builds.cache_clear()
    yield
    _builds.cache_clear()


def make(tmp_path, grid, frustum, channels):
    """Candidates, and of one pair d_g [N, C], z_a [L * L, C] and M_a [L * L, N]."""
    with open_bank(build_bank(PoseGrid.parse(grid), frustum, CELLS, cache=tmp_path).path) as bank:
        candidates = Candidates.from_bank(bank, DEVICE)
    generator = torch.Generator().manual_seed(0)
    ground = unit(torch.randn(frustum.slices, channels, generator=generator))
    features = torch.randn(CELLS * CELLS, channels, generator=generator)
    attention = torch.rand(CELLS * CELLS, frustum.slices, generator=generator)
    return candidates, [x.to(DEVICE) for x in (ground, features, attention)]


@pytest.mark.parametrize(
    ("grid", "frustum", "channels"),
    [
        ("1x2x32", Frustum(360, 16), 40),
        ("2x2x24", Frustum(360, 12), 300),
        ("2x2x6", Frustum(360, 24), 16),
        ("2x2x8", Frustum(360, 1), 3),
        ("2x3x8", Frustum(81.5, 5, "pinhole"), 33),
    ],
)
@pytest.mark.parametrize("half_width", [180.0, HALF_WIDTH])
def test_shares_are_those_of_the_plain_path(
    pool_fused, tmp_path, grid, frustum, channels, half_width
):
    candidates, (ground, features, attention) = make(tmp_path, grid, frustum, channels)
    plan = candidates.within(heading_prior=(0.0, half_width)).plans[0]
    expected = pool_by_slice(plan, ground, features, attention, values_at_once=1 << 20)
    dots = attention * (features @ ground.T)
    found = pool_fused(plan, features, attention, dots)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6)
    turned = (x.T.contiguous().T for x in (features, attention, dots))
    found = pool_fused(plan, *turned)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6)


def test_both_ways_to_pool_are_tried(tmp_path):
    candidates, _ = make(tmp_path, "1x2x32", Frustum(360, 16), 1)
    plan = candidates.within(heading_prior=(0.0, HALF_WIDTH)).plans[0]
    assert len(plan.many)
    assert any(len(rows) for rows, _ in plan.single)


def test_masks_and_descriptors_of_nothing_share_nothing(pool_fused, tmp_path):
    poses = [[1.0, 1.0, 135.0], [0.5, 0.5, 135.0]]  # in a corner and looking out, and not
    with open_bank(build_bank(poses, Frustum(60, 4), CELLS, cache=tmp_path).path) as bank:
        plan = Candidates.from_bank(bank, DEVICE).plans[0]
    features = torch.ones(CELLS * CELLS, 16, device=DEVICE)
    attention = torch.ones(CELLS * CELLS, 4, device=DEVICE)
    attention[:, 2] = 0
    contributions = pool_fused(plan, features, attention, attention)
    assert contributions[plan.slot.long()][..., 1].tolist() == [[0, 0, 0, 0], [1, 1, 0, 1]]
    assert (contributions[contributions[:, 1] == 0] == 0).all()
    assert torch.isfinite(contributions).all()


def test_scores_take_the_kernel_where_it_can_be_had(
    pool_fused, untried, tmp_path, monkeypatch, caplog
):
    from slicematch.scoring import pooling, pooling_triton

    candidates, (ground, features, attention) = make(tmp_path, "1x2x8", Frustum(360, 4), 20)
    inputs = ground[None], features.T.reshape(1, -1, CELLS, CELLS), attention.T.reshape(1, 4, 8, 8)
    used = []

    def watched(*arguments):
        plan = arguments[0]
        used.append((len(plan.many), sum(len(rows) for rows, _ in plan.single)))
        return pool_fused(*arguments)

    plain = score_candidates(*inputs, candidates, values_at_once=1 << 20)
    monkeypatch.setattr(
        pooling, "_has_kernel", lambda features, _: pooling._builds(features.device)
    )
    monkeypatch.setattr(pooling_triton, "pool_fused", watched)
    found = score_candidates(*inputs, candidates)
    score_candidates(inputs[0].clone().requires_grad_(), *inputs[1:], candidates)
    torch.testing.assert_close(found, plain, rtol=1e-4, atol=1e-6)
    # A trial of both ways to pool; and once, without gradients.
    plan = candidates.plans[0]
    assert used == [(1, 1), (len(plan.many), sum(len(rows) for rows, _ in plan.single))]

    def fails(*arguments):
        raise RuntimeError("Failed to find\n C compiler.")

    pooling._builds.cache_clear()
    monkeypatch.setattr(pooling_triton, "pool_fused", fails)
    for _ in range(2):
        torch.testing.assert_close(score_candidates(*inputs, candidates), plain)
    (said,) = caplog.messages
    assert f"scoring on {DEVICE}" in said
    assert "(Failed to find C compiler.)" in said

    def is_full(*arguments):
        raise torch.OutOfMemoryError("CUDA out of memory.")

    # Says nothing of the kernel.
    pooling._builds.cache_clear()
    monkeypatch.setattr(pooling_triton, "pool_fused", is_full)
    with pytest.raises(torch.OutOfMemoryError):
        score_candidates(*inputs, candidates)
    monkeypatch.setattr(pooling_triton, "pool_fused", watched)
    score_candidates(*inputs, candidates)
    assert len(used) == 4


COMPILE = """
import sys, triton
from triton.backends.compiler import GPUTarget
from slicematch.scoring import pooling_triton as kernel

slices, aligned = int(sys.argv[2]), sys.argv[3] == "aligned"
types = ["*i64", "*i32", "*i32", *["*fp32"] * 5, "i32", "i32", "i32", "fp32", *["constexpr"] * 3]
source = triton.compiler.ASTSource(
    kernel._pool,
    dict(zip(kernel._pool.arg_names, types, strict=True)),
    {"SLICES": slices, "CHANNELS": min(256, kernel._SUMS // slices), "CELLS": kernel._CELLS},
    {(i,): [["tt.divisibility", 16]] for i in range(11)} if aligned else {},
)
options = {"num_warps": kernel._WARPS, "num_stages": kernel._STAGES}
target = GPUTarget("cuda", int(sys.argv[1]), 32)
compiled = triton.compile(source, target=target, options=options)
assert compiled.asm["cubin"]
ptx = compiled.asm["ptx"]
print("mma.sync" in ptx or "wgmma" in ptx, compiled.metadata.shared)
"""


@pytest.mark.parametrize(
    ("slices", "pointers"), [(16, "aligned"), (64, "aligned"), (1, "aligned"), (1, "not aligned")]
)
@pytest.mark.parametrize("capability", [80, 90, 120])
def test_it_compiles_to_machine_code(tmp_path, capability, slices, pointers):
    """For A100, H100 and RTX 50; no GPU is needed for that."""
    ran = subprocess.run(
        [sys.executable, "-c", COMPILE, str(capability), str(slices), pointers],
        env={**os.environ, "TRITON_CACHE_DIR": str(tmp_path), "TRITON_INTERPRET": "0"},
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=True,
    )
    products, shared_bytes = ran.stdout.split()
    assert products == str(slices > 1)  # on tensor cores
    assert int(shared_bytes) <= 99 * 1024  # what each of them has for a block
