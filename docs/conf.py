"""Sphinx: HTML of the pages that build_site.py writes."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from hover import with_hover_texts

project = "deepbots"
author = "the authors of deepbots"
extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
html_theme = "furo"
html_title = "deepbots"
html_static_path = ["theme/static"]
html_css_files = ["site.css"]
html_js_files = [("gallery.js", {"defer": "defer"})]
html_search_scorer = str(Path(__file__).parent / "theme" / "scorer.js")
html_copy_source = False
html_use_index = False
html_domain_indices = False
html_show_sphinx = False
html_show_copyright = False
templates_path = ["theme/templates"]
exclude_patterns = ["files"]
myst_enable_extensions = ["html_image"]
myst_disable_syntax = [
    "myst_line_comment",
    "myst_block_break",
    "myst_target",
]  # a wrapped line may begin with "% of it"
smartquotes = False
myst_heading_anchors = 4  # named as GitHub does
highlight_language = "none"
suppress_warnings = ["misc.highlighting_failure"]  # examples of mistakes are not always YAML


def setup(app):
    """Add hover texts to each page."""

    def add(app, name, template, context, doctree):
        if "body" in context:
            context["body"] = with_hover_texts(context["body"])

    app.connect("html-page-context", add)
