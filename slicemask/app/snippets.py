"""The Python line and the command that make the masks which a page shows."""

from slicemask.geometry.frustum import Frustum


def python_line(pose: tuple[float, float, float], frustum: Frustum, cells: int) -> str:
    """Python that computes the masks of a pose.

    Examples
    --------
    >>> print(python_line((0.5, 0.5, 90.0), Frustum(90.0, 4, "pinhole", (0.1,)), 32))
    from slicemask import Frustum, slice_masks
    frustum = Frustum(90, 4, "pinhole", bands=(0.1,))
    masks = slice_masks([[0.5, 0.5, 90]], frustum, cells=32, engine="rays")[0]
    """
    parts = [f"{frustum.hfov_deg:g}", str(frustum.slices)]
    if frustum.projection != "equirectangular":
        parts.append(f'"{frustum.projection}"')
    if frustum.bands:
        only = "," if len(frustum.bands) == 1 else ""
        parts.append(f"bands=({_listed(frustum.bands)}{only})")
    return (
        "from slicemask import Frustum, slice_masks\n"
        f"frustum = Frustum({', '.join(parts)})\n"
        f"masks = slice_masks([[{_listed(pose, ', ')}]], frustum, cells={cells}, "
        'engine="rays")[0]'
    )


def command_line(pose: tuple[float, float, float], frustum: Frustum, cells: int) -> str:
    """The command that draws the masks of a pose.

    Examples
    --------
    >>> print(command_line((0.5, 0.5, 90.0), Frustum(90.0, 4, "pinhole", (0.1,)), 32))
    slicemask visualize --at 0.5,0.5,90 --hfov 90 --projection pinhole --slices 4 --bands 0.1 \
--cells 32
    """
    bands = f" --bands {_listed(frustum.bands, ',')}" if frustum.bands else ""
    return (
        f"slicemask visualize --at {_listed(pose, ',')} --hfov {frustum.hfov_deg:g} "
        f"--projection {frustum.projection} --slices {frustum.slices}{bands} --cells {cells}"
    )


def bank_command_line(grid: str, frustum: Frustum, cells: int) -> str:
    """The command that builds the bank of a grid.

    Examples
    --------
    >>> print(bank_command_line("21x21x64", Frustum(), 32))
    slicemask build --grid 21x21x64 --hfov 360 --projection equirectangular --slices 16 --cells 32
    """
    bands = f" --bands {_listed(frustum.bands, ',')}" if frustum.bands else ""
    return (
        f"slicemask build --grid {grid} --hfov {frustum.hfov_deg:g} "
        f"--projection {frustum.projection} --slices {frustum.slices}{bands} --cells {cells}"
    )


def _listed(numbers: tuple[float, ...], separator: str = ", ") -> str:
    return separator.join(f"{number:.10g}" for number in numbers)
