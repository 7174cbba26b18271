"""The training loss: SliceMatch, CVPR 2023, eq. 1."""

import math

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812


def contrastive_loss(
    truth: Tensor, scores: Tensor, alpha: float | None = 4.0, tau: float = 0.1
) -> Tensor:
    """Loss of each pair, in log space.

    L = -log( exp(c_GT / tau) / ( alpha / K * sum_k exp(c_k / tau) + exp(c_GT / tau) ) )

    Parameters
    ----------
    truth : float [B]
        c_GT, the score of the exact ground-truth pose.
    scores : float [B, K]
        c_k, the scores of the candidates; -inf leaves one out, and K counts the others.
    alpha : float or None
        Weight of the candidates; None stands for K, which gives plain infoNCE.
    tau : float
        Temperature.

    Returns
    -------
    loss : float [B]

    Examples
    --------
    >>> round(contrastive_loss(torch.ones(1), torch.zeros(1, 2), alpha=1, tau=1).item(), 4)
    0.3133
    """
    log_weight: float | Tensor = 0.0
    if alpha is not None:
        count = torch.isfinite(scores).sum(dim=1).to(scores.dtype)
        log_weight = math.log(alpha) - count.log()
    candidates = log_weight + torch.logsumexp(scores / tau, dim=1)
    return F.softplus(candidates - truth / tau)
