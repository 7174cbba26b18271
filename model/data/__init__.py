"""Data sets of ground and aerial images with known poses: VIGOR and KITTI."""

from model.data.errors import DataError, DatasetError, ImageError, SampleError
from model.data.images import denormalise, normalise, read_image
from model.data.kitti import KittiConfig, KittiDataset
from model.data.samples import BadSamples, DataConfig, PoseDataset, collate
from model.data.vigor import VigorConfig, VigorDataset

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
