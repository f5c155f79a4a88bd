"""What the check of the built site notices, and what a page is as a notebook."""

import json

import pytest

from docs.notebooks import notebook
from docs.offline import faults

WHOLE = '<a href="b.html#here">b</a><img src="_images/a.png"><a href="https://example.org">out</a>'


@pytest.fixture
def site(tmp_path):
    """A site of two pages without a fault."""
    (tmp_path / "_images").mkdir()
    (tmp_path / "_images" / "a.png").touch()
    (tmp_path / "style.css").write_text("p { background: url(_images/a.png) }")
    (tmp_path / "a.html").write_text(WHOLE)
    (tmp_path / "b.html").write_text('<h1 id="here">b</h1><a href="a.html">a</a>')
    return tmp_path


def test_a_whole_site_may_link_outside_but_not_load_from_there(site):
    assert faults(site) == []


@pytest.mark.parametrize(
    ("name", "text", "fault"),
    [
        ("a.html", '<a href="c.html">c</a>', "no file c.html"),
        ("a.html", '<a href="b.html#there">b</a>', "no place b.html#there"),
        ("a.html", '<a href="#there">a</a>', "no place #there"),
        ("a.html", '<img src="_images/b.png">', "no file _images/b.png"),
        ("a.html", '<script src="https://example.org/a.js"></script>', "loads https://example.org"),
        ("a.html", '<link rel="stylesheet" href="//example.org/a.css">', "loads //example.org/a.c"),
        ("style.css", '@import "https://example.org/a.css";', "loads https://example.org/a.css"),
        ("style.css", "p { src: url(//example.org/a.woff) }", "loads //example.org/a.woff"),
    ],
)
def test_one_fault_is_found_and_named(site, name, text, fault):
    (site / name).write_text(text)
    (found,) = faults(site)
    assert found.startswith(f"{site / name}: {fault}")


PAGE = """\
# A page

See [heaps](heaps.md#a) and [more](https://example.org).

```{run} bash
:picture: a.png
:alt: A heap

mechsearch heaps show a --out a.png
```

```{run} python
:save: mine.py

x = 1
```
Between.

```{run} python
print("a")

print("b")
```

```bash
this does not run
```
"""


def test_a_page_whose_code_runs_is_a_notebook_with_the_same_cells():
    book = json.loads(notebook(PAGE))
    assert [(cell["cell_type"], cell["source"]) for cell in book["cells"]] == [
        ("markdown", "# A page\n\nSee heaps and [more](https://example.org)."),
        ("code", "%%bash\nmechsearch heaps show a --out a.png"),
        ("code", 'from IPython.display import Image\n\nImage("a.png")'),
        ("code", "%%writefile mine.py\nx = 1"),
        ("markdown", "Between."),
        ("code", 'print("a")\n\nprint("b")'),
        ("markdown", "```bash\nthis does not run\n```"),
    ]
    assert notebook("# A page\n\n```bash\nls\n```\n") == ""
