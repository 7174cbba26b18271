from .generate import SynthResult as SynthResult
from .generate import generate_kitti as generate_kitti
from .generate import generate_vigor as generate_vigor
from .generate_drive import generate_drive as generate_drive
from .generate_table import generate_table as generate_table

__all__: list[str]
