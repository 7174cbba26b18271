"""SliceMatch with its loss and optimiser, as Lightning trains it."""

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor, nn

from slicemask import slice_masks
from slicematch import _torchvision  # noqa: F401  before lightning: see there
from slicematch.errors import RunError
from slicematch.evaluation.metrics import pose_errors
from slicematch.network.slicematch import SliceMatch
from slicematch.priors import PosePrior
from slicematch.runs.config import TrainConfig
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.scores import score_candidates, score_masks
from slicematch.training.losses import contrastive_loss
from slicematch.training.negatives import jittered_candidates, near_poses

import lightning.pytorch as lightning  # isort: skip
from lightning.pytorch.utilities.types import OptimizerLRScheduler  # isort: skip

if TYPE_CHECKING:
    from slicematch.training.loaders import PoseDataModule


class TrainingModule(lightning.LightningModule):
    """SliceMatch with its loss and optimiser.

    Parameters
    ----------
    config : TrainConfig
        With `hfov_deg` known.
    model : SliceMatch
        What is trained.
    train_candidates, test_candidates : Candidates
        Of the training and the test grid, within the priors.
    """

    def __init__(
        self,
        config: TrainConfig,
        model: SliceMatch,
        train_candidates: Candidates,
        test_candidates: Candidates,
    ) -> None:
        super().__init__()
        self.config = config
        self.model = model
        self.frustum = config.frustum()
        self.train_candidates = train_candidates
        self.test_candidates = test_candidates
        self.train_grid = config.grid("train_grid")
        self.prior = PosePrior(self.train_grid.extent, config.heading_prior(), config.place_prior)
        self.jittered_candidates: list[Candidates] = []
        if config.grid_jitter:
            self.jittered_candidates = jittered_candidates(
                train_candidates.poses,
                self.train_grid,
                self.prior,
                self.frustum,
                model.cells,
                config.seed,
            )
        self._estimates: list[tuple[Tensor, ...]] = []
        if config.freeze_encoders:
            for backbone in self._backbones():
                backbone.requires_grad_(False)

    def _backbones(self) -> list[nn.Module]:
        """Of both encoders."""
        return [self.model.ground_encoder.backbone, self.model.aerial_encoder.backbone]

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Adam, as in the paper, with its constant learning rate or the one-cycle schedule."""
        groups = self._parameter_groups()
        optimizer = torch.optim.Adam(groups)
        if self.config.schedule == "constant":
            return optimizer
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimizer,
            max_lr=[group["lr"] for group in groups],
            total_steps=int(self.trainer.estimated_stepping_batches),
            pct_start=0.1,
            cycle_momentum=False,  # the betas are Adam's own throughout
        )
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": "step"},
        }

    def _parameter_groups(self) -> list[dict[str, Any]]:
        """What trains, with its learning rate: all together, or encoders' backbones apart."""
        rate, encoder_rate = self.config.learning_rate, self.config.encoder_rate
        trained = [parameter for parameter in self.parameters() if parameter.requires_grad]
        if encoder_rate == 1.0 or self.config.freeze_encoders:
            return [{"params": trained, "lr": rate}]
        slow = {id(one) for backbone in self._backbones() for one in backbone.parameters()}
        return [
            {"params": [one for one in trained if id(one) not in slow], "lr": rate},
            {"params": [one for one in trained if id(one) in slow], "lr": rate * encoder_rate},
        ]

    def on_fit_start(self) -> None:
        """Bring the candidates to the model's device."""
        self.train_candidates = self.train_candidates.to(self.device)
        self.test_candidates = self.test_candidates.to(self.device)
        self.jittered_candidates = [some.to(self.device) for some in self.jittered_candidates]

    def on_train_epoch_start(self) -> None:
        """Let the epoch's draws depend on the seed and the epoch's number alone."""
        # Lightning sets it without declaring it.
        data: PoseDataModule = self.trainer.datamodule  # type: ignore[attr-defined]
        data.training.set_epoch(self.current_epoch)
        if self.config.freeze_encoders or self.config.freeze_statistics:
            for backbone in self._backbones():
                backbone.eval()  # so that the statistics of batches do not move
        state = [self.config.seed, self.current_epoch, self.global_rank]
        torch.manual_seed(int(np.random.SeedSequence(state).generate_state(1)[0]))

    def training_step(self, batch: dict[str, Any], _: int) -> Tensor:
        """Loss of a batch: the exact true pose against the training grid (eq. 1)."""
        ground = self.model.encode_ground(batch["ground"])
        aerial = self.model.encode_aerial(batch["aerial"])
        attention = self.model.attend(aerial, ground)
        masks = slice_masks(batch["pose"], self.frustum, self.model.cells, engine="rays")
        truth = score_masks(ground, aerial, attention, masks[:, None])[:, 0]
        scores = score_candidates(ground, aerial, attention, self._negatives())
        if self.config.near_negatives:
            near = near_poses(
                batch["pose"],
                self.config.near_negatives,
                self.train_grid,
                self.prior,
            )
            masks = slice_masks(near.flatten(0, 1), self.frustum, self.model.cells, engine="rays")
            masks = masks.unflatten(0, near.shape[:2])
            scores = torch.cat([scores, score_masks(ground, aerial, attention, masks)], dim=1)
        loss = contrastive_loss(truth, scores, self.config.alpha, self.config.tau).mean()
        self._check_finite("training loss", loss)
        self.log(
            "train/loss",
            loss,
            on_step=True,
            on_epoch=True,
            prog_bar=True,
            batch_size=len(ground),
            sync_dist=True,
        )
        return loss

    def _check_finite(self, what: str, values: Tensor) -> None:
        """Stop where numbers are finite no longer, before a checkpoint is written."""
        finite = bool(values.isfinite().all())
        # All devices stop together: one that went on would wait for the others for ever.
        if not self.trainer.strategy.reduce_boolean_decision(finite):
            raise RunError(
                f"the {what} of epoch {self.current_epoch} is not finite: training with "
                f"learning_rate {self.config.learning_rate:g} has diverged; the checkpoints of "
                "epochs before, if any, are kept; train into another folder with a lower "
                "learning_rate"
            )

    def _negatives(self) -> Candidates:
        """The training grid, or one of its offsets at random."""
        if not self.jittered_candidates:
            return self.train_candidates
        count = len(self.jittered_candidates)
        return self.jittered_candidates[int(torch.randint(count, ()))]

    def validation_step(self, batch: dict[str, Any] | None, _: int) -> None:
        """Estimates of a batch on the test grid."""
        if batch is None:  # no sample of it could be read
            return
        scores = self.model(batch["ground"], batch["aerial"], self.test_candidates)
        best = scores.max(dim=1)
        estimates = torch.from_numpy(self.test_candidates.poses)[best.indices.cpu()]
        metres = batch["metres_per_pixel"].cpu() * batch["aerial"].shape[-1]
        self._estimates.append((best.values.cpu(), estimates, batch["pose"].cpu(), metres))

    def on_validation_epoch_end(self) -> None:
        """Log mean and median errors."""
        if not self._estimates:
            return
        scores, estimates, truths, metres = (
            torch.cat(parts) for parts in zip(*self._estimates, strict=True)
        )
        self._estimates.clear()
        self._check_finite("validation score", scores)
        found = pose_errors(estimates.numpy(), truths.numpy(), metres.numpy()).summary()
        for name, value in found.items():
            if "recall" not in name:
                self.log(
                    f"validation/{name}",
                    value,
                    prog_bar=name == "place_mean_m",
                    batch_size=len(truths),
                    sync_dist=True,
                )
