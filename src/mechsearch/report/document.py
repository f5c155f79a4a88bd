"""A report as data, whatever it is printed on: sections of paragraphs, tables and pictures.

Its page needs no other file: there is no script, and nothing is fetched.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template

from mechsearch.findings.tables import Table

_PAGE = Path(__file__).with_name("page.html")


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


Content = Paragraph | Table | Picture


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


def to_html(document: Document) -> str:
    """Return a document as one HTML page that needs no other file."""
    return Template(_PAGE.read_text(encoding="utf-8")).substitute(
        title=escape(document.title),
        lead=escape(document.lead),
        body="\n".join(map(_section_html, document.sections)),
    )


def _section_html(section: Section) -> str:
    name = section.title.lower().replace(" ", "-")
    body = "".join(map(_block_html, section.blocks))
    return f'<section aria-labelledby="{name}"><h2 id="{name}">{section.title}</h2>{body}</section>'


def _block_html(block: Content) -> str:
    if isinstance(block, Paragraph):
        return f"<p{_class(block.kind)}>{escape(block.text)}</p>"
    if isinstance(block, Table):
        return _table_html(block)
    text = isinstance(block.content, str)
    raw = block.content.encode() if isinstance(block.content, str) else block.content
    source = f"data:image/{'svg+xml' if text else 'png'};base64,{base64.b64encode(raw).decode()}"
    return (
        f'<figure><img src="{source}" alt="{escape(block.alt)}">'
        f"<figcaption>{escape(block.caption)}</figcaption></figure>"
    )


def _table_html(table: Table) -> str:
    head = "".join(f'<th scope="col">{escape(column)}</th>' for column in table.columns)
    body = []
    for i, (name, *cells) in enumerate(table.rows):
        marks = table.marks[i] if table.marks else [""] * len(cells)
        data = "".join(map(_cell_html, cells, marks))
        body.append(f'<tr><th scope="row">{escape(name)}</th>{data}</tr>')
    caption = f"<caption>{escape(table.caption)}</caption>" if table.caption else ""
    return (
        f'<div class="wide"><table{_class("words" if table.words else "")}>{caption}<thead><tr>'
        f"{head}</tr></thead><tbody>{''.join(body)}</tbody></table></div>"
    )


def _cell_html(text: str, mark: str) -> str:
    mean, _, rest = text.partition("\n")
    small = f"<small>{escape(rest)}</small>" if rest else ""
    return f"<td{_class(mark)}>{escape(mean)}{small}</td>"


def _class(name: str) -> str:
    return f' class="{name}"' if name else ""
