"""Settings of the documentation's site, which `make docs` builds into build/docs."""

import sys
import warnings
from pathlib import Path

import numpydoc.xref
import slicematch
import slicematch.errors

import slicemask
import slicemask.errors

sys.path.insert(0, str(Path(__file__).parent))  # where pictures.py is
# torch says at length that its CSR tensors are in beta.
warnings.filterwarnings("ignore", message="Sparse")

project = "slicemask"
author = "slicemask developers"
copyright = "slicemask developers, Apache-2.0"  # noqa: A001
release = version = slicemask.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_click",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["README.rst", "tutorials", "gallery", "**/GALLERY_HEADER.rst"]
templates_path = ["_templates"]
# A link that leads nowhere is a warning, and a warning ends the build.
nitpicky = True
# In docstrings, single backticks are links where the reference documents the name, and code where
# it does not: parameters, attributes, inner modules. tests/test_readme.py holds our dotted ones.
default_role = "py:obj"
nitpick_ignore_regex = [("py:obj", ".*")]
highlight_language = "none"
smartquotes = False  # quotes in docstrings are Python's

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3

autosummary_generate = True
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "none"  # types, shapes and units stand in the docstrings
numpydoc_show_class_members = False
# Of the types in docstrings, which are prose, our own names are links. Those of Python and NumPy
# are not: where they lead is looked up in the network, and the site is built without one.
numpydoc_xref_param_type = True
numpydoc_xref_ignore = "all"
numpydoc.xref.DEFAULT_LINKS.clear()
numpydoc_xref_aliases = {
    name: f"{module.__name__}.{name}"
    for module in (slicemask.errors, slicematch.errors, slicemask, slicematch)
    for name in getattr(module, "__all__", vars(module))
    if name[0].isupper()
}

sphinx_gallery_conf = {
    "examples_dirs": ["tutorials", "gallery"],
    "gallery_dirs": ["auto_tutorials", "auto_gallery"],
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": ("pictures",),
    "reset_modules": (),
    "capture_repr": (),
    "abort_on_example_error": True,
    "doc_module": ("slicemask", "slicematch"),
    "download_all_examples": False,
    "write_computation_times": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1,
    "remove_config_comments": True,
    "plot_gallery": "True",
}

html_theme = "pydata_sphinx_theme"
html_title = "slicemask"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "github_url": "https://github.com/slicemask/slicemask",
    "logo": {"text": f"slicemask {release}"},
    "navbar_end": ["theme-switcher", "navbar-icon-links"],
    "show_prev_next": False,
    "show_toc_level": 2,
    "header_links_before_dropdown": 7,
    "secondary_sidebar_items": ["page-toc", "sg_download_links"],
}
html_sidebars = {"index": [], "start": []}
copybutton_prompt_text = "$ "

# `make linkcheck`: pages that refuse programs, and those of the repository itself, which exist only
# once a change is merged.
linkcheck_ignore = [r"https://github\.com/slicemask/slicemask.*"]
linkcheck_timeout = 15
