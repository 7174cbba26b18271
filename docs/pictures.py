"""Which pictures of a tutorial's block the site shows: figures and images that it leaves in a name.

slicemask draws figures that are bound to no window, which sphinx-gallery's own scraper does not
see.
"""

from typing import Any

from matplotlib.figure import Figure
from PIL import Image
from sphinx_gallery.scrapers import figure_rst

_DOTS_PER_INCH = 110


class _Scraper:
    """Saves what a block has newly assigned, in the order of the names."""

    def __init__(self) -> None:
        self._seen: list[Any] = []  # kept alive, so that no other object can have its id

    def __call__(self, block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
        paths = block_vars["image_path_iterator"]
        found = []
        for value in block_vars["example_globals"].values():
            known = any(value is seen for seen in self._seen)
            if not isinstance(value, Figure | Image.Image) or known:
                continue
            self._seen.append(value)
            path = next(paths)
            if isinstance(value, Figure):
                value.savefig(path, dpi=_DOTS_PER_INCH)
            else:
                value.save(path)
            found.append(path)
        return str(figure_rst(found, gallery_conf["src_dir"]))


def _get_sg_image_scraper() -> _Scraper:
    return _Scraper()
