"""The site: `make docs`."""

from __future__ import annotations

from typing import Any

import lunarsim

project = "lunarsim"
author = "the lunarsim authors"
release = version = lunarsim.__version__
extensions = [
    "myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.mathjax",
    "sphinx-mathjax-offline", "numpydoc",
]  # fmt: skip
exclude_patterns = ["_build", "**/.ipynb_checkpoints"]
html_theme = "pydata_sphinx_theme"
html_title = "lunarsim"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {"show_toc_level": 2, "navigation_with_keys": False}
html_show_sourcelink = False

# Headings are anchors; mathematics between dollars.
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath", "amsmath", "deflist"]
# A cell that runs longer than this is a mistake, s.
nb_execution_timeout = 300
nb_execution_mode = "cache"
nb_execution_raise_on_error = True

autosummary_generate = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
# Only names of this package are looked up: the index of no other is asked for over the network.
nitpick_ignore_regex = [("py:.*", r"(?!lunarsim\.).*")]


def setup(app: Any) -> None:
    """Let Sphinx read pages in parallel: an extension does not say that it is safe, but is."""
    app.extensions["sphinx-mathjax-offline"].parallel_read_safe = True
