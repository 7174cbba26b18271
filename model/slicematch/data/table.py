"""A table of photographs: data of one's own.

One row a photograph: its file, its heading, and where it was taken: u, v in an aerial tile; a
latitude and longitude in a tile whose centre is known; or those alone, with a map.
"""

import functools
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicemask.images import read_aerial
from slicematch.data.elevations import crop_elevations
from slicematch.data.errors import DatasetError, SampleError
from slicematch.data.panoramas import draw_heading_deg, read_panorama, turn_panorama
from slicematch.data.photographs import Photographs, read_photographs
from slicematch.data.source import DataConfig, Part, Source
from slicematch.data.table_files import find_table
from slicematch.data.windows import cut_window, place_window

log = logging.getLogger(__name__)
