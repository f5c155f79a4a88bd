"""Episodes in three dimensions: one page that needs no other file, and asks nobody.

The page has every body once, as triangles with the colours that the renderer shows, where all of
them are at each moment, and what the policy weighed. `page.html` draws that by WebGL.
"""

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from mechsearch.objects.model import ObjectModel, texel_weights
from mechsearch.pictures.film import Film, path_at
from mechsearch.types import DECISION_NAMES, Array, Floats, Weighed

PAGES = (".html", ".htm")
"""Formats of pages, by suffix."""

_PAGE = Path(__file__).with_name("page.html")

_VERTEX, _PLACE, _TURN = 2e-5, 5e-5, 1 / 32767
"""What a unit of the 16-bit numbers is: of vertices and of places [m], of quaternions."""

_TEXEL_BYTES = 1_400_000
"""So many bytes of colours a page has at most: then it is below 2 MB with three heaps."""

_ROWS = (4, 3, 2, 1)
"""Rows of a triangle's grid of colours, as many as there is room for."""

_SHADES = 0xFC
"""Bits of a colour that are kept: half the bytes remain, and nobody sees it."""


@dataclass(frozen=True, eq=False)
class Shown:
    """An episode as a page shows it.

    Attributes:
        film: Its moments and bodies.
        words: What is said of it.
        weighed: What the policy weighed before each action (T,); empty where it is not known.
    """

    film: Film
    words: str
    weighed: Sequence[Weighed | None] = ()


@dataclass(eq=False)
class Meshes:
    """The bodies of all episodes, each once.

    Attributes:
        models: In the order of their numbers.
    """

    models: list[ObjectModel] = field(default_factory=list)

    def number(self, model: ObjectModel) -> int:
        """Return the number of a model, which is added where it is new."""
        hashes = [known.content_hash for known in self.models]
        if model.content_hash not in hashes:
            self.models.append(model)
            return len(hashes)
        return hashes.index(model.content_hash)

    def described(self) -> list[dict[str, Any]]:
        """Return all of them as the page reads them."""
        faces = sum(len(model.faces) for model in self.models)
        room = _TEXEL_BYTES / (3 * max(faces, 1))
        rows = next((n for n in _ROWS if n * (n + 1) / 2 <= room), _ROWS[-1])
        return [_mesh(model, rows) for model in self.models]


def _mesh(model: ObjectModel, most: int) -> dict[str, Any]:
    """Return vertices, triangles and colours, channel by channel: like beside like packs well."""
    had = round((np.sqrt(8 * model.texels.shape[1] + 1) - 1) / 2)
    rows = min(most, had)
    weights = texel_weights(rows, 1 / 3)[:, 1:] * had
    i = np.minimum(weights[:, 0].astype(int), had - 1)
    j = np.minimum(weights[:, 1].astype(int), had - 1 - i)
    texels = model.texels[:, i * had - i * (i - 1) // 2 + j] & _SHADES
    return {
        "vertices": np.round(model.vertices / _VERTEX).astype("<i2").T,
        "faces": model.faces.astype("<u2").T,
        "texels": np.moveaxis(texels, -1, 0),
        "rows": rows,
    }


def episode_page(title: str, episodes: Mapping[str, Shown], rate: float = 6.0) -> str:
    """Return a page of episodes, the first of which is shown first.

    Args:
        title: At its head.
        episodes: By the name under which each is chosen.
        rate: Moments in a second.
    """
    return viewer_page(title, packed(scene(episodes, rate)))


def scene(episodes: Mapping[str, Shown], rate: float = 6.0) -> dict[str, Any]:
    """Return all that a page shows, as it reads it; see `packed`."""
    meshes = Meshes()
    told = [_episode(name, shown, meshes) for name, shown in episodes.items()]
    return {"episodes": told, "meshes": meshes.described(), "rate": rate}


def viewer_page(title: str, data: str) -> str:
    """Return the page that shows what is packed; "null" is a live one, which asks its server."""
    text = _PAGE.read_text(encoding="utf-8")
    # In JSON a less-than sign stands in texts alone.
    data = data.replace("<", "\\u003c")
    return text.replace("{{title}}", escape(title)).replace("{{data}}", data)


def _episode(name: str, shown: Shown, meshes: Meshes) -> dict[str, Any]:
    film, record = shown.film, shown.film.record
    bodies = [*film.bodies, *([film.pusher] if film.pusher else [])]
    objects = len(record.objects)
    return {
        "name": name,
        "words": shown.words,
        "objects": [each.replace("_", " ") for each in record.objects],
        "target": record.target,
        "bodies": [meshes.number(body) for body in bodies],
        "robot": [i >= objects for i in range(len(bodies))],
        **moments_told(film, 0, shown.weighed),
    }


def moments_told(film: Film, first: int, weighed: Sequence[Weighed | None]) -> dict[str, Any]:
    """Return the moments of a film as the page reads them, from one on.

    Args:
        film: The film.
        first: Number of the first moment.
        weighed: What was weighed before each action (T,).
    """
    record, moments = film.record, film.moments[first:]
    began = [path_at(record, moment) for moment in moments]
    return {
        "poses": _places(film, first),
        "moments": [
            {"step": moment.step, "words": moment.words, "from": moment.step + 1 - len(path[0])}
            if path
            else {"step": moment.step, "words": moment.words}
            for moment, path in zip(moments, began, strict=True)
        ],
        "tips": np.round(record.ee_positions, 5).tolist(),
        "hidden": np.round(record.occlusions, 4).tolist(),
        "reward": np.round(np.cumsum(record.rewards), 3).tolist(),
        "weighed": [
            {"step": step, **_candidates(each)} for step, each in enumerate(weighed) if each
        ],
    }


def _candidates(weighed: Weighed) -> dict[str, Any]:
    """Return what was weighed as the page reads it, the best first."""
    order = np.argsort(-weighed.values, kind="stable").tolist()
    return {
        "measure": weighed.measure,
        "candidates": [
            {
                "kind": DECISION_NAMES[weighed.kinds[i]],
                "value": round(float(weighed.values[i]), 3),
                "way": np.round(weighed.ways[i], 4).tolist(),
                "chosen": i == weighed.chosen,
            }
            for i in order
        ],
    }


def _places(film: Film, first: int) -> Array:
    """Return the poses (7, B, M) of all bodies, each moment as the difference to the one before."""
    rows = []
    for number in range(first, len(film.moments)):
        poses, pusher = film.placed(number)
        own = [] if film.pusher is None else [np.array([0, 0, 50.0, 1, 0, 0, 0])]
        rows.append(np.vstack([poses, *(own if pusher is None else [pusher])]))
    poses = np.stack(rows) / ([_PLACE] * 3 + [_TURN] * 4)
    whole = np.clip(np.round(poses), -32767, 32767).astype(np.int32)
    # Differences may wrap around, and wrap back when they are added up.
    changes = np.diff(whole, axis=0, prepend=np.zeros_like(whole[:1]))
    return np.ascontiguousarray(changes.astype("<u4").astype("<u2").transpose(2, 1, 0)).view("<i2")


def packed(value: Any) -> str:
    """Return JSON values and arrays as JSON: arrays are places in one deflated block of bytes."""
    block = bytearray()

    def place(array: Floats) -> dict[str, Any]:
        block.extend(bytes(-len(block) % 4))
        start = len(block)
        block.extend(np.ascontiguousarray(array).tobytes())
        return {"array": array.dtype.str[1:], "start": start, "shape": array.shape}

    data = json.dumps(value, default=place, separators=(",", ":"))
    text = base64.b64encode(zlib.compress(bytes(block), 9)).decode()
    return f'{{"data":{data},"block":"{text}"}}'
