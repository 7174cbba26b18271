"""Which pictures of a tutorial's block the site shows: figures and images that it leaves in a name.

slicemask draws figures that are bound to no window, which sphinx-gallery's own scraper does not
see.
"""

from typing import Any

from matplotlib.figure import Figure
from PIL import Image
from sphinx_gallery.scrapers import figure_rst

_DOTS_PER_INCH = 110


# Pictures that have been shown: kept alive, so that no other object can have the id of one.
_shown: list[Any] = []


def _show_new(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save what a block has newly assigned to a name, in the order of the names."""
    paths = []
    for value in block_vars["example_globals"].values():
        shown_before = any(value is shown for shown in _shown)
        if not isinstance(value, Figure | Image.Image) or shown_before:
            continue
        _shown.append(value)
        paths.append(next(block_vars["image_path_iterator"]))
        if isinstance(value, Figure):
            value.savefig(paths[-1], dpi=_DOTS_PER_INCH)
        else:
            value.save(paths[-1])
    return str(figure_rst(paths, gallery_conf["src_dir"]))


def _get_sg_image_scraper() -> Any:
    return _show_new
