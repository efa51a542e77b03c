"""How Sphinx builds these pages: `make docs`."""

from __future__ import annotations

from pntegrity import __version__

project = "pntegrity"
author = "The pntegrity authors"
copyright = f"{author}, Apache-2.0"
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
myst_links_external_new_tab = False
exclude_patterns = ["_build", "examples/**"]

html_theme = "furo"
html_title = f"pntegrity {__version__}"
html_show_sourcelink = False
html_copy_source = False

autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_google_docstring = False
