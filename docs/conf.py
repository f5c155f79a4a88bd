"""How Sphinx makes the site of these pages: `make docs`."""

import sys
import tomllib
from pathlib import Path

from docutils import nodes

import mechsearch

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))

# Sphinx documents what stands in a module; these are imported when they are first used.
for name in mechsearch.__all__:
    setattr(mechsearch, name, getattr(mechsearch, name))

project = "mechsearch"
release = tomllib.loads((DOCS.parent / "pyproject.toml").read_text())["project"]["version"]
extensions = ["cells", "myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
highlight_language = "text"

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

html_theme = "furo"
html_static_path, html_css_files = ["site.css"], ["site.css"]
html_title = f"mechsearch {release}"
html_show_sphinx = html_show_copyright = html_show_sourcelink = html_copy_source = False


def captioned(app, page):
    """Give each picture that stands by itself its description as a caption."""
    for image in list(page.findall(nodes.image)):
        paragraph = image.parent
        if isinstance(paragraph, nodes.paragraph) and len(paragraph) == 1 and image.get("alt"):
            figure = nodes.figure("", image, nodes.caption("", image["alt"]))
            page.set_id(figure)
            paragraph.replace_self(figure)


def setup(app):
    """Caption pictures, and let pages link to a Markdown file that is no page of the site."""
    app.connect("doctree-read", captioned)

    def linked(app, page, text):
        text[0] = text[0].replace("](../results/README.md)", "](path:../results/README.md)")

    app.connect("source-read", linked)
