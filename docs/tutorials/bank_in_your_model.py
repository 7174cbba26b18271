"""
Build a bank and use it in your own torch model
===============================================

You have a network of your own, and want it to compare a ground image with what lies in each
direction from many candidate poses. slicemask computes the geometry: which share of which aerial
cell lies in which slice of which pose. This page builds a bank of such masks, pools the features of
a small torch model under them, trains it, and then leaves the grid.

It needs ``slicemask`` and ``torch``, and runs in seconds.
"""

# %%
# A bank
# ------
#
# The candidates are a grid of poses: 12 rows, 12 columns and 16 headings. The camera sees all
# around, in 8 slices, and the aerial features will have 16 x 16 cells.

import torch

from slicemask import Frustum, PoseGrid, build_bank, open_bank, slice_masks
from slicemask.plot import draw_pose

grid = PoseGrid.parse("12x12x16")
frustum = Frustum(hfov_deg=360, slices=8)
built = build_bank(grid, frustum, cells=16, cache="masks_cache")
print(built.path.name)

with open_bank(built.path) as bank:
    rows = bank.csr()  # SciPy CSR [M, L * L]: each distinct mask once
    index = torch.from_numpy(bank.index[:]).long()  # [K, N]: which row is slice n of pose k
    poses = torch.from_numpy(bank.poses[:])  # [K, 3]: u, v, heading_deg
    one = bank.masks(grid.index(3, 8, 2))  # [N, L, L]
print(f"{index.numel():,} masks of {len(poses):,} poses, {rows.shape[0]:,} of them distinct")

# %%
# A pose of it: colours are the slices, and each small square is the mask of one. Cells on an edge
# hold the exact share that the slice covers.

figure = draw_pose(one, bank.spec.grid.poses()[grid.index(3, 8, 2)], frustum)

# %%
# Something to look at
# --------------------
#
# In place of photographs, so that this page needs no data: aerial images are smooth random colours,
# and a camera sees, in each of its slices, the mean colour of the land there, through a lens that
# mixes the channels, with noise. The masks of the true poses, which lie on no grid, come from
# ``slice_masks``: with ``engine="rays"`` it takes torch tensors.

torch.manual_seed(0)
lens = torch.randn(3, 3)


def look(poses, images):
    """Views [B, N, 3] of cameras at poses [B, 3] in images [B, 3, L, L]."""
    masks = slice_masks(poses, frustum, 16, engine="rays").float()  # [B, N, L, L]
    colours = torch.einsum("bnij,bcij->bnc", masks, images) / masks.sum((2, 3)).unsqueeze(-1)
    return colours @ lens + 0.02 * torch.randn(colours.shape)


def draw_pairs(count):
    """Images [B, 3, L, L], true poses [B, 3] and what the cameras there see."""
    coarse = torch.rand(count, 3, 6, 6)
    images = torch.nn.functional.interpolate(coarse, size=16, mode="bicubic")
    truths = torch.rand(count, 3, dtype=torch.float64)
    truths[:, :2] = 0.05 + 0.9 * truths[:, :2]
    truths[:, 2] *= 360
    return images, truths, look(truths, images)


# %%
# Pool features under every pose
# ------------------------------
#
# The model is yours: here, one convolution above and one linear map below. What slicemask adds is
# ``pooled = masks @ features``, a sparse product over the *distinct* masks, which ``index`` then
# lays out by pose and slice. It is differentiable.

masks = torch.sparse_csr_tensor(
    *map(torch.from_numpy, (rows.indptr, rows.indices, rows.data)), size=rows.shape
)
area = torch.from_numpy(rows.sum(axis=1).A1)[:, None]  # [M, 1]


class Matcher(torch.nn.Module):
    """Scores every pose of the bank for a view and an image."""

    def __init__(self, channels=16):
        super().__init__()
        self.above = torch.nn.Conv2d(3, channels, 3, padding=1)
        self.below = torch.nn.Linear(3, channels)

    def forward(self, view, image):
        """View [N, 3] and image [3, L, L] to scores [K]."""
        features = self.above(image)  # [C, L, L]
        pooled = masks @ features.flatten(1).T / area.clamp(min=1e-6)  # [M, C]
        descriptors = torch.nn.functional.normalize(pooled, dim=-1)[index]  # [K, N, C]
        seen = torch.nn.functional.normalize(self.below(view), dim=-1)  # [N, C]
        return torch.einsum("knc,nc->k", descriptors, seen) / len(seen)


# %%
# Train it
# --------
#
# The loss asks that the candidate nearest to the truth scores above all others.


def nearest(truths):
    """The candidate nearest to each true pose: int64 [B]."""
    place = (truths[:, None, :2] - poses[None, :, :2]).square().sum(-1)
    turn = (truths[:, None, 2] - poses[None, :, 2] + 180) % 360 - 180
    return (place / (1 / 12) ** 2 + (turn / 22.5) ** 2).argmin(dim=1)


model = Matcher()
optimiser = torch.optim.Adam(model.parameters(), lr=1e-2)
for step in range(121):
    images, truths, views = draw_pairs(8)
    scores = torch.stack([model(*pair) for pair in zip(views, images, strict=True)])
    loss = torch.nn.functional.cross_entropy(scores / 0.02, nearest(truths))
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
    if step % 40 == 0:
        print(f"step {step:3}: loss {loss.item():.2f}")

# %%
# Images that it has not seen
# ---------------------------


def errors(found, truths):
    """Median error of the place, in shares of the tile's side, and of the heading, in degrees."""
    place = (found[:, :2] - truths[:, :2]).norm(dim=1).median()
    turn = ((found[:, 2] - truths[:, 2] + 180) % 360 - 180).abs().median()
    return f"{place:.3f} of the tile's side, {turn:.1f} degrees"


images, truths, views = draw_pairs(40)
with torch.no_grad():
    scores = torch.stack([model(*pair) for pair in zip(views, images, strict=True)])
best = poses[scores.argmax(dim=1)]
print("chance:                ", errors(poses[torch.randint(len(poses), (40,))], truths))
print("best candidate:        ", errors(best, truths))
print("nearest one in the grid:", errors(poses[nearest(truths)], truths))

# %%
# No answer on this grid can be better than the nearest candidate.
#
# Off the grid
# ------------
#
# ``slice_masks`` has gradients in u, v and heading, so that a pose can be a parameter. From the
# best candidate, a few steps up the score:


def score_at(poses, views, images):
    """Scores [B] of one pose for each pair, with gradients in the poses."""
    exact = slice_masks(poses, frustum, 16, engine="rays").float()
    pooled = torch.einsum("bnij,bcij->bnc", exact, model.above(images))
    descriptors = torch.nn.functional.normalize(pooled, dim=-1)
    seen = torch.nn.functional.normalize(model.below(views), dim=-1)
    return (descriptors * seen).sum(-1).mean(-1)


offset = torch.zeros(40, 3, dtype=torch.float64, requires_grad=True)
scale = torch.tensor([1.0, 1.0, 360.0])
climber = torch.optim.Adam([offset], lr=3e-3)
for _ in range(40):
    moved = best + offset * scale
    moved = torch.cat([moved[:, :2].clamp(0, 1), moved[:, 2:]], dim=1)
    climber.zero_grad()
    (-score_at(moved, views, images).sum()).backward()
    climber.step()
print("refined:               ", errors(moved.detach(), truths))

# %%
# Where to go from here
# ---------------------
#
# - SliceMatch itself, with encoders, attention and its loss, is ``slicematch.SliceMatch``; it
#   scores ``slicematch.Candidates``, which are made from a bank, and is faster than the plain
#   product above (:doc:`/scoring`).
# - Slices may be cut into bands of range: ``Frustum(..., bands=(0.1, 0.3))`` (:doc:`/conventions`).
# - The file itself is documented, and is read with h5py alone: :doc:`/bank-format`.
