"""What a reader meets: pages of a PDF, and a page on a narrow screen."""

import re
from types import MethodType

import pytest
from fpdf import FPDF

from mechsearch.findings.tables import Table
from mechsearch.report.document import Document, Paragraph, Picture, Section, to_html, to_pdf

SQUARE = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="{}pt" height="{}pt" viewBox="0 0 1 1"></svg>'
)


def table(caption: str, rows: int) -> Table:
    """Return a table of which an A4 page holds about 50 rows."""
    return Table(caption, ("policy", "reward"), tuple((f"{caption} {i}", "1") for i in range(rows)))


def picture(share: float) -> Picture:
    """Return a picture that takes a share of an A4 page between its margins."""
    return Picture(SQUARE.format(178, round(265 * share)), "a drawing", f"picture of {share}")


def document(*blocks: Paragraph | Table | Picture) -> Document:
    return Document("title", "lead", [Section("section", blocks)])


@pytest.fixture
def written(monkeypatch):
    """What is written on each page: number and text."""
    texts, multi_cell = [], FPDF.multi_cell

    def noted(self, *args, **options):
        # Rows are measured with the output silenced.
        if isinstance(self._out, MethodType) and not options.get("dry_run"):
            texts.append((self.page_no(), options.get("text", (*args, None, None, None)[2])))
        return multi_cell(self, *args, **options)

    monkeypatch.setattr(FPDF, "multi_cell", noted)
    return texts


@pytest.mark.parametrize("before", range(36, 50, 2))
def test_a_table_has_its_caption_on_every_page(written, before) -> None:
    to_pdf(document(table("first", before), table("second", 40)))
    for name in ("first", "second"):
        pages = {page for page, text in written if re.fullmatch(rf"{name} \d+", text or "")}
        assert {page for page, text in written if text == name} == pages
    assert max(page for page, _ in written) == 2


def test_tables_fill_the_page_on_which_a_picture_has_no_room(written) -> None:
    to_pdf(document(table("first", 25), picture(0.7), table("second", 25), Paragraph("the end")))
    pages = {text: page for page, text in written}
    assert pages["second 0"] == 1
    assert pages["picture of 0.7"] == 2
    texts = [text for _, text in written]
    assert texts.index("picture of 0.7") < texts.index("the end")


@pytest.mark.parametrize("rows", range(36, 47, 2))
def test_a_picture_that_waits_is_printed_once_wherever_the_page_ends(written, rows) -> None:
    tall = Table("tall", ("policy",), (("1\n2\n3\n4\n5\n6",),) * 3)
    to_pdf(document(table("first", rows), picture(0.6), tall))
    assert [text for _, text in written].count("picture of 0.6") == 1


def test_pictures_are_a_little_smaller_where_they_then_fit_and_keep_their_order(written) -> None:
    to_pdf(document(picture(0.5), picture(0.4), picture(0.8), picture(0.2), Paragraph("text")))
    pages = {text: page for page, text in written if text and text.startswith("picture")}
    assert pages == {
        "picture of 0.5": 1, "picture of 0.4": 1, "picture of 0.8": 2, "picture of 0.2": 3,
    }  # fmt: skip


def test_no_name_is_written_with_glyphs_that_are_missing(caplog) -> None:
    to_pdf(document(Paragraph("杯子"), Table("杯", ("чашка",), (("杯子",),)), picture(0.1)))
    assert "glyph" not in caplog.text.lower()


def test_tables_and_pictures_scroll_by_themselves_and_long_words_break() -> None:
    page = to_html(document(Paragraph("a" * 200), table("first", 2), picture(0.2)))
    assert len(re.findall('<div class="wide"><(?:img|table)', page)) == 2
    assert "overflow-wrap: anywhere" in page
