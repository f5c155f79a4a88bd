"""Code in pages that runs as the site is built: the directive `run`, and what comes of it.

The cells of a page run in order, in an empty folder that they share; those in Python share their
names too. What a cell prints stands below it. A cell that fails stops the build. Such a page is a
notebook too.
"""

import io
import os
import shutil
import subprocess
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from notebooks import notebook
from sphinx.util.docutils import SphinxDirective


class Run(SphinxDirective):
    """A cell in `bash` or `python`.

    `:save: FILE` keeps its text in a file instead of running it, `:picture: FILE` shows a picture
    that it wrote.
    """

    required_arguments = 1
    has_content = True
    option_spec: ClassVar = {
        "save": directives.path, "picture": directives.path, "alt": directives.unchanged,
    }  # fmt: skip

    def run(self):
        """Run the cell, and return its text, what it printed, and its picture."""
        language, code = self.arguments[0], "\n".join(self.content) + "\n"
        page = self.env.temp_data.setdefault("cells", {"names": {"__name__": "page"}, "count": 0})
        page["count"] += 1
        folder = Path(self.env.srcdir) / "_build" / "cells" / self.env.docname
        if page["count"] == 1:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        shown = [_block(code, language)]
        if "save" in self.options:
            (folder / self.options["save"]).write_text(code)
            return shown
        with chdir(folder):
            said = _python(code, page["names"]) if language == "python" else _bash(code)
        if said.strip():
            shown.append(_block(said, "text"))
        if "picture" in self.options:
            # Under a name of its own, since a later cell may write another of that name.
            written = folder / self.options["picture"]
            kept = written.with_name(f"cell-{page['count']}{written.suffix}")
            written.replace(kept)
            uri = "/" + kept.relative_to(self.env.srcdir).as_posix()
            shown.append(nodes.image(uri=uri, alt=self.options.get("alt", "")))
        return shown


def _block(text, language):
    """Return text as a block; Sphinx colours it if its raw source is the same."""
    return nodes.literal_block(text.rstrip(), text.rstrip(), language=language)


def _python(code, names):
    said = io.StringIO()
    sys.path.insert(0, os.getcwd())
    try:
        with redirect_stdout(said), redirect_stderr(said):
            exec(compile(code, "<cell>", "exec"), names)
    finally:
        sys.path.pop(0)
    return said.getvalue()


def _bash(code):
    """Run a shell in which `mechsearch` and `python` are those that build the site."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", code], env={**os.environ, "PATH": path},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"{code}exits with {done.returncode}:\n{done.stdout}")
    return done.stdout


def _link_notebook(app, page, text):
    """Write a page's notebook, if code in it runs, and link it below the title."""
    if book := notebook(text[0]):
        file = Path(app.srcdir) / "_build" / "notebooks" / f"{page}.ipynb"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(book)
        link = f"{{download}}`This page as a notebook </_build/notebooks/{page}.ipynb>`"
        title, rest = text[0].split("\n", 1)
        text[0] = f"{title}\n\n{link}\n{rest}"


def setup(app):
    """Register the directive, and the notebooks."""
    app.add_directive("run", Run)
    app.connect("source-read", _link_notebook)
    return {"parallel_read_safe": False}
