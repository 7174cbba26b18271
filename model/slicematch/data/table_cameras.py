"""Which camera took each photograph of a table."""

from typing import NamedTuple

from slicematch.data.cameras import Camera, load_cameras
from slicematch.data.photographs import Photographs

FILE = "cameras.yaml"
# What a photograph is whose table names no camera.
PANORAMA = "panorama"


class TableCameras(NamedTuple):
    """The cameras of a table.

    Attributes
    ----------
    by_name : dict of str to Camera
        Those of ``cameras.yaml``, or a whole panorama.
    of_rows : list of str
        The name of each row's camera.
    """

    by_name: dict[str, Camera]
    of_rows: list[str]


def table_cameras(photographs: Photographs) -> TableCameras:
    """The cameras of a table, from ``cameras.yaml`` beside it.

    Without that file all photographs are whole panoramas. Where it holds one camera, a row need not
    name it.

    Raises
    ------
    DatasetError
        If the file is unreadable, or a row names no camera of it.
    """
    path = photographs.file.path.parent / FILE
    by_name = {PANORAMA: Camera(projection="equirectangular")}
    if path.exists():
        by_name = load_cameras(path)
    only = next(iter(by_name)) if len(by_name) == 1 else None
    of_rows = []
    for row, name in enumerate(photographs.camera):
        found = only if name is None else name
        if found is None or found not in by_name:
            beside = f"in {path}" if path.exists() else f"as there is no {path}"
            expected = f"one of {', '.join(by_name)}, {beside}"
            raise photographs.wrong(row, "camera", expected)
        of_rows.append(found)
    return TableCameras(by_name, of_rows)
