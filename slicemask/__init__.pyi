from ._version import __version__ as __version__
from .bank.build import BuildResult as BuildResult
from .bank.build import build_bank as build_bank
from .bank.read import Bank as Bank
from .bank.read import open_bank as open_bank
from .bank.spec import BankSpec as BankSpec
from .errors import BankError as BankError
from .errors import BankExistsError as BankExistsError
from .errors import BankFormatError as BankFormatError
from .errors import PlotError as PlotError
from .errors import PoseError as PoseError
from .errors import SlicemaskError as SlicemaskError
from .errors import SpecError as SpecError
from .geometry.frustum import Frustum as Frustum
from .geometry.masks import slice_masks as slice_masks
from .geometry.poses import PoseGrid as PoseGrid
from .geometry.poses import read_poses as read_poses

__all__: list[str]
