"""What a bank holds, and the name that says so."""

import hashlib
import json
import math
import re
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slicemask.errors import BankFormatError, SpecError
from slicemask.geometry.frustum import Frustum
from slicemask.geometry.masks import Engine, check_cells, check_engine
from slicemask.geometry.poses import PoseGrid


@dataclass(frozen=True)
class PoseDigest:
    """What identifies a list of poses.

    Parameters
    ----------
    count : int
        Number of poses K, at least 1.
    sha256 : str
        SHA-256 of the poses as little-endian float64 [K, 3], in hexadecimal.

    Raises
    ------
    SpecError
        If a value is invalid.
    """

    count: int
    sha256: str

    def __post_init__(self) -> None:
        if not (isinstance(self.count, int) and 1 <= self.count < 2**31):
            raise SpecError(f"the count of poses is {self.count!r}; it must be 1 to 2^31 - 1")
        if not (isinstance(self.sha256, str) and re.fullmatch("[0-9a-f]{64}", self.sha256)):
            raise SpecError(f"sha256 is {self.sha256!r}; it must be 64 hexadecimal digits")

    @classmethod
    def of(cls, poses: NDArray[np.float64]) -> "PoseDigest":
        """Return the digest of checked poses, float64 [K, 3]."""
        return cls(len(poses), hashlib.sha256(poses.astype("<f8").tobytes()).hexdigest())

    def __len__(self) -> int:
        return self.count

    def __str__(self) -> str:
        return f"{self.count} poses"


@dataclass(frozen=True)
class BankSpec:
    """Everything needed to build a bank again.

    Parameters
    ----------
    poses : PoseGrid or PoseDigest
        The candidate poses: a grid, or the digest of a list.
    frustum : Frustum
        Field of view, slices and bands.
    cells : int
        L, the cells along each side of the tile, 1 to 8192.
    engine : {"shapely", "rays"}
        What computed the masks.
    versions : dict of str
        Versions of the software that wrote the bank. They do not count when specs are compared.

    Raises
    ------
    SpecError
        If a value is out of its range, or there are more masks than a bank can number.
    """

    poses: PoseGrid | PoseDigest
    frustum: Frustum = field(default_factory=Frustum)
    cells: int = 32
    engine: Engine = "shapely"
    versions: dict[str, str] = field(default_factory=dict, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cells", check_cells(self.cells))
        check_engine(self.engine)
        # The product of the shape, since a length beyond 63 bits is an error of Python's.
        count = math.prod(self.grid.shape) if self.grid is not None else len(self.poses)
        masks = count * math.prod(self.frustum.mask_axes)
        if masks >= 2**31:
            bands = f" of {self.frustum.band_count} bands" if self.frustum.bands else ""
            raise SpecError(
                f"{self.poses} with {self.frustum.slices} slices{bands} make {masks:,} masks; a "
                "bank numbers them with 31 bits: choose fewer poses, slices or bands"
            )
        if not all(isinstance(text, str) for pair in self.versions.items() for text in pair):
            raise SpecError(f"versions are {self.versions!r}; they must be text by name")

    @property
    def grid(self) -> PoseGrid | None:
        """The pose grid, or None for a list of poses."""
        return self.poses if isinstance(self.poses, PoseGrid) else None

    @property
    def version(self) -> int:
        """Version of the format that the bank is written in.

        It is 3 where the principal point is off the centre, else 2 with bands, else 1.
        """
        if self.frustum.left_deg is not None:
            return 3
        return 2 if self.frustum.bands else 1

    def to_json(self) -> str:
        """The spec as JSON text, keys sorted.

        The frustum has "bands" only if there are any, and "left_deg" only if it is not centred.
        """
        poses = "grid" if isinstance(self.poses, PoseGrid) else "poses"
        content = asdict(self)
        if not self.frustum.bands:
            del content["frustum"]["bands"]
        if self.frustum.left_deg is None:
            del content["frustum"]["left_deg"]
        content[poses] = content.pop("poses")
        return json.dumps(content, sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> "BankSpec":
        """Read a spec from the JSON of `to_json`.

        Raises
        ------
        BankFormatError
            If the text is not such JSON.
        """
        try:
            content: dict[str, Any] = json.loads(text)
            poses: PoseGrid | PoseDigest
            if "grid" in content:
                grid = content.pop("grid")
                poses = PoseGrid(**{**grid, "extent": tuple(grid["extent"])})
            else:
                poses = PoseDigest(**content.pop("poses"))
            return cls(poses=poses, frustum=Frustum(**content.pop("frustum")), **content)
        except (
            ValueError,
            TypeError,
            KeyError,
            AttributeError,
            OverflowError,
            RecursionError,
        ) as error:
            raise BankFormatError(f"the spec cannot be read ({error})") from error

    def name(self) -> str:
        """File name of the bank, such as ``21x21x64_hfov360_n16_l32.h5``."""
        if isinstance(self.poses, PoseGrid):
            parts = [str(self.poses)]
            if self.poses.extent != (0.0, 0.0, 1.0, 1.0):
                parts.append("extent" + "-".join(map(_plain, self.poses.extent)))
            if self.poses.places != "centres":
                parts.append(self.poses.places)
        else:
            parts = [f"poses{self.poses.count}-{self.poses.sha256[:8]}"]
        parts.append(f"hfov{_plain(self.frustum.hfov_deg)}")
        if self.frustum.left_deg is not None:
            parts.append(f"left{_plain(self.frustum.left_deg)}")
        if self.frustum.projection != "equirectangular":
            parts.append(self.frustum.projection)
        parts.append(f"n{self.frustum.slices}")
        if self.frustum.bands:
            parts.append("bands" + "-".join(map(_plain, self.frustum.bands)))
        parts.append(f"l{self.cells}")
        if self.engine != "shapely":
            parts.append(self.engine)
        return "_".join(parts) + ".h5"

    def summary(self) -> str:
        """One line that says what the bank holds, for messages and titles."""
        frustum = self.frustum
        words = [
            str(self.poses),
            f"hfov {_plain(frustum.hfov_deg)} deg"
            + (f" from {_plain(frustum.left_deg)}" if frustum.left_deg is not None else "")
            + f" {frustum.projection}",
            f"{frustum.slices} slices"
            + (f" with bands at {','.join(map(_plain, frustum.bands))}" if frustum.bands else ""),
            f"{self.cells}x{self.cells} cells",
            f"engine {self.engine}",
        ]
        if isinstance(self.poses, PoseGrid):
            if self.poses.extent != (0.0, 0.0, 1.0, 1.0):
                words.insert(1, "extent " + ",".join(map(_plain, self.poses.extent)))
            if self.poses.places != "centres":
                words.insert(1, self.poses.places)
        else:
            words[0] += f" ({self.poses.sha256[:8]})"
        return ", ".join(words)


def _plain(value: float) -> str:
    """A number as a person writes it."""
    return f"{value:.12g}"
