"""Data sets of ground and aerial images with known poses: VIGOR and KITTI."""

from slicematch.data.dataset import BadSamples, DataConfig, PoseDataset, collate
from slicematch.data.errors import DataError, DatasetError, ImageError, SampleError
from slicematch.data.images import denormalise, normalise, read_image
from slicematch.data.kitti import KittiConfig, KittiDataset
from slicematch.data.vigor import VigorConfig, VigorDataset

__all__ = [
    "BadSamples",
    "DataConfig",
    "DataError",
    "DatasetError",
    "ImageError",
    "KittiConfig",
    "KittiDataset",
    "PoseDataset",
    "SampleError",
    "VigorConfig",
    "VigorDataset",
    "collate",
    "denormalise",
    "normalise",
    "read_image",
]
