"""How the documentation is built: ``sphinx-build -W -b html docs docs/_build``."""

import sys
from pathlib import Path

from energyplan import __version__

sys.path.append(str(Path(__file__).parent))

project = "energyplan"
author = "the energyplan developers"
release = version = __version__

extensions = [
    "command_reference",
    "myst_parser",
    "sphinx.ext.autodoc",
    "numpydoc",
    "table_reference",
    "sphinx.ext.viewcode",
]
exclude_patterns = ["_build"]
smartquotes_action = "qe"  # options keep their dashes

html_theme = "furo"
html_show_copyright = False
html_static_path = ["static"]
html_css_files = ["narrow.css"]
html_js_files = ["narrow.js"]
html_title = f"energyplan {release}"

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3

autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "none"  # docstrings say it with shapes and units
autodoc_preserve_defaults = True
numpydoc_show_class_members = False  # autodoc lists them
numpydoc_class_members_toctree = False
