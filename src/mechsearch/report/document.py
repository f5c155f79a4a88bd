"""A report as data, whatever it is printed on: sections of paragraphs, tables and pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from string import Template

from mechsearch.report import tables
from mechsearch.report.figures import data_uri
from mechsearch.report.style import PAGE
from mechsearch.report.tables import Table


@dataclass(frozen=True)
class Paragraph:
    """Text.

    Attributes:
        text: Without any markup.
        note: Whether it is small print.
    """

    text: str
    note: bool = False


@dataclass(frozen=True)
class Grid:
    """A table.

    Attributes:
        table: Its cells.
        marks: Class name of each cell after the first (R, C - 1): "better", "worse" or "".
        words: Whether the cells are sentences rather than numbers.
        widths: Share of each column in the width (C,) on paper; empty leaves it to the numbers.
    """

    table: Table
    marks: Sequence[Sequence[str]] = ()
    words: bool = False
    widths: Sequence[float] = ()


@dataclass(frozen=True)
class Picture:
    """A drawing or a photograph.

    Attributes:
        content: SVG text, or the bytes of a PNG.
        alt: What a reader who cannot see it should know.
        caption: Below it.
    """

    content: str | bytes
    alt: str
    caption: str


Block = Paragraph | Grid | Picture


@dataclass(frozen=True)
class Section:
    """A heading and what is below it."""

    title: str
    blocks: Sequence[Block]


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
    sections: Sequence[Section] = field(default_factory=tuple)


def to_html(document: Document) -> str:
    """Return a document as one HTML page that needs no other file."""
    return Template(PAGE).substitute(
        title=escape(document.title),
        lead=escape(document.lead),
        body="\n".join(
            section_html(section.title, "".join(map(_block_html, section.blocks)))
            for section in document.sections
        ),
    )


def section_html(title: str, body: str) -> str:
    """Return a section of a page."""
    name = title.lower().replace(" ", "-")
    return f'<section aria-labelledby="{name}"><h2 id="{name}">{title}</h2>{body}</section>'


def picture_html(picture: Picture) -> str:
    """Return a picture with its caption."""
    kind = "image/svg+xml" if isinstance(picture.content, str) else "image/png"
    return (
        f'<figure><img src="{data_uri(picture.content, kind)}" alt="{escape(picture.alt)}">'
        f"<figcaption>{escape(picture.caption)}</figcaption></figure>"
    )


def _block_html(block: Block) -> str:
    if isinstance(block, Paragraph):
        kind = ' class="note"' if block.note else ""
        return f"<p{kind}>{escape(block.text)}</p>"
    if isinstance(block, Grid):
        return tables.to_html(block.table, block.marks, block.words)
    return picture_html(block)
