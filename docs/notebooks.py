"""Pages whose code runs as the site is built (`cells.py`), as notebooks to take away."""

import json
import re

_CELL = re.compile(r"^```\{run\} (\w+)\n((?::[^\n]*\n)*)\n*(.*?)^```$", re.MULTILINE | re.DOTALL)
_OPTION = re.compile(r"^:(\w+): (.*)$", re.MULTILINE)
_LINK = re.compile(r"\[([^\]]*)\]\((?!https?:)[^)]*\)")
"""Links to other pages, which do not lie beside a notebook."""


def notebook(page):
    """Return a page in MyST as the text of a notebook, or nothing if no code in it runs."""
    prose, *rest = _CELL.split(page)
    cells = [_prose(prose)]
    for language, written, code, after in zip(*[iter(rest)] * 4, strict=True):
        options = dict(_OPTION.findall(written))
        save = options.get("save")
        first = f"%%writefile {save}\n" if save else "%%bash\n" if language == "bash" else ""
        cells.append(_code(first + code))
        if picture := options.get("picture"):
            cells.append(_code(f'from IPython.display import Image\n\nImage("{picture}")'))
        cells.append(_prose(after))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    book = {
        "cells": [cell for cell in cells if cell["source"]], "metadata": {"kernelspec": kernel},
        "nbformat": 4, "nbformat_minor": 4,
    }  # fmt: skip
    return json.dumps(book, indent=1) + "\n" if rest else ""


def _prose(text):
    return {"cell_type": "markdown", "metadata": {}, "source": _LINK.sub(r"\1", text).strip()}


def _code(text):
    return {
        "cell_type": "code", "metadata": {}, "execution_count": None, "outputs": [],
        "source": text.strip(),
    }  # fmt: skip
