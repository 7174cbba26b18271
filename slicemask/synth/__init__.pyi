from .generate import SynthResult as SynthResult
from .generate import generate_kitti as generate_kitti
from .generate import generate_vigor as generate_vigor

__all__ = ["SynthResult", "generate_kitti", "generate_vigor"]
