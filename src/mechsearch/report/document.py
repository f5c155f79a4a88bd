"""A report as data: sections of paragraphs, tables and pictures; as one HTML page, and as a PDF.

The page needs no other file: nothing is fetched, and there is no script but that of episodes in
three dimensions, which are pages of their own in a folder beside it too. All are the same bytes
from the same document.
"""

import base64
import hashlib
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from string import Template
from types import MethodType
from typing import Final
from urllib.parse import quote

from fpdf import FPDF
from fpdf.enums import CellBordersLayout, TableBordersLayout
from fpdf.fonts import FontFace
from PIL import Image

from mechsearch.files import write_whole
from mechsearch.findings.tables import Table
from mechsearch.pictures.canvas import legible, typeface

_PAGE = Path(__file__).with_name("page.html")
_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)
# A file's date is not part of what it says, and would change its bytes.
_DATE: Final = datetime(2000, 1, 1, tzinfo=UTC)
_FAMILY = "DejaVu"
_INK, _SOFT = (32, 36, 44), (91, 97, 107)
_MARKS = {"better": (0, 105, 75), "worse": (166, 63, 0)}
_MARGIN = 16.0
_LINE = 1.35
_POINT = 25.4 / 72
_LEAST_HEIGHT = 30.0
_LEAST_SCALE = 0.75


@dataclass(frozen=True)
class Paragraph:
    """Text.

    Attributes:
        text: Without any markup.
        kind: "" for plain text, "verdict" for large and "note" for small print.
    """

    text: str
    kind: str = ""


@dataclass(frozen=True)
class Picture:
    """A drawing or a photograph.

    Attributes:
        content: SVG text, or the bytes of a PNG.
        alt: What a reader who cannot see it should know.
        caption: Below it.
        name: Of a file of its own beside the document; "" for none.
    """

    content: str | bytes
    alt: str
    caption: str
    name: str = ""

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in any unit."""
        if isinstance(self.content, bytes):
            with Image.open(io.BytesIO(self.content)) as image:
                return image.width, image.height
        head = self.content.split("<svg", 1)[1].split(">", 1)[0]
        width, height = (
            float(head.split(f'{side}="', 1)[1].split('"', 1)[0].removesuffix("pt"))
            for side in ("width", "height")
        )
        return width, height


@dataclass(frozen=True)
class PageBeside:
    """A page in the document, and of its own in the folder beside it.

    Attributes:
        content: HTML.
        text: What is on it.
        name: Of its file, without the suffix.
    """

    content: str
    text: str
    name: str


Content = Paragraph | Table | Picture | PageBeside


@dataclass(frozen=True)
class Section:
    """A heading and what is below it."""

    title: str
    blocks: Sequence[Content]


@dataclass(frozen=True)
class Document:
    """A whole report.

    Attributes:
        title: At its head.
        lead: First paragraph.
        sections: In their order.
    """

    title: str
    lead: str
    sections: Sequence[Section] = ()

    @property
    def drawings(self) -> dict[str, str]:
        """SVG text of the drawings that have a file of their own, by the name for it."""
        blocks = (block for section in self.sections for block in section.blocks)
        return {
            block.name: block.content
            for block in blocks
            if isinstance(block, Picture) and block.name and isinstance(block.content, str)
        }

    @property
    def pages(self) -> dict[str, str]:
        """The pages beside it, by the name of each file."""
        blocks = (block for section in self.sections for block in section.blocks)
        return {block.name: block.content for block in blocks if isinstance(block, PageBeside)}


def to_html(document: Document, beside: str = "") -> str:
    """Return a document as one HTML page that needs no other file.

    Args:
        document: The document.
        beside: Name of the folder of its `pages`.
    """
    return Template(_PAGE.read_text(encoding="utf-8")).substitute(
        title=escape(document.title),
        scripts=_digests(document.pages.values()),
        lead=escape(document.lead),
        body="\n".join(_section_html(section, beside) for section in document.sections),
    )


def _digests(pages: Iterable[str]) -> str:
    """Return which scripts may run, those of pages alone, as a page's policy names them."""
    scripts = {found for page in pages for found in _SCRIPT.findall(page)}
    digests = (hashlib.sha256(script.encode()).digest() for script in sorted(scripts))
    named = (f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests)
    return " ".join(named) or "'none'"


def _section_html(section: Section, beside: str) -> str:
    name = section.title.lower().replace(" ", "-")
    body = "".join(_block_html(block, beside) for block in section.blocks)
    return f'<section aria-labelledby="{name}"><h2 id="{name}">{section.title}</h2>{body}</section>'


def _block_html(block: Content, beside: str) -> str:
    if isinstance(block, Paragraph):
        return f"<p{_class(block.kind)}>{escape(block.text)}</p>"
    if isinstance(block, PageBeside):
        address, words = f"{quote(beside)}/{quote(block.name)}.html", escape(block.text)
        frame = f'<iframe loading="lazy" title="{words}" srcdoc="{escape(block.content)}"></iframe>'
        alone = f'<p><a href="{address}">on a page of its own</a></p>'
        return f"<details><summary>{words}</summary>{frame}{alone}</details>"
    if isinstance(block, Table):
        return _table_html(block)
    text = isinstance(block.content, str)
    raw = block.content.encode() if isinstance(block.content, str) else block.content
    source = f"data:image/{'svg+xml' if text else 'png'};base64,{base64.b64encode(raw).decode()}"
    return (
        f'<figure><div class="wide"><img src="{source}" alt="{escape(block.alt)}"></div>'
        f"<figcaption>{escape(block.caption)}</figcaption></figure>"
    )


def _table_html(table: Table) -> str:
    head = "".join(f'<th scope="col">{escape(column)}</th>' for column in table.columns)
    body = ""
    for i, (name, *cells) in enumerate(table.rows):
        marks = table.marks[i] if table.marks else [""] * len(cells)
        data = "".join(map(_cell_html, cells, marks))
        body += f'<tr><th scope="row">{escape(name)}</th>{data}</tr>'
    caption = f"<caption>{escape(table.caption)}</caption>" if table.caption else ""
    return (
        f'<div class="wide"><table{_class("words" if table.words else "")}>{caption}<thead><tr>'
        f"{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _cell_html(text: str, mark: str) -> str:
    mean, _, rest = text.partition("\n")
    small = f"<small>{escape(rest)}</small>" if rest else ""
    return f"<td{_class(mark)}>{escape(mean)}{small}</td>"


def _class(name: str) -> str:
    return f' class="{name}"' if name else ""


def write_pdf(path: Path, document: Document) -> None:
    """Write a document on A4 pages, whole or not at all."""
    content = to_pdf(document)
    write_whole(path, lambda partial: partial.write_bytes(content))


def to_pdf(document: Document) -> bytes:
    """Return a document as the bytes of a PDF."""
    pages = _Pages()
    pages.set_title(document.title)
    pages.add_page()
    pages.write_text(document.title, 20, bold=True, after=2)
    pages.write_text(document.lead, 11, colour=_SOFT, after=3)
    for section in document.sections:
        pages.head(section, 14, before=5)
        for block in section.blocks:
            pages.put(block)
        pages.flush()
    return bytes(pages.output())


class _Pages(FPDF):
    """A4 pages that are filled block by block."""

    def __init__(self) -> None:
        super().__init__(format="A4", unit="mm")
        self.set_creation_date(_DATE)
        self.set_margins(_MARGIN, _MARGIN)
        self.set_auto_page_break(True, _MARGIN)
        plain = typeface()
        assert plain is not None
        self.add_font(_FAMILY, "", plain)
        self.add_font(_FAMILY, "B", plain.with_name("DejaVuSans-Bold.ttf"))
        self._waiting: list[Picture] = []

    def normalize_text(self, text: str) -> str:
        """Return a text with what the typeface lacks as escapes."""
        return super().normalize_text(legible(text))

    def header(self) -> None:
        """Begin a page with the pictures for which the last one had no room."""
        # To measure rows, fpdf2 silences its output and begins pages that it drops.
        if isinstance(self._out, MethodType):
            self._place()

    def footer(self) -> None:
        """Number the page."""
        self.set_y(-10)
        self.set_font(_FAMILY, "", 8)
        self.set_text_color(*_SOFT)
        self.cell(0, 5, str(self.page_no()), align="C")

    def put(self, block: Content) -> None:
        """Add one block below the last; tables fill the page on which a picture has no room."""
        if isinstance(block, Paragraph):
            self.flush()
            size = {"note": 8.0, "verdict": 10.5}.get(block.kind, 9.5)
            colour = _SOFT if block.kind == "note" else _INK
            self.write_text(block.text, size, colour=colour, after=2)
        elif isinstance(block, Table):
            self.put_table(block)
        elif isinstance(block, PageBeside):
            self.put(Paragraph(f"{block.text}: {block.name}.html, beside the report's page."))
        else:
            self._waiting.append(block)
            self._place()

    def flush(self) -> None:
        """Add the pictures that wait for room."""
        while self._waiting:
            self.add_page()

    def head(self, section: Section, size: float, before: float) -> None:
        """Add a heading, on a new page if what comes first would not fit below it."""
        self.ln(before)
        first = section.blocks[0] if section.blocks else None
        below = _LEAST_SCALE * self.fitted(first)[1] if isinstance(first, Picture) else 0
        self.need(_LEAST_HEIGHT + below)
        self.write_text(section.title, size, bold=True, after=1.5)

    def need(self, height: float) -> None:
        """Begin a new page unless so much room is left on this one."""
        if self.get_y() + height > self.h - _MARGIN:
            self.add_page()

    def write_text(
        self,
        text: str,
        size: float,
        bold: bool = False,
        colour: tuple[int, int, int] = _INK,
        after: float = 0,
    ) -> None:
        """Add text over the whole width."""
        self.set_font(_FAMILY, "B" if bold else "", size)
        self.set_text_color(*colour)
        self.multi_cell(0, size * _POINT * _LINE, text, align="L", new_x="LMARGIN", new_y="NEXT")
        self.ln(after)

    def put_table(self, content: Table) -> None:
        """Add a table whose caption and headings come again on every page."""
        columns = len(content.columns)
        size = 7.5 if content.words or columns < 8 else 6.5 if columns < 11 else 6.0
        self.set_font(_FAMILY, "", size)
        self.set_text_color(*_INK)
        self.set_draw_color(190, 194, 200)
        self.set_line_width(0.15)
        align = "LEFT" if content.words else ("LEFT", *["RIGHT"] * (columns - 1))
        with self.table(
            borders_layout=TableBordersLayout.HORIZONTAL_LINES,
            col_widths=tuple(content.widths) or _widths(content),
            headings_style=FontFace(emphasis="BOLD", color=_INK),
            line_height=size * _POINT * 1.3,
            num_heading_rows=2 if content.caption else 1,
            padding=(0.8, 1.0),
            text_align=align,
            v_align="TOP",
        ) as table:
            if content.caption:
                face = FontFace(emphasis="BOLD" if content.words else "", size_pt=8.5)
                border = CellBordersLayout.NONE
                table.row().cell(
                    content.caption, "LEFT", None, face, colspan=columns, border=border
                )
            table.row(content.columns)
            for i, cells in enumerate(content.rows):
                row = table.row()
                marks = ("", *content.marks[i]) if content.marks else [""] * len(cells)
                for text, mark in zip(cells, marks, strict=True):
                    style = FontFace(color=_MARKS[mark], emphasis="BOLD") if mark else None
                    row.cell(text, style=style)
        self.ln(3)

    def _place(self) -> None:
        """Draw waiting pictures in their order, a little smaller if they then fit on this page."""
        while self._waiting:
            picture = self._waiting[0]
            width, height = self.fitted(picture)
            self.set_font(_FAMILY, "", 8)
            line = 8 * _POINT * _LINE
            below = self.multi_cell(0, line, picture.caption, dry_run=True, output="HEIGHT")
            assert isinstance(below, float)
            scale = min(1, (self.h - _MARGIN - self.get_y() - below - 4) / height)
            if scale < _LEAST_SCALE:
                break
            self._draw(self._waiting.pop(0), scale * width, scale * height)

    def _draw(self, picture: Picture, width: float, height: float) -> None:
        content = picture.content
        if isinstance(content, str):
            # Who made it and when is none of a drawing's shapes.
            content = re.sub(r"<metadata>.*?</metadata>", "", content, flags=re.DOTALL).encode()
        left = _MARGIN + (self.epw - width) / 2
        self.image(io.BytesIO(content), x=left, w=width, h=height, alt_text=picture.alt)
        self.ln(1)
        self.write_text(picture.caption, 8, colour=_SOFT, after=3)

    def fitted(self, picture: Picture) -> tuple[float, float]:
        """Return width and height at which a picture is printed below a heading."""
        width, height = picture.size
        scale = min(self.epw / width, (self.h - 2 * _MARGIN - 30) / height)
        return width * scale, height * scale


def _widths(table: Table) -> tuple[float, ...]:
    """Return a width for each column by its longest line, or word of its bold heading."""
    widths = []
    for heading, *cells in zip(table.columns, *table.rows, strict=True):
        lines = [line for text in cells for line in text.split("\n")]
        widths.append(2 + max(*map(len, lines), *(1.5 * len(w) for w in heading.split()), 4))
    return tuple(widths)
