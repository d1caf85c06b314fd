"""Formulas as MathML, made when the site is built: browsers show them without a script, a font or a network."""

from __future__ import annotations

import re
from html import unescape
from typing import Any

import lxml.etree as etree
from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

logger = logging.getLogger(__name__)

MATHML = "{http://www.w3.org/1998/Math/MathML}"
NAMED = re.compile(r"&(?!amp;|lt;|gt;|quot;|apos;)[A-Za-z]+;")  # of HTML, which XML does not know
ACCENTS = set("˙¨ˆ~¯ˉ→ˇ´`˘")


def mathml(node: nodes.Element, block: bool) -> str:
    """A formula of LaTeX as MathML; one that cannot be read is a warning, which stops the build."""
    try:
        return accented(tex2mathml(node.astext(), as_block=block))
    except MathError as error:
        logger.warning("formula %r: %s", node.astext(), error, location=node)
        return ""


def accented(text: str) -> str:
    """MathML with subscripts beside letters that have an accent; docutils writes them below, as limits of a sum."""
    math = etree.fromstring(NAMED.sub(lambda name: unescape(name[0]), text))
    for found in list(math.iter(f"{MATHML}munderover", f"{MATHML}mover")):
        mark = found[-1]
        if mark.tag != f"{MATHML}mo" or (mark.text or "").strip() not in ACCENTS:
            continue
        if found.tag == f"{MATHML}mover":
            found.set("accent", "true")
            continue
        letter, below, _ = found
        found.tag = f"{MATHML}msub"
        over = etree.Element(f"{MATHML}mover", accent="true")
        over.extend((letter, mark))
        found[:] = [over, below]
    return etree.tostring(math, encoding="unicode")


def inline(translator: Any, node: nodes.Element) -> None:
    """A formula in a line."""
    translator.body.append(mathml(node, False))
    raise nodes.SkipNode


def displayed(translator: Any, node: nodes.Element) -> None:
    """A formula of its own, with its number where it has one."""
    translator.body.append(translator.starttag(node, "div", CLASS="math notranslate nohighlight"))
    if node["number"]:
        translator.body.append(f'<span class="eqno">({node["number"]})</span>')
    translator.body.append(mathml(node, True) + "</div>")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer, which is then the only one."""
    app.add_html_math_renderer("mathml", (inline, None), (displayed, None))
    app.config.html_math_renderer_name = "mathml"
    return {"parallel_read_safe": True, "parallel_write_safe": True}
