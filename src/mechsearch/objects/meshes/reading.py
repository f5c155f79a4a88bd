"""Mesh files: OBJ with its materials and textures, STL and GLB.

OBJ is read here: the general readers at hand take indices that count back from the wrong vertex,
fill concave polygons with fans, and lose textures whose names have spaces or options before them.
"""

import re
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import SimpleMaterial

from mechsearch.types import Floats, MechSearchError

SUFFIXES = (".obj", ".stl", ".glb")

READING = 2
"""Raised with every change of what a file is read as, so that objects read before are read anew."""

OVERLAP = 1e-4
"""Share of a polygon's area by which a fan of triangles may overlap itself or leave the polygon."""

Corner = tuple[int, int, int, int]
"""Indices of v, vt and vn, and as bits 0 to 2 which of them are given."""

Polygons = list[tuple[int, list[Corner]]]
"""Faces: line and corners."""

_simple_material: Callable[..., SimpleMaterial] = SimpleMaterial
_texture_visuals: Callable[..., TextureVisuals] = TextureVisuals
_unmerge_faces: Callable[..., Sequence[NDArray[np.int64]]] = trimesh.visual.texture.unmerge_faces

_NUMBER = r"\s+[-+]?[.\d]\S*"
_OPTIONS = re.compile(
    rf"(?:-(?:[sot](?:{_NUMBER}){{1,3}}|mm(?:{_NUMBER}){{2}}|[a-z]+\s+\S+)\s+)*", re.IGNORECASE
)
"""What may stand before the name of a texture."""


def read_pieces(path: Path) -> list[trimesh.Trimesh]:
    """Return the meshes of a file in one frame [m], with their colours.

    Raises:
        MechSearchError: If the file is missing, not a mesh, damaged, empty or has numbers that are
            not finite.
    """
    if not path.is_file():
        raise MechSearchError(f"no mesh at {path}")
    try:
        if path.suffix.lower() == ".obj":
            pieces = read_obj(path)
        else:
            if path.suffix.lower() == ".stl":
                _check_stl(path.read_bytes())
            scene = trimesh.load_scene(path, process=False)
            pieces = [piece for piece in scene.dump() if isinstance(piece, trimesh.Trimesh)]
    except MechSearchError as error:
        raise MechSearchError(f"cannot read the mesh {path}: {error}") from None
    except Exception as error:  # noqa: BLE001  (parsers of foreign formats raise anything)
        raise MechSearchError(
            f"cannot read the mesh {path}: {type(error).__name__}: {error}"
        ) from None
    pieces = [piece for piece in pieces if len(piece.faces)]
    if not pieces:
        raise MechSearchError(f"the mesh {path} is empty; expected triangles")
    if not all(np.isfinite(piece.vertices).all() for piece in pieces):
        raise MechSearchError(f"the mesh {path} has vertices that are not finite")
    if any(piece.faces.min() < 0 or piece.faces.max() >= len(piece.vertices) for piece in pieces):
        raise MechSearchError(f"the mesh {path} is damaged: it has triangles without vertices")
    return pieces


def source_files(path: Path) -> list[Path]:
    """Return the mesh file and, for OBJ, the material and texture files it names that exist."""
    return list(dict.fromkeys([path, *(found for _, found in _named(path) if found)]))


def missing_files(path: Path) -> list[str]:
    """Return the materials and surface textures that an OBJ file names and that are not there."""
    return list(dict.fromkeys(name for name, found in _named(path) if name and not found))


def _named(path: Path) -> Iterator[tuple[str, Path | None]]:
    """Yield name and place of each file that an OBJ file needs; others it names have no name."""
    if path.suffix.lower() != ".obj":
        return
    for name, material in _material_files(path, _text(path)):
        yield name, material
        if material is None:
            continue
        for key, rest in _statements(material):
            if key.startswith("map_"):
                yield (rest if key == "map_kd" else ""), _texture(rest, path, material)


def _material_files(path: Path, text: str) -> Iterator[tuple[str, Path | None]]:
    """Yield name and place of each material file: one name a line, or several without spaces."""
    for match in re.finditer(r"mtllib[ \t]+(.+)", text):
        if text[text.rfind("\n", 0, match.start()) + 1 : match.start()].strip():
            continue  # In a comment, or part of another word.
        rest = match[1].strip()
        several = [(name, _place(name, path.parent)) for name in rest.split()]
        whole = _place(rest, path.parent)
        yield from [(rest, whole)] if whole or not any(at for _, at in several) else several


def _texture(rest: str, path: Path, material: Path) -> Path | None:
    """Return the place of a texture, from what follows its keyword, or None."""
    names = dict.fromkeys((rest, rest[len(_OPTIONS.match(rest)[0]) :]))  # type: ignore[index]
    places = (_place(name, file.parent) for name in names for file in (path, material))
    return next(filter(None, places), None)


def _place(name: str, folder: Path) -> Path | None:
    """Return where a file is that another names, or None.

    Where no file has the very name, quotes, backslashes, the case of letters, the form of accents
    and a folder of some other machine are overlooked, one after another.
    """
    name = name.strip().strip("\"'")
    if not name:
        return None
    for tried in (name, name.replace("\\", "/"), PureWindowsPath(name).name):
        path = folder / tried
        if path.is_file():
            return path
        if path.parent.is_dir():
            alike = [file for file in path.parent.iterdir() if _folded(file) == _folded(path)]
            if len(alike) == 1 and alike[0].is_file():
                return path.parent / alike[0].name
    return None


def _folded(path: Path) -> str:
    return unicodedata.normalize("NFC", path.name).casefold()


def _text(path: Path) -> str:
    """Return a text with plain ends of lines; those joined by a backslash are one, then empty."""
    text = path.read_bytes().decode("utf-8-sig", "surrogateescape")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if "\\\n" not in text:
        return text
    return re.sub(
        r"(?:.*\\\n)+.*", lambda m: m[0].replace("\\\n", " ") + "\n" * m[0].count("\n"), text
    )


def _statements(path: Path) -> Iterator[tuple[str, str]]:
    """Yield the keyword, in small letters, and the rest of each line of a material file."""
    for line in _text(path).split("\n"):
        words = line.split(None, 1)
        if len(words) == 2:
            yield words[0].lower(), words[1].strip()


def read_obj(path: Path) -> list[trimesh.Trimesh]:
    """Return the meshes of an OBJ file, one for each material, with their colours.

    Raises:
        MechSearchError: Naming the line, if it has an index of nothing, a face of fewer than three
            corners or that crosses itself, or no number where one belongs; or naming a texture
            that is damaged.
    """
    text = _text(path)
    rows: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
    faces: dict[tuple[str, int], Polygons] = {}
    known: dict[str, Corner] = {}
    material = ""
    for number, line in enumerate(text.split("\n"), start=1):
        word, *words = line.split() or [""]
        if "#" in line and word != "usemtl":
            word, *words = line.partition("#")[0].split() or [""]
        try:
            if word == "f":
                shared, corners = _corners(words, [len(values) for values in rows.values()], known)
                faces.setdefault((material, shared), []).append((number, corners))
            elif word in rows:
                rows[word].append([float(value) for value in words])
                if len(words) < (1 if word == "vt" else 3):
                    raise ValueError(f"{len(words)} numbers; expected {1 if word == 'vt' else 3}")
            elif word == "usemtl":
                material = " ".join(words)
        except ValueError as error:
            raise MechSearchError(f"line {number}: {error}") from None
    materials = _materials(path, text)
    # Reversed, as the reader before this one had them: their order decides the last bits.
    return [
        _piece(rows, [k for k in range(3) if shared >> k & 1], polygons, materials.get(name))
        for (name, shared), polygons in reversed(faces.items())
    ]


def _corners(
    words: Sequence[str], counts: Sequence[int], known: dict[str, Corner]
) -> tuple[int, list[Corner]]:
    """Return which of v, vt and vn all corners of a face have (bits 0 to 2), and the corners."""
    if len(words) < 3:
        raise ValueError(f"a face of {len(words)} corners; expected at least 3")
    corners, shared = [], 0b111
    for word in words:
        corner = known.get(word)
        if corner is None:
            corner = _corner(word.split("/"), counts)
            if "-" not in word:
                known[word] = corner
        corners.append(corner)
        shared &= corner[3]
    return shared, corners


def _corner(words: Sequence[str], counts: Sequence[int]) -> Corner:
    found = [_index(*pair) if pair[0] else 0 for pair in zip(words, counts, strict=False)]
    present = sum(1 << k for k, word in enumerate(words) if word)
    if not present & 1 or len(words) > 3:
        raise ValueError(f"the corner {'/'.join(words)!r}; expected v, v/vt, v//vn or v/vt/vn")
    return (*found, 0, 0)[0], (*found, 0, 0)[1], (*found, 0, 0)[2], present


def _index(text: str, count: int) -> int:
    """Return an index from 0; a negative one counts back from the last of `count` so far."""
    index = int(text)
    found = index - 1 if index > 0 else count + index
    if index == 0 or found < 0:
        raise ValueError(f"index {text}; expected 1 and up, or -1 to -{count}")
    return found


def _piece(
    rows: dict[str, list[list[float]]],
    columns: Sequence[int],
    polygons: Polygons,
    material: SimpleMaterial | None,
) -> trimesh.Trimesh:
    """Return the faces of one material as a mesh; corners that differ in anything are apart."""
    vertices = np.array([row[:3] for row in rows["v"]])
    counts = {k: len(values) for k, values in enumerate(rows.values()) if k in columns}
    triangles = _triangulated(polygons, counts, vertices)
    if len(columns) > 1:
        faces, *used = _unmerge_faces(*np.moveaxis(triangles, 2, 0))
    else:
        indices, faces = np.unique(triangles[:, :, 0], return_inverse=True)
        faces, used = faces.reshape(-1, 3), [indices]
    uv = visual = colours = None
    if 1 in columns:
        uv = np.array([(*row, 0.0)[:2] for row in rows["vt"]])[used[columns.index(1)]]
    if material or uv is not None:
        visual = _texture_visuals(uv=uv, material=material)
    if all(len(row) >= 6 for row in rows["v"]):
        colours = np.array([row[3:6] for row in rows["v"]])[used[0]]
    return trimesh.Trimesh(
        vertices[used[0]], faces, visual=visual, vertex_colors=colours, process=False
    )


def _materials(path: Path, text: str) -> dict[str, SimpleMaterial]:
    """Return colour and texture of each material, by name."""
    found: dict[str, dict[str, Any]] = {}
    for _, file in _material_files(path, text):
        if file is None:
            continue
        named: dict[str, Any] = {}
        for key, rest in _statements(file):
            if key == "newmtl":
                named = found[" ".join(rest.split())] = {}
            elif key == "kd" and re.fullmatch(rf"(?:{_NUMBER}){{1,3}}", f" {rest}"):
                named["diffuse"] = (3 * [float(value) for value in rest.split()])[:3]
            elif key == "map_kd":
                texture = _texture(rest, path, file)
                named |= {"image": _image(texture)} if texture else {}
    return {name: _simple_material(**values) for name, values in found.items()}


def _image(path: Path) -> Image.Image:
    try:
        with Image.open(path) as image:
            return image.convert("RGB")
    except Exception as error:  # noqa: BLE001  (decoders of images raise anything)
        raise MechSearchError(f"the texture {path} is damaged: {error}") from None


def _triangulated(
    polygons: Polygons, counts: dict[int, int], vertices: Floats
) -> NDArray[np.int64]:
    """Return triangles (F, 3, C) of indices that fill polygons.

    Args:
        polygons: Faces with the same C of v, vt and vn.
        counts: How many there are of each of these.
        vertices: (V, 3).

    Raises:
        MechSearchError: Naming the line of a face with an index too high, or that crosses itself.
    """
    sizes = np.array([len(corners) for _, corners in polygons])
    cut: list[NDArray[np.int64]] = [np.zeros(0, np.int64)] * len(polygons)
    for size in np.unique(sizes):
        chosen = np.flatnonzero(sizes == size)
        corners = np.array([polygons[i][1] for i in chosen])[:, :, list(counts)]
        for m, k, c in np.argwhere(corners >= list(counts.values()))[:1]:
            raise MechSearchError(
                f"line {polygons[chosen[m]][0]}: index {corners[m, k, c] + 1}; the file has "
                f"{list(counts.values())[c]} {('v', 'vt', 'vn')[list(counts)[c]]} lines"
            )
        fan = [(0, 1, 2), (2, 3, 0)] if size == 4 else [(0, k, k + 1) for k in range(1, size - 1)]
        filled = corners[:, fan]
        points = vertices[corners[:, :, 0]]
        points = points - points[:, :1]
        areas = np.cross(points[:, 1:-1], points[:, 2:])
        normals = areas.sum(axis=1)
        along = np.einsum("mkd,md->mk", areas, normals)
        total = np.linalg.norm(areas, axis=2).sum(axis=1)
        void = np.linalg.norm(normals, axis=1) < 1e-9 * total
        overlaps = np.abs(along).sum(axis=1) > (1 + OVERLAP) * along.sum(axis=1)
        for m in np.flatnonzero(overlaps | void):
            try:
                if void[m]:
                    raise ValueError("a face that crosses itself")
                filled[m] = corners[m][ears(_flat(points[m], normals[m]))]
            except ValueError as error:
                raise MechSearchError(f"line {polygons[chosen[m]][0]}: {error}") from None
        if size == 4 and len(chosen) == len(polygons):
            return np.concatenate(list(filled.swapaxes(0, 1)))
        for i, triangles in zip(chosen, filled, strict=True):
            cut[i] = triangles
    return np.concatenate(cut)


def _flat(points: Floats, normal: Floats) -> Floats:
    """Return points (K, 2) seen against a normal, so that they go round counter-clockwise."""
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    axes = np.stack([across, np.cross(normal, across)], axis=1)
    return np.asarray(points @ (axes / np.linalg.norm(axes, axis=0)))


def ears(points: Floats) -> list[tuple[int, int, int]]:
    """Return triangles, corners of a polygon (K, 2), that fill it: an ear is cut off at a time.

    Args:
        points: Its corners, counter-clockwise; two may touch, as where a hole is cut open.

    Raises:
        ValueError: If it crosses itself.
    """
    left = list(range(len(points)))
    tolerance = 1e-9 * float(np.ptp(points, axis=0).max()) ** 2
    found = []
    while len(left) > 3:
        flat = None
        for place in range(len(left)):
            ear = left[place - 1], left[place], left[(place + 1) % len(left)]
            a, b, c = points[list(ear)]
            area = _turn(a, b, c)
            if area > tolerance:
                others = points[[k for k in left if k not in ear]]
                others = others[~(others[:, None] == (a, b, c)).all(axis=2).any(axis=1)]
                sides = [_turn(a, b, others), _turn(b, c, others), _turn(c, a, others)]
                if not (np.min(sides, axis=0) >= -tolerance).any():
                    break
            elif area >= -tolerance and flat is None:
                flat = place, ear
        else:
            if flat is None:
                raise ValueError("a face that crosses itself")
            place, ear = flat
        found.append(ear)
        del left[place]
    if _turn(*points[left]) < -tolerance:
        raise ValueError("a face that crosses itself")
    return [*found, (left[0], left[1], left[2])]


def _turn(a: Floats, b: Floats, c: Floats) -> Any:
    """Return twice the area of triangles whose last corners are c (..., 2); negative clockwise."""
    return (b[0] - a[0]) * (c[..., 1] - a[1]) - (b[1] - a[1]) * (c[..., 0] - a[0])


def _check_stl(content: bytes) -> None:
    """Refuse an STL file that is cut off: the reader would find it empty.

    Raises:
        MechSearchError: With the triangles it should have and those it has.
    """
    announced = int.from_bytes(content[80:84], "little")
    if len(content) >= 84 and len(content) == 84 + 50 * announced:
        return
    if re.match(rb"\s*solid\b", content, re.IGNORECASE) and re.search(rb"\sfacet\s", content):
        begun, ended, corners = (
            len(re.findall(rb"^\s*" + word, content, re.IGNORECASE | re.MULTILINE))
            for word in (rb"facet\b", rb"endfacet\b", rb"vertex\b")
        )
        if begun == ended and corners == 3 * ended and re.search(rb"(?i)endsolid", content):
            return
        raise MechSearchError(f"it is truncated: it breaks off after {ended} triangles")
    if not content.strip() or re.fullmatch(rb"(?i)\s*solid\b.*endsolid\b.*", content, re.DOTALL):
        return
    if len(content) < 84:
        raise MechSearchError(f"it is damaged: {len(content)} bytes; expected at least 84")
    whole, rest = divmod(len(content) - 84, 50)
    raise MechSearchError(
        f"it is damaged or truncated: expected {announced} triangles, found {whole}"
        f"{' and a part of one' if rest else ''}"
    )
