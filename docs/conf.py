"""Sphinx configuration of the manual, which `make docs` builds into build/manual."""

import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util.math import get_node_equation_number

sys.path.insert(0, str(Path(__file__).parents[1]))

from docs import generated
from docs.figures import manual
from service.version import VERSION

project = "ricochet"
author = "The ricochet authors"
project_copyright = author
version = release = VERSION
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns: list[str] = []
default_role = "py:obj"  # Role of single backticks in docstrings.

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
myst_dmath_double_inline = True

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_rtype = False

html_theme = "furo"
html_title = f"ricochet {release}"
html_favicon = "../service/page/favicon.svg"
html_static_path = ["_static"]
html_css_files = ["manual.css"]
html_show_sourcelink = False
html_copy_source = False
html_show_search_summary = False  # Summaries would fetch pages, which browsers refuse for file: URLs.
html_theme_options: dict[str, Any] = {"top_of_page_buttons": []}
html_math_renderer = "mathml"
math_eqref_format = "({number})"


def visit_inline(translator: Any, node: nodes.math) -> None:
    """Write an inline formula as MathML, which browsers render without a script."""
    translator.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def visit_block(translator: Any, node: nodes.math_block) -> None:
    """Write a displayed formula as MathML, with its number if it has a label."""
    translator.body.append(translator.starttag(node, "div", CLASS="math"))
    if node["number"]:
        translator.body.append(f'<span class="eqno">({get_node_equation_number(translator, node)})')
        translator.add_permalink_ref(node, "Link to this equation")
        translator.body.append("</span>")
    translator.body.append(tex2mathml(node.astext(), as_block=True))
    translator.body.append("</div>")
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Register the formula renderers, the figures and the generated text."""
    app.add_html_math_renderer("mathml", inline_renderers=(visit_inline, None), block_renderers=(visit_block, None))
    app.connect("builder-inited", lambda _: manual.draw_all())
    app.connect("source-read", lambda _app, _name, source: source.__setitem__(0, generated.filled(source[0])))
