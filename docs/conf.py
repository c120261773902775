"""How Sphinx builds the site: `make docs` runs it. The pages are the Markdown files of this folder."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

from unbend import __version__

project = "unbend"
version = release = __version__
project_copyright = "the unbend authors"

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "mathml", "reference"]
exclude_patterns = ["extensions"]

# Markdown: tables, equations between dollars, and links to headings as on GitHub. An indented block is a shell command.
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
html_math_renderer = "mathml"
highlight_language = "sh"
smartquotes = False  # it would make a dash of the two of an option
pygments_style = "friendly"

# The reference: single backticks in docstrings are names, which become links where the site has them.
default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings give types and shapes
autodoc_preserve_defaults = True
numpydoc_show_class_members = False  # autodoc lists them, with what each says
python_use_unqualified_type_names = True

# Nothing is loaded from another host, and no page depends on the time of its build.
html_theme = "pydata_sphinx_theme"
html_title = "unbend"
html_favicon = "../service/web/src/ui/icon.svg"
html_copy_source = False
html_show_sourcelink = False
html_static_path = ["static"]
html_css_files = ["site.css"]
html_extra_path = ["../openapi/openapi.json"]
html_theme_options = {
    "header_links_before_dropdown": 10,
    "navbar_end": ["theme-switcher"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "show_prev_next": True,
    "navigation_with_keys": False,
}
