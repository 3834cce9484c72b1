"""A report's page on paper: everything that it shows is there, whatever people call their robots."""

from __future__ import annotations

import io
import re
from html import escape

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pypdf import PdfReader

from dynident.reports import render_pdf
from dynident.reports.figures.svg import draw_formula
from dynident.reports.pdf_report import parse_page, typeset_page

DRAWING = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 90 30" role="img" aria-label="a line">'
    '<clipPath id="c"><rect width="90" height="30"/></clipPath>'
    '<text x="5" y="20" style="font: 10px sans-serif">torque of the elbow</text></svg>'
)
TABLE = """<div class="scroll"><table><caption>Joints</caption>
<thead><tr><th>joint</th><th class="n">error</th><th>what is said of it</th></tr></thead>
<tbody><tr class="group"><th colspan="3">shoulder</th></tr>
<tr class="pick"><th>elbow</th><td class="n">1.02 N m</td><td>within what the sensor's noise explains</td></tr>
<tr><th>wrist</th></tr></tbody></table></div>"""


def page(body: str) -> str:
    return f"<!DOCTYPE html><html><head><title>t</title><style>p {{ }}</style></head><body>{body}</body></html>"


def read(content: bytes) -> str:
    text = " ".join("".join(one.extract_text() for one in PdfReader(io.BytesIO(content)).pages).split())
    # Readers of PDF guess spaces from gaps.
    return text.replace(" ,", ",")


def squeezed(text: str) -> str:
    """Without white space and the hyphens that a line may end with."""
    return re.sub(r"[\s\-\u00ad]", "", text)


def test_tables_figures_lists_and_boxes_are_on_paper() -> None:
    body = f"""<h1>Identification of arm</h1><nav><a href="#x">Contents</a></nav>
    <section><h2>Summary</h2>
    <div class="box warning"><p><strong>One warning</strong></p><ul><li>first</li></ul></div>
    <dl class="figures">
    <div><dt>held-out error</dt><dd class="value">2.44 %</dd><dd class="note">relative</dd></div></dl>
    <dl class="facts"><dt>strategy</dt><dd>global</dd></dl>
    <ol class="note"><li>do <code>dynident report</code></li></ol>
    {TABLE}<figure>{DRAWING}<figcaption>Over time.</figcaption></figure>
    <p>Friction {draw_formula("F_c")} is <span class="mark ok">determined</span>.</p>
    <details><summary>36 checks passed</summary><p>nobody prints this</p></details></section>"""
    text = squeezed(read(render_pdf(page(body))))
    for shown in (
        "Identification of arm", "Summary", "One warning", "first", "held-out error", "2.44 %", "strategy", "global",
        "dynident report", "Joints", "shoulder", "1.02 N m", "within what the sensor", "wrist", "torque of the elbow",
        "Over time.", "determined", "36 checks passed (in the HTML report)", "1 / 1",
    ):  # fmt: skip
        assert squeezed(shown) in text, shown
    assert "nobodyprintsthis" not in text
    assert "Contents" not in text


@settings(max_examples=40, deadline=None)
@given(st.text(st.characters(min_codepoint=0x20, max_codepoint=0x24F, exclude_characters="\u00ad"), min_size=1))
def test_no_name_of_a_robot_or_joint_is_taken_for_markup(name: str) -> None:
    shown = escape(name)
    content = render_pdf(page(f"<p>before</p><p>{shown}</p><p><code>{shown}</code></p><p>after</p>"))
    text = squeezed(read(content))
    assert text.startswith("before")
    assert "after" in text
    letters = re.sub(r"[^A-Za-z0-9#$*_@\[\]{}\\/]", "", name)
    told = re.sub(r"[^A-Za-z0-9#$*_@\[\]{}\\/]", "", text)
    assert told.count(letters) >= (2 if letters else 0)


def test_a_drawing_keeps_the_spelling_of_its_elements() -> None:
    assert DRAWING.replace('"', '\\"') in typeset_page(parse_page(page(f"<figure>{DRAWING}</figure>")))


def test_long_tables_repeat_their_head_on_the_next_page() -> None:
    rows = "".join(f"<tr><th>joint {k}</th><td class='n'>{k}.5 N m</td></tr>" for k in range(150))
    table = f"<table><thead><tr><th>joint</th><th class='n'>torque</th></tr></thead><tbody>{rows}</tbody></table>"
    pages = PdfReader(io.BytesIO(render_pdf(page(table)))).pages
    assert len(pages) > 1
    assert all("torque" in one.extract_text() for one in pages)
    assert f"2 / {len(pages)}" in pages[1].extract_text()


def test_the_same_report_is_the_same_file() -> None:
    assert render_pdf(page(TABLE)) == render_pdf(page(TABLE))


def test_a_viewer_shows_the_reports_title() -> None:
    named = page(TABLE).replace("<title>t</title>", "<title>My &quot;arm&quot; #1</title>")
    assert PdfReader(io.BytesIO(render_pdf(named))).metadata.title == 'My "arm" #1'


@pytest.mark.parametrize(
    "body", ["", "<p></p>", "<table></table>", "<ul></ul>", "<dl class='figures'></dl>", "<figure></figure>"]
)
def test_what_is_empty_is_no_error(body: str) -> None:
    assert render_pdf(page(body)).startswith(b"%PDF")


def test_a_link_out_of_the_report_can_be_followed_from_paper_on_a_screen() -> None:
    address = "http://arm:8000/?identification=idn_1&tab=verdict"
    printed = render_pdf(page(f'<p>In <a href="{escape(address)}">the workbench</a>, or <a href="#x">above</a>.</p>'))
    assert "In the workbench, or above." in read(printed)
    notes = [note.get_object() for note in PdfReader(io.BytesIO(printed)).pages[0].get("/Annots", [])]
    assert [note["/A"]["/URI"] for note in notes] == [address]
