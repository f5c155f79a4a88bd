"""Draws docs/images/architecture.svg from the imports themselves, and prints the house in numbers.

python docs/architecture.py [FOLDER_OF_THE_PACKAGE]
"""

import ast
import sys
import tomllib
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = "mechsearch"


def modules(folder):
    """Return the file of each module by its dotted name."""
    names = {}
    for file in sorted(folder.rglob("*.py")):
        name = ".".join(file.relative_to(folder.parent).with_suffix("").parts)
        names[name.removesuffix(".__init__")] = file
    return names


def imports(names):
    """Return the package's own modules that each module imports."""
    found = {}
    for name, file in names.items():
        own = set()
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PACKAGE):
                for alias in node.names:
                    inner = f"{node.module}.{alias.name}"
                    own.add(inner if inner in names else node.module)
        found[name] = own - {name}
    return found


def twins(names):
    """Return how many public names of each kind are defined in more than one module."""
    places = {"classes": {}, "functions": {}, "constants": {}}
    for name, file in names.items():
        for node in ast.parse(file.read_text()).body:
            if isinstance(node, ast.ClassDef):
                places["classes"].setdefault(node.name, set()).add(name)
            elif isinstance(node, ast.FunctionDef):
                places["functions"].setdefault(node.name, set()).add(name)
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                    for each in target.elts if isinstance(target, ast.Tuple) else [target]:
                        if isinstance(each, ast.Name):
                            places["constants"].setdefault(each.id, set()).add(name)
    return {
        kind: sorted(n for n, where in found.items() if len(where) > 1 and not n.startswith("_"))
        for kind, found in places.items()
    }


def measured(folder):
    """Return the house in numbers."""
    names = modules(folder)
    arrows = imports(names)
    return {
        "lines of the package": sum(len(f.read_text().splitlines()) for f in names.values()),
        "modules": len(names),
        "own imports": (own := sum(map(len, arrows.values()))),
        "own imports per module": round(own / len(names), 2),
        **{f"{kind} defined twice": len(found) for kind, found in twins(names).items()},
    }


def room_of(module):
    """Return the room that a module is in: the first part of its name."""
    return module.split(".")[1] if "." in module else "mechsearch"


def rows():
    """Return the rooms row by row, the highest first, as the import contract has them."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    contracts = settings["tool"]["importlinter"]["contracts"]
    contract = next(one for one in contracts if one["type"] == "layers")
    return [row.replace(":", "|").split(" | ") for row in contract["layers"]]


def direct(arrows):
    """Return the arrows that do not follow from others."""

    def reaches(one, other, left):
        return any(b == other or reaches(b, other, left) for a, b in left if a == one and b != one)

    return [arrow for arrow in arrows if not reaches(*arrow, [a for a in arrows if a != arrow])]


def draw(folder, out):
    """Draw the rooms in their rows, and the arrows between them that do not follow from others."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams["svg.hashsalt"] = "mechsearch"
    import matplotlib.pyplot as plt
    from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

    names = modules(folder)
    lines, arrows = Counter(), Counter()
    for name, file in names.items():
        lines[room_of(name)] += len(file.read_text().splitlines())
    for name, own in imports(names).items():
        for other in sorted(own):
            if room_of(other) != room_of(name):
                arrows[room_of(name), room_of(other)] += 1
    places = {}
    figure, ax = plt.subplots(figsize=(9, 14))
    layers = [row for row in rows() if row != ["__main__"]]
    for y, row in enumerate(reversed(layers)):
        for x, room in enumerate(row):
            places[room] = ((x - (len(row) - 1) / 2) * 3.2 + (0.35 if y % 2 else -0.35), y * 1.35)
    boxes = {}
    for room, (x, y) in places.items():
        boxes[room] = FancyBboxPatch(
            (x - 1.2, y - 0.32), 2.4, 0.64, boxstyle="round,pad=0.06", facecolor="white",
            edgecolor="#20242c", linewidth=1, zorder=2,
        )  # fmt: skip
        ax.add_patch(boxes[room])
        ax.text(x, y + 0.1, room, ha="center", va="center", fontsize=10, zorder=3)
        text = f"{lines[room]:,} lines"
        ax.text(x, y - 0.2, text, ha="center", va="center", fontsize=7, color="#5b616b", zorder=3)
    shown = [arrow for arrow in arrows if set(arrow) <= set(places)]
    for one, other in direct(shown):
        arrow = FancyArrowPatch(
            places[one], places[other], patchA=boxes[one], patchB=boxes[other], arrowstyle="-|>",
            mutation_scale=9, shrinkA=1, shrinkB=1, color="#0072b2", linewidth=1,
            connectionstyle="arc3,rad=0.1", zorder=1,
        )  # fmt: skip
        ax.add_patch(arrow)
    ax.set_xlim(-5.5, 5.5)
    ax.set_ylim(-0.8, len(layers) * 1.35)
    ax.axis("off")
    figure.savefig(out, bbox_inches="tight", metadata={"Date": None})


if __name__ == "__main__":
    package = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "src" / PACKAGE
    for what, value in measured(package).items():
        print(f"{what}: {value}")
    if len(sys.argv) == 1:
        draw(package, ROOT / "docs" / "images" / "architecture.svg")
