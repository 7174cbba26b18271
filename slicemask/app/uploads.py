"""Files that a browser sends: bounded in size, and read by the one reader of images."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import panel as pn
from PIL import Image

from slicemask.errors import ImageError
from slicemask.images import read_image

# As large as a panorama of 8192x4096 pixels or a tile of 4096x4096 is as a file.
MOST_BYTES = 32_000_000
_TYPES = ["image/jpeg", "image/png", "image/webp", "image/bmp", "image/tiff"]


def read_upload(content: bytes | str, name: str) -> Image.Image:
    """Read an image that was uploaded, as `slicemask.images.read_image` reads files.

    Parameters
    ----------
    content : bytes or str
        The file's; str, where the browser took it for text.
    name : str
        What the user calls it, for messages. No file of that name is opened.

    Returns
    -------
    PIL.Image.Image
        Mode RGB, upright.

    Raises
    ------
    ImageError
        If it is too large or no image that is read.
    """
    if isinstance(content, str):
        content = content.encode()
    shown = name if len(name) <= 80 else f"{name[:77]}..."
    if len(content) > MOST_BYTES:
        raise ImageError(
            f"{shown}: has {len(content) / 1e6:.1f} MB; {MOST_BYTES / 1e6:.0f} MB are taken at "
            "most: make the image smaller"
        )
    with TemporaryDirectory(prefix="slicemask-") as folder:
        path = Path(folder, "upload")
        path.write_bytes(content)
        try:
            return read_image(path)
        except ImageError as error:
            raise ImageError(str(error).replace(str(path), shown)) from None


class ImageDropper(pn.widgets.FileDropper):  # type: ignore[misc]
    """A place to drop or choose one image; what a browser sends beyond the bound is not kept."""

    def __init__(self, **params: Any) -> None:
        super().__init__(
            accepted_filetypes=_TYPES,
            max_file_size=f"{MOST_BYTES // 1_000_000}MB",
            max_files=1,
            multiple=False,
            previews=[],
            sizing_mode="stretch_width",
            width=None,
            **params,
        )

    def _process_event(self, event: Any) -> None:
        # The page's own check can be passed by: the chunks of a file are counted here, too.
        if event.event_name == "upload_event":
            for name in [name for name in self._file_buffer if name != event.data["name"]]:
                del self._file_buffer[name]
            held = sum(map(len, self._file_buffer.get(event.data["name"], [])))
            if event.data["chunk"] != 1 and held + len(event.data["data"]) > MOST_BYTES:
                self._file_buffer[event.data["name"]] = []
                return
        super()._process_event(event)

    def last(self) -> tuple[str, bytes | str] | None:
        """Name and content of the file that was dropped last; None if it was taken away."""
        if not self.value:
            return None
        name = list(self.value)[-1]
        return name, self.value[name]
