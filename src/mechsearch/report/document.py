"""A report as data, whatever it is printed on: sections of paragraphs, tables and pictures.

Its page needs no other file: there is no script, and nothing is fetched.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from string import Template

from mechsearch.findings.tables import Table


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
    return Template(_PAGE).substitute(
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


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy"
  content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>$title</title>
<style>
:root { --ink: #20242c; --soft: #5b616b; --line: #d9dce1; --paper: #fff; --accent: #0072b2;
  --better: #00694b; --worse: #a63f00; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 2.5rem 1.25rem 4rem; max-width: 68rem; color: var(--ink);
  background: var(--paper); font: 17px/1.55 system-ui, -apple-system, "Segoe UI", sans-serif; }
h1, h2 { line-height: 1.2; text-wrap: balance; }
h1 { font-size: 2.1rem; margin: 0 0 .5rem; letter-spacing: -.015em; }
h2 { font-size: 1.4rem; margin: 3rem 0 1rem; padding-top: 1rem; border-top: 2px solid var(--ink); }
p { max-width: 44rem; }
.lead { font-size: 1.15rem; color: var(--soft); }
.verdict { font-size: 1.15rem; }
.note, figcaption, caption { color: var(--soft); font-size: .9rem; }
.wide { overflow-x: auto; margin: 1.5rem 0; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums;
  font-size: .88rem; }
caption { text-align: left; padding-bottom: .4rem; }
th, td { padding: .4rem .45rem; text-align: right; vertical-align: top;
  border-bottom: 1px solid var(--line); white-space: nowrap; }
thead th { border-bottom: 1.5px solid var(--ink); font-weight: 600; }
th:first-child { text-align: left; padding-left: 0; }
tbody th { font-weight: 600; }
.words th, .words td { text-align: left; white-space: normal; }
.words tbody th { font-weight: 400; }
.words caption { color: var(--ink); font-weight: 600; }
small { display: block; color: var(--soft); font-size: .82em; font-weight: 400; }
td.better { color: var(--better); font-weight: 600; }
td.worse { color: var(--worse); font-weight: 600; }
figure { margin: 1.25rem 0; }
img { max-width: 100%; height: auto; display: block; }
@media print {
  body { max-width: none; padding: 0; font-size: 10pt; }
  .wide { overflow: visible; }
  table { font-size: 8.5pt; }
  th, td { padding: .2rem .4rem; }
  h2, caption { break-after: avoid; }
  figure, tr { break-inside: avoid; }
}
</style>
</head>
<body>
<header><h1>$title</h1><p class="lead">$lead</p></header>
<main>
$body
</main>
</body>
</html>
"""
