from .data.dataset import PoseDataset as PoseDataset
from .evaluation.evaluate import evaluate as evaluate
from .localization.estimate import Estimate as Estimate
from .localization.localizer import Localizer as Localizer
from .localization.locate import locate as locate
from .localization.photos import Priors as Priors
from .localization.predict import predict as predict
from .localization.predict_on_map import predict_on_map as predict_on_map
from .network.slicematch import SliceMatch as SliceMatch
from .runs.config import TrainConfig as TrainConfig
from .scoring.candidates import Candidates as Candidates
from .tracking.odometry import Odometry as Odometry
from .tracking.track import track as track
from .tracking.track_estimate import TrackEstimate as TrackEstimate
from .tracking.track_settings import TrackSettings as TrackSettings
from .tracking.tracker import Tracker as Tracker
from .training.train import train as train

__all__: list[str]
