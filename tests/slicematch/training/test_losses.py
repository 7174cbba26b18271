"""Equation 1."""

import math

import numpy as np
import pytest
import torch
from slicematch.training.losses import contrastive_loss

TRUTH = [0.9, -0.2]
SCORES = [[0.1, 0.7, 0.3], [0.5, 0.0, -1.0]]


def loops_loss(truth, scores, alpha, tau):
    losses = []
    for c_gt, candidates in zip(truth, scores, strict=True):
        total = 0.0
        for c_k in candidates:
            total += math.exp(c_k / tau)
        weighted = alpha / len(candidates) * total
        losses.append(-math.log(math.exp(c_gt / tau) / (weighted + math.exp(c_gt / tau))))
    return losses


def as_tensors():
    return torch.tensor(TRUTH, dtype=torch.float64), torch.tensor(SCORES, dtype=torch.float64)


@pytest.mark.parametrize("alpha", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("tau", [0.05, 0.1, 1.0])
def test_it_reads_like_equation_1(alpha, tau):
    found = contrastive_loss(*as_tensors(), alpha=alpha, tau=tau)
    np.testing.assert_allclose(found, loops_loss(TRUTH, SCORES, alpha, tau), rtol=1e-12)


def test_alpha_of_k_is_plain_infonce():
    truth, scores = as_tensors()
    logits = torch.cat([truth[:, None], scores], dim=1) / 0.1
    expected = torch.nn.functional.cross_entropy(
        logits, torch.zeros(2, dtype=torch.int64), reduction="none"
    )
    torch.testing.assert_close(contrastive_loss(truth, scores, alpha=None, tau=0.1), expected)
    torch.testing.assert_close(contrastive_loss(truth, scores, alpha=3, tau=0.1), expected)


def test_gradients():
    truth, scores = (x.requires_grad_() for x in as_tensors())
    assert torch.autograd.gradcheck(contrastive_loss, (truth, scores))


def test_log_space_holds_where_the_exponentials_do_not():
    truth = torch.tensor([1.0, -1.0], requires_grad=True)
    scores = torch.tensor([[-1.0, -1.0], [1.0, 1.0]])
    loss = contrastive_loss(truth, scores, alpha=1.0, tau=1e-3)
    torch.testing.assert_close(loss.detach(), torch.tensor([0.0, 2000.0]))
    loss.sum().backward()
    assert torch.isfinite(truth.grad).all()


def test_candidates_left_out_do_not_count():
    truth, scores = as_tensors()
    padded = torch.cat([scores, torch.full((2, 2), -math.inf, dtype=torch.float64)], dim=1)
    padded.requires_grad_()
    loss = contrastive_loss(truth, padded)
    torch.testing.assert_close(loss, contrastive_loss(truth, scores))
    loss.sum().backward()
    assert (padded.grad[:, 3:] == 0).all()
