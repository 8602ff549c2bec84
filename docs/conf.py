"""Settings of the site: ``python -m sphinx -W docs out/site`` with the extra `docs`."""

import re
import sys
from pathlib import Path
from typing import Any

import ancfdae

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
from claims import CLAIMS  # noqa: E402
from pictures import FILMS  # noqa: E402

project = "ancfdae"
author = project_copyright = "ancfdae developers"
release = version = ancfdae.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.intersphinx",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["tutorial", "gallery"]  # The gallery reads them and writes below `made`.
myst_enable_extensions = ["colon_fence", "attrs_inline", "dollarmath", "substitution"]
myst_substitutions = CLAIMS
myst_heading_anchors = 3
highlight_language = "none"  # Indented blocks are formulas.
nitpicky = True
default_role = "py:obj"  # `Pin` in a docstring is a link,
nitpick_ignore_regex = [("py:obj", ".*")]  # and `q_b` a word in type of code.

autodoc_typehints = "none"  # They stand in the docstrings, in words and with units.
numpydoc_show_class_members = False
python_maximum_signature_line_length = 90
add_module_names = False
# The words of numpydoc's types are no names.
numpydoc_xref_param_type = False

# Read from files of the checkout, so that a build needs no network; the links are the real ones.
intersphinx_mapping = {
    name: (address, str(HERE / "inventories" / f"{name}.inv"))
    for name, address in {
        "python": "https://docs.python.org/3",
        "numpy": "https://numpy.org/doc/stable",
        "scipy": "https://docs.scipy.org/doc/scipy",
    }.items()
}

sphinx_gallery_conf = {
    "examples_dirs": ["tutorial", "gallery"],
    "gallery_dirs": ["made/tutorial", "made/gallery"],
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": ("pictures",),
    "abort_on_example_error": True,
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "show_signature": False,
    "capture_repr": (),
}

html_theme = "pydata_sphinx_theme"
html_title = "ancfdae"
html_static_path = ["_static", "made/films"]
FILMS.mkdir(parents=True, exist_ok=True)
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "show_prev_next": True,
    "navigation_with_keys": False,
    "show_nav_level": 1,
    "header_links_before_dropdown": 8,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "navbar_end": ["theme-switcher"],
}
html_sidebars = {"index": []}


def plain_bars(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Keep bars as they are in docstrings: they are absolute values, and no substitutions."""
    for k, line in enumerate(lines):
        line = re.sub(r"(``.*?``)|\|", lambda found: found[1] or r"\|", line)
        lines[k] = line.replace("``(", "`` (")  # Text beside a literal needs a space.


def setup(app: Any) -> None:
    """Register with Sphinx."""
    app.connect("autodoc-process-docstring", plain_bars)
