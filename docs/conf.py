"""The documentation as a site: `sphinx-build -W docs site` makes it, and CI does."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from reference_pages import write_pages  # noqa: E402

project = "clusterviz"
author = "the clusterviz authors"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_title = "clusterviz"
html_theme = "pydata_sphinx_theme"
html_theme_options = {"show_toc_level": 2, "navbar_end": ["theme-switcher"], "secondary_sidebar_items": ["page-toc"]}
html_show_sourcelink = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
add_module_names = False
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "undoc-members": False, "exclude-members": "model_config"}
napoleon_google_docstring = False
napoleon_use_ivar = True
# Each attribute becomes a reference to its name, which several classes may have.
suppress_warnings = ["ref.python"]

write_pages(HERE / "reference" / "generated")
