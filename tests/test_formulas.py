"""Formulas of the site: what docutils makes of LaTeX, with indices beside letters that have an accent."""

import sys
from pathlib import Path

import pytest
from lxml import etree

pytest.importorskip("sphinx", reason="the site needs the extra docs")
sys.path.append(str(Path(__file__).parents[1] / "docs/extensions"))


def tags(latex):
    from docutils.utils.math.latex2mathml import tex2mathml
    from mathml import accented

    root = etree.fromstring(accented(tex2mathml(latex)))
    return [etree.QName(element).localname for element in root.iter()], "".join(root.itertext()).split()


@pytest.mark.parametrize("latex", [r"\dot e_x", r"\hat\Psi_j", r"\tilde W_i", r"\dot\nu_\mathrm{ref}"])
def test_an_index_of_a_letter_with_an_accent_stands_beside_it(latex):
    names, texts = tags(latex)
    assert names[:5] == ["math", "msub", "mover", "mi", "mo"] and names[5] == "mi"
    assert len(texts) == 3


def test_limits_of_sums_stay_below_and_names_of_html_are_read():
    assert "munderover" in tags(r"\sum_{i=1}^n x_i")[0]
    assert "munder" in tags(r"\max_i x_i")[0]
    assert tags(r"\operatorname{tr}(P)")[0][0] == "math"
