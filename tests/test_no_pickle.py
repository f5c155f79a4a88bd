"""No file is ever pickled: reading a pickle runs what it says.

Ruff refuses the modules (`banned-api` in pyproject.toml); NumPy's own pickles are found here.
"""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted(
    path
    for name in ("src", "soak", "benchmarks", "examples")
    for path in (ROOT / name).rglob("*.py")
)
READERS = {"load", "save", "savez", "savez_compressed"}


def pickling(source):
    """Return the lines that let NumPy pickle, or that it pickles by default."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
            continue
        given = {keyword.arg: keyword.value for keyword in node.keywords}
        forbids = isinstance(given.get("allow_pickle"), ast.Constant) and (
            given["allow_pickle"].value is False
        )
        of_numpy = isinstance(node.func.value, ast.Name) and node.func.value.id in ("np", "numpy")
        if ((of_numpy and node.func.attr in READERS) or "allow_pickle" in given) and not forbids:
            found.append(node.lineno)
    return found


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_numpy_may_not_pickle(path):
    assert pickling(path.read_text()) == []


@pytest.mark.parametrize(
    "call",
    [
        "np.load(path)",
        "np.load(path, allow_pickle=True)",
        "numpy.savez(path, x=x)",
        "np.lib.npyio.NpzFile(path, allow_pickle=flag)",
    ],
)
def test_a_call_that_may_pickle_is_found(call):
    assert pickling(f"x = 1\n{call}") == [2]


@pytest.mark.parametrize(
    "text",
    [
        *("import pickle", "from pickle import loads", "import dill", "import joblib"),
        *("import shelve", "import marshal", "import cloudpickle"),
        *("import torch\n\ntorch.load('x')", "from torch import save"),
    ],
)
def test_the_linter_refuses_what_pickles(text):
    command = [sys.executable, "-m", "ruff", "check", "--no-cache", "--select", "TID251"]
    place = ["--stdin-filename", "src/mechsearch/new.py", "-"]
    done = subprocess.run(
        [*command, *place], input=text + "\n", cwd=ROOT, text=True, capture_output=True, check=False
    )
    assert done.returncode == 1
    assert "TID251" in done.stdout
