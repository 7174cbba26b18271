"""Slice masks of poses, by either engine."""

import logging
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from types import ModuleType
from typing import Any, Literal, cast, get_args

import array_api_compat
import numpy as np
from numpy.typing import NDArray

from slicemask.errors import PoseError, SpecError
from slicemask.geometry.frustum import Frustum
from slicemask.geometry.noise import NEGLIGIBLE, remove_noise
from slicemask.geometry.numbers import is_whole
from slicemask.geometry.poses import check_poses

Engine = Literal["shapely", "rays"]

log = logging.getLogger(__name__)

# Slices computed before they are cleaned, by their cells; but never so few at once that calls would
# cost more than arithmetic.
_CELLS_AT_ONCE = 1 << 19
_LEAST_SECTORS = 64


def check_engine(engine: str) -> Engine:
    """Return the engine's name, or raise SpecError if there is none of that name."""
    if engine not in get_args(Engine):
        raise SpecError(f"engine is {engine!r}; it must be one of {', '.join(get_args(Engine))}")
    return cast(Engine, engine)


def check_cells(cells: int) -> int:
    """Return the cells a side, L, or raise SpecError if it is not a whole number in 1..8192."""
    if not is_whole(cells) or not 1 <= cells <= 8192:
        raise SpecError(f"cells is {cells!r}; it must be a whole number from 1 to 8192")
    return int(cells)


def engine_fractions(engine: Engine, frustum: Frustum) -> Callable[..., Any]:
    """The engine's function of sectors' fractions; each engine's module is loaded on first use.

    It takes u, v, left_deg, right_deg and heading_deg [S] and the cells, and gives [S, B, L, L].
    """
    module: Any
    if engine == "rays":
        from slicemask.geometry import rays as module
    else:
        from slicemask.geometry import coverage as module

    def fractions(
        u: Any, v: Any, left_deg: Any, right_deg: Any, heading_deg: Any, cells: int, **options: Any
    ) -> Any:
        if not frustum.bands:
            whole = module.sector_fractions(u, v, left_deg, right_deg, cells, **options)
            return whole[:, None, :, :]
        depth_along = heading_deg if frustum.projection == "pinhole" else None
        return module.banded_fractions(
            u, v, left_deg, right_deg, cells, frustum.bands, depth_along, **options
        )

    return fractions


def slice_masks(
    poses: Any, frustum: Frustum, cells: int, engine: Engine = "shapely", out: Any = None
) -> Any:
    """Exact slice masks of poses (P of SliceMatch, CVPR 2023, eq. 4).

    Parameters
    ----------
    poses : array [K, 3]
        u, v in [0, 1] of the aerial frame and heading_deg, clockwise from north.
    frustum : Frustum
        Field of view, its N slices and their B bands.
    cells : int
        L, the cells along each side of the tile.
    engine : {"shapely", "rays"}
        Polygons and intersections, or the closed form. They agree to 1e-9, and to 1e-6 in cells
        that a circle between bands crosses, which is a polygon to the former. With "rays", poses
        may be any array of the Python array API standard, such as a torch tensor on any device:
        the masks are then of its kind and dtype (float32 or float64; computed in float64), with
        gradients in u, v and heading_deg. A NumPy array must hold at least one pose; other
        arrays may hold none. Where numba is installed, two or more NumPy poses are done in compiled
        loops, two to six times as fast; the first call compiles or loads them.
    out : float64 [K, N, L, L] or [K, N, B, L, L], optional
        A NumPy array in C order that the masks are written to, and that is returned: for loops,
        since memory that is used again takes less time than fresh memory. NumPy's poses only.

    Returns
    -------
    masks : float64 [K, N, L, L], or [K, N, B, L, L] where the frustum has bands
        The share of cell (row, column) that slice n (band b of it) of pose k covers, in [0, 1]; an
        all-zero mask where it misses the tile. The bands of a slice sum to the slice. Rounding
        noise is removed: what is below 1e-10 is 0.
        NumPy results are 1 within 1e-10 of it, too; others may exceed 1 by some 1e-13 (float64).

    Raises
    ------
    PoseError
        If a pose lies outside the tile or is not finite; the message names it.
    SpecError
        If the cells, the engine or the array for the masks are invalid.

    Examples
    --------
    >>> masks = slice_masks([[0.5, 0.5, 45.0]], Frustum(hfov_deg=90, slices=1), cells=2)
    >>> masks[0, 0].tolist()
    [[0.0, 1.0], [0.0, 0.0]]
    >>> slice_masks([[0.5, 0.5, 45.0]], Frustum(90, 1, bands=(0.25,)), cells=2).shape
    (1, 1, 2, 2, 2)
    """
    cells, engine = check_cells(cells), check_engine(engine)
    if array_api_compat.is_array_api_obj(poses) and not array_api_compat.is_numpy_array(poses):
        if engine != "rays":
            raise SpecError(
                f"the {engine} engine takes NumPy arrays; for other arrays use engine='rays'"
            )
        if out is not None:
            raise SpecError("out is for poses that are NumPy arrays; leave it out for others")
        return _rays_of_any_array(poses, frustum, cells)
    checked = check_poses(poses)
    masks = _array_for_masks((len(checked), *frustum.mask_axes, cells, cells), out)
    # For the masks of a single pose, as pages draw, it would not pay to load what is compiled.
    compiled = _compiled() if engine == "rays" and len(checked) > 1 else None
    if compiled is not None and compiled.takes(frustum):
        shape = (len(checked), frustum.slices, frustum.band_count, cells, cells)
        compiled.write_masks(checked, frustum, masks.reshape(shape))
        return masks
    edges = frustum.edges_deg(checked[:, 2])
    u, v, heading_deg = (np.repeat(checked[:, axis], frustum.slices) for axis in range(3))
    left, right = edges[:, :-1].ravel(), edges[:, 1:].ravel()
    fractions = engine_fractions(engine, frustum)
    flat = masks.reshape(len(u), frustum.band_count, cells, cells)
    options: dict[str, Any] = {}
    if engine == "rays":
        options["widest_deg"] = float(np.diff(frustum.edge_offsets_deg()).max()) + 1e-9
    # Cleaned while they are in the processor's cache.
    step = max(_LEAST_SECTORS, _CELLS_AT_ONCE // cells**2)
    for start in range(0, len(u), step):
        some = slice(start, start + step)
        part = flat[some]
        if engine == "rays":
            options["out"] = part if frustum.bands else part[:, 0]
        found = fractions(u[some], v[some], left[some], right[some], heading_deg[some], cells,
                          **options)  # fmt: skip
        if engine != "rays":
            part[:] = found
        if engine != "rays" or not frustum.bands:  # those are cleaned where they are not empty
            remove_noise(part)
    return masks


@cache
def _compiled() -> ModuleType | None:
    """The compiled closed form, or None where numba is missing, fails or is switched off."""
    if find_spec("numba") is None:
        return None
    try:
        import numba

        from slicemask.geometry import compiled

        if getattr(numba.config, "DISABLE_JIT", False):
            return None
        compiled.write_masks(np.full((1, 3), 0.5), Frustum(), np.empty((1, 16, 1, 1, 1)))
    # It does not take every NumPy, needs a folder that it can write to, and trips over what is
    # broken there in many ways; masks need none of it.
    except Exception as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        log.warning("numba cannot be used, so slice masks take longer: %s", reason)
        return None
    return compiled


def _array_for_masks(shape: tuple[int, ...], out: Any) -> NDArray[np.float64]:
    """The array that was given for masks of a shape, checked, or else a new one."""
    if out is None:
        return np.empty(shape)
    if not isinstance(out, np.ndarray):
        raise SpecError(f"out is a {type(out).__name__}; it must be a NumPy array")
    if out.shape != shape or out.dtype != np.float64 or not out.flags.c_contiguous:
        raise SpecError(
            f"out is {out.dtype} {list(out.shape)}; it must be float64 {list(shape)}, in C order"
        )
    if not out.flags.writeable:
        raise SpecError("out is read-only; it must be an array that can be written to")
    return out


def _rays_of_any_array(poses: Any, frustum: Frustum, cells: int) -> Any:
    """`slice_masks` in closed form, in the namespace, dtype and device of the poses."""
    xp = array_api_compat.array_namespace(poses)
    if poses.ndim != 2 or poses.shape[1] != 3:
        raise PoseError(
            f"poses have shape {list(poses.shape)}; they must be [K, 3]: u, v, heading_deg"
        )
    dtype = poses.dtype
    if dtype not in (xp.float32, xp.float64):
        raise PoseError(f"poses are {dtype}; they must be float32 or float64")
    poses = xp.astype(poses, xp.float64)
    places = poses[:, :2]
    inside = xp.all((places >= 0.0) & (places <= 1.0), axis=1)
    valid = inside & xp.all(xp.isfinite(poses), axis=1)
    if not bool(xp.all(valid)):
        k = next(k for k in range(poses.shape[0]) if not bool(valid[k]))
        u, v, heading = (float(poses[k, axis]) for axis in range(3))
        raise PoseError(
            f"pose {k} is outside the tile or not finite: u={u:g}, v={v:g}, "
            f"heading_deg={heading:g}; u and v must lie in [0, 1]"
        )
    offsets = xp.asarray(
        frustum.edge_offsets_deg(), dtype=poses.dtype, device=array_api_compat.device(poses)
    )
    edges = poses[:, 2:3] + offsets[None, :]
    shape = (poses.shape[0], frustum.slices)
    u, v, heading_deg = (
        xp.reshape(xp.broadcast_to(poses[:, a : a + 1], shape), (-1,)) for a in range(3)
    )
    left, right = (xp.reshape(side, (-1,)) for side in (edges[:, :-1], edges[:, 1:]))
    widest_deg = float(np.diff(frustum.edge_offsets_deg()).max())
    fractions = engine_fractions("rays", frustum)(
        u, v, left, right, heading_deg, cells, widest_deg=widest_deg
    )
    fractions = xp.where(fractions < NEGLIGIBLE, xp.zeros_like(fractions), fractions)
    shape = (poses.shape[0], *frustum.mask_axes, cells, cells)
    return xp.astype(xp.reshape(fractions, shape), dtype)
