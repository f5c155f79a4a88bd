"""Images of heaps with the mask of every object: what a segmentation learns from, and is tested on.

Objects are those of the heaps and, at chance, variants of these and of others in their places.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mechsearch.camera import Camera, look_at, preset
from mechsearch.files import alone, read_arrays, read_record, write_record, write_whole
from mechsearch.heaps.dataset import Heap, HeapSet, check_objects, load_heaps, object_set
from mechsearch.objects.model import ObjectModel
from mechsearch.observe.masks import at_size, picked_rows
from mechsearch.observe.sensor import sensor_named
from mechsearch.processes import Progress, map_in_order, silent
from mechsearch.render.renderer import BACKGROUND, Renderer
from mechsearch.segmentation.light import direction, in_other_light
from mechsearch.segmentation.reference import FULL, References, render_references
from mechsearch.segmentation.variants import variant
from mechsearch.sim import Pusher, pusher_model
from mechsearch.types import Array, Floats, MechSearchError

MOST_OBJECTS = 24
"""In an image."""

_MANIFEST_FILE, _LIBRARY_FILE = "images.json", "references.npz"
_FORMAT, _PURPOSE = 3, "manifest of segmentation images"


@dataclass(frozen=True)
class ImageConfig:
    """What images are made.

    Attributes:
        views: Images of each heap.
        split: "train" or "held-out" heaps.
        limit: Number of heaps, spread evenly; 0 takes all.
        sensors: Sensor models, drawn for each image.
        randomised: Whether light, colours of table and objects, camera and objects are drawn;
            otherwise images are as policies see them.
        also: Object sets whose objects and variants lie in some objects' places.
        variants: Of each object.
        without: Objects that are in no image; others lie in their places.
        shard: Heaps in a file.
        seed: Of all randomness.
    """

    views: int = 6
    split: str = "train"
    limit: int = 0
    sensors: tuple[str, ...] = ("stereo", "stereo", "stereo", "time-of-flight", "harsh", "perfect")
    randomised: bool = True
    also: tuple[str, ...] = ("household",)
    variants: int = 8
    without: tuple[str, ...] = ()
    shard: int = 30
    seed: int = 0

    def __post_init__(self) -> None:
        for name in self.sensors:
            sensor_named(name)
        if self.split not in ("train", "held-out", "all"):
            raise MechSearchError(
                f"unknown split {self.split!r}; choose one of train, held-out, all"
            )
        if self.views < 1 or self.shard < 1 or self.variants < 0 or not self.sensors:
            raise MechSearchError(
                f"{self.views} views, {self.shard} heaps in a file, {self.variants} variants, "
                f"{len(self.sensors)} sensors; expected at least 1, 1, 0 and 1"
            )


@dataclass(frozen=True, eq=False)
class Images:
    """Images (n,), and what they show.

    Attributes:
        rgb: Colours (n, G, G, 3) uint8; G is `FULL`.
        depth: As measured (n, G, G) uint16 [mm]; 0 in holes.
        ids: What each pixel shows (n, G, G) uint8: 0 no object, else its place in `objects` and 1.
        camera: Where it is believed to be (n, 20): fx, fy, cx, cy [px], then its pose.
        objects: In the library of references (n, `MOST_OBJECTS`) int16; -1 beyond the last.
        hidden: Share of each object that other objects hide (n, `MOST_OBJECTS`), in [0, 1].
        target: Place of the heap's own target (n,); -1 where it is not there.
        heap: Seed of the heap (n,).
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.uint16]
    ids: NDArray[np.uint8]
    camera: NDArray[np.float32]
    objects: NDArray[np.int16]
    hidden: NDArray[np.float32]
    target: NDArray[np.int16]
    heap: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.heap)

    @property
    def side(self) -> int:
        """Of the images [px]."""
        return int(self.rgb.shape[1])

    @classmethod
    def concatenated(cls, parts: Sequence[Self]) -> Self:
        """Return all images of at least one part."""
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))

    def where(self, keep: Array) -> "Images":
        """Return some, by a mask (n,) or indices."""
        return Images(*(getattr(self, f.name)[keep] for f in fields(self)))

    def apart(self, share: float) -> tuple[Array, Array]:
        """Return indices of images to learn from, and of those of a share of heaps kept apart.

        Raises:
            MechSearchError: If there is only one heap.
        """
        heaps = np.unique(self.heap)
        held = heaps[:: max(2, round(1 / share))]
        learn, check = (np.flatnonzero(np.isin(self.heap, held) == own) for own in (False, True))
        if not len(learn):
            raise MechSearchError(f"images of {len(heaps)} heap; expected at least 2")
        return learn, check

    def seen(self, index: int, side: int = FULL) -> tuple[Array, Array, Camera]:
        """Return an image's colours, depth [m], 0 in holes, and camera, at a size [px]."""
        fx, fy, cx, cy, *pose = self.camera[index].astype(np.float64).tolist()
        depth = self.depth[index].astype(np.float32) / 1000
        camera = Camera(FULL, FULL, fx, fy, cx, cy, tuple(pose))
        return at_size(self.rgb[index], depth, camera, side)

    def shown(self, index: int, side: int) -> NDArray[np.uint8]:
        """Return what each pixel shows, see `ids`, at a size [px]."""
        picked = picked_rows(FULL, side)
        shown: NDArray[np.uint8] = self.ids[index][np.ix_(picked, picked)]
        return shown


@dataclass(frozen=True, eq=False)
class Course:
    """What became of a heap while something pushed it about.

    Attributes:
        heap: As it was at first.
        poses: Of its objects (T, N, 7).
        tips: Of the end effector (T, 3) [m].
    """

    heap: Heap
    poses: Floats
    tips: Floats


@dataclass(frozen=True, eq=False)
class ImageSet:
    """Images and the objects on them.

    Attributes:
        images: The images.
        references: Of all objects, by number.
        names: Theirs.
    """

    images: Images
    references: list[References]
    names: list[str]


@dataclass(frozen=True, eq=False)
class Library:
    """Objects and their variants, by number: `count` objects, then the variants of each in turn."""

    models: tuple[ObjectModel, ...]
    known: int
    radii: Floats


def make_images(
    heaps: Path,
    objects: str,
    config: ImageConfig,
    path: Path,
    workers: int = 1,
    progress: Progress = silent,
    courses: Mapping[int, tuple[Floats, Floats]] | None = None,
) -> None:
    """Fill a folder with images; go on if it was cut off.

    Args:
        heaps: File of a heap set.
        objects: Object set, as given to `load_object_set`; empty takes the heap set's own.
        config: What images.
        path: The folder.
        workers: Processes; the images do not depend on their number.
        progress: Told after each heap.
        courses: Poses (T, N, 7) of objects and tips (T, 3) of the end effector, by the seed of the
            heap that was pushed about: these heaps alone are shown, at moments that are drawn.
            None shows heaps as they were dropped.

    Raises:
        MechSearchError: If the heap set is missing, the objects are others, the folder holds other
            images, another process fills it, or a heap that was pushed about is of another split.
    """
    heap_set, objects = _opened(heaps, objects)
    with alone(path / "images", f"the images {path}"):
        plain = {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(config).items()}
        manifest = {"format": _FORMAT, "config": plain, "heap_set": heap_set.hash}
        if courses is not None:
            manifest["courses"] = _digest(courses)
        file = path / _MANIFEST_FILE
        if not file.exists():
            write_record(file, _PURPOSE, manifest)
        found = read_record(file, _PURPOSE, ("format", "config", "heap_set"))
        known = dict.fromkeys((*manifest, *found))
        differing = ", ".join(k for k in known if found.get(k) != manifest.get(k))
        if differing:
            raise MechSearchError(
                f"{path} holds images made from another {differing}; name another folder"
            )
        if not (path / _LIBRARY_FILE).exists():
            _write_library(path / _LIBRARY_FILE, objects, config, workers, progress)
        chosen = _shown(heap_set, config, courses)
        make = partial(_images_of, objects=objects, config=config)
        parts = {
            path / f"images-{start // config.shard:05d}.npz": chosen[start : start + config.shard]
            for start in range(0, len(chosen), config.shard)
        }
        missing = {file: part for file, part in parts.items() if not file.exists()}
        done = len(chosen) - sum(map(len, missing.values()))
        made = map_in_order(make, chain.from_iterable(missing.values()), workers)
        for file, part in missing.items():
            images = []
            for _ in part:
                images.append(next(made))
                done += 1
                progress("heaps", done, len(chosen))
            _write_arrays(file, vars(Images.concatenated(images)))


def see_heaps(
    heaps: Path,
    objects: str,
    config: ImageConfig,
    workers: int = 1,
    progress: Progress = silent,
) -> ImageSet:
    """Return images of heaps as `load_images` does, without writing any; see `make_images`.

    Of a set with fewer heaps than the configuration's limit, all are taken.
    """
    heap_set, objects = _opened(heaps, objects)
    most = min(config.limit, len(heap_set.choose(config.split)))
    chosen = [heap_set.heaps[i] for i in heap_set.choose(config.split, most)]
    parts = []
    for part in map_in_order(partial(_images_of, objects=objects, config=config), chosen, workers):
        parts.append(part)
        progress("heaps", len(parts), len(chosen))
    images, models = Images.concatenated(parts), _library(objects, config).models
    placed = images.objects >= 0
    used, images.objects[placed] = np.unique(images.objects[placed], return_inverse=True)
    shown = [models[number] for number in used]
    references = [render_references(model) for model in shown]
    return ImageSet(images, references, [model.name for model in shown])


def _shown(
    heap_set: HeapSet, config: ImageConfig, courses: Mapping[int, tuple[Floats, Floats]] | None
) -> list[Heap] | list[Course]:
    if courses is None:
        return [heap_set.heaps[i] for i in heap_set.choose(config.split, config.limit)]
    known = {heap_set.heaps[i].seed: heap_set.heaps[i] for i in heap_set.choose(config.split)}
    strange = [seed for seed in courses if seed not in known]
    if strange or not courses:
        raise MechSearchError(
            f"{len(strange)} of {len(courses)} episodes are on no heap of the split "
            f"{config.split}; expected at least one, and all of them on such"
        )
    return [Course(known[seed], *states) for seed, states in courses.items()]


def _digest(courses: Mapping[int, tuple[Floats, Floats]]) -> str:
    content = hashlib.sha256()
    for seed, (poses, tips) in courses.items():
        content.update(str(seed).encode() + poses.tobytes() + tips.tobytes())
    return content.hexdigest()


def _opened(heaps: Path, objects: str) -> tuple[HeapSet, str]:
    """Return a heap set, and the object set that it was certainly made with."""
    heap_set = load_heaps(heaps)
    named = objects or heap_set.objects
    check_objects(heap_set, object_set(named))
    return heap_set, named


def load_images(paths: Sequence[Path], progress: Progress = silent) -> ImageSet:
    """Return the images of folders, and the objects on them.

    Args:
        paths: That `make_images` filled, at least one.
        progress: Told after each file.

    Raises:
        MechSearchError: If a folder has none, or a file is damaged.
    """
    parts, references, names = [], list[References](), list[str]()
    for path in paths:
        read_record(path / _MANIFEST_FILE, _PURPOSE, ("format", "config", "heap_set"))
        files = sorted(path.glob("images-*.npz"))
        if not files or not (path / _LIBRARY_FILE).exists():
            raise MechSearchError(
                f"{path} holds no images yet; `mechsearch segment images` makes them"
            )
        for done, file in enumerate(files, start=1):
            part = Images(**read_arrays(file, "file of segmentation images"))
            part.objects[part.objects >= 0] += len(references)
            parts.append(part)
            progress(f"files of {path}", done, len(files))
        library = read_arrays(path / _LIBRARY_FILE, "library of references")
        rows = zip(library["rgb"], library["mask"], library["width"], strict=True)
        references += [References(*views) for views in rows]
        names += library["name"].tolist()
    return ImageSet(Images.concatenated(parts), references, names)


@cache
def library_of(
    objects: str, also: tuple[str, ...], variants: int, without: tuple[str, ...], seed: int
) -> Library:
    """Return the objects of several sets and their variants, made once in each process."""
    models = [
        model
        for spec in (objects, *also)
        for name, model in object_set(spec).models.items()
        if name not in without
    ]
    more = [
        variant(model, np.random.default_rng([seed, index, number]))
        for index, model in enumerate(models)
        for number in range(variants)
    ]
    known = (*models, *more)
    return Library(known, len(models), np.array([model.radius for model in known]))


def _library(objects: str, config: ImageConfig) -> Library:
    return library_of(objects, config.also, config.variants, config.without, config.seed)


def _references(index: int, objects: str, config: ImageConfig) -> References:
    return render_references(_library(objects, config).models[index])


def _write_library(
    file: Path, objects: str, config: ImageConfig, workers: int, progress: Progress
) -> None:
    models = _library(objects, config).models
    render = partial(_references, objects=objects, config=config)
    found = []
    for references in map_in_order(render, range(len(models)), workers):
        found.append(references)
        progress("references", len(found), len(models))
    arrays = {
        "rgb": np.stack([r.rgb for r in found]), "mask": np.stack([r.mask for r in found]),
        "width": np.stack([r.width for r in found]), "name": np.array([m.name for m in models]),
    }  # fmt: skip
    _write_arrays(file, arrays)


def _write_arrays(file: Path, arrays: Mapping[str, Array]) -> None:
    write_whole(file, lambda to: np.savez_compressed(to, allow_pickle=False, **arrays))


def _images_of(shown: Heap | Course, objects: str, config: ImageConfig) -> Images:
    """Return the images of one heap, a pure function of its arguments."""
    seed = (shown.heap if isinstance(shown, Course) else shown).seed
    rngs = (np.random.default_rng([config.seed, seed, n]) for n in range(config.views))
    return Images.concatenated([
        _image_of(shown, objects, config, number, rng) for number, rng in enumerate(rngs)
    ])  # fmt: skip


def _image_of(
    shown: Heap | Course, objects: str, config: ImageConfig, number: int, rng: np.random.Generator
) -> Images:
    if isinstance(shown, Course):
        moment = int(rng.integers(len(shown.poses)))
        heap, tip = replace(shown.heap, poses=shown.poses[moment]), shown.tips[moment]
    else:
        heap, tip = shown, None
    library = _library(objects, config)
    drawn, poses, target = _drawn(heap, objects, library, config, rng)
    models = [library.models[index] for index in drawn]
    randomised = config.randomised and rng.random() < 0.8
    camera = _camera(rng) if randomised else preset("overhead", FULL)
    renderer = Renderer(models, pusher_model(Pusher()))
    if randomised:
        renderer.light = direction(rng, 1.2)
    name = config.sensors[rng.integers(len(config.sensors))]
    sensing = sensor_named(name).episode((heap.seed, number, config.seed), len(models))
    seen = sensing.camera(camera)
    if tip is None:
        drawn_tip = np.append(rng.uniform(-0.25, 0.25, 2), rng.uniform(0.0, 0.15))
        tip = drawn_tip if rng.random() < 0.7 else None
    effector = None if tip is None else Pusher().pose(tip)
    frame = renderer.frame(seen, poses, effector, True)
    ids = np.maximum(frame.ids + 1, 0).astype(np.uint8)
    assert frame.rgb is not None
    depth = frame.depth
    if not sensing.is_perfect:
        depth, _ = sensing.take(0, seen, depth, ids > MOST_OBJECTS, frame.ids, frame.rgb)
    rgb = in_other_light(frame.rgb, frame.ids == BACKGROUND, rng) if randomised else frame.rgb
    whole = frame.amodal.sum(axis=(1, 2))
    # The end effector hides nothing for long: what it is in front of is not hidden by others.
    bare = frame if effector is None else renderer.frame(seen, poses)
    visible = np.bincount(bare.ids[bare.ids >= 0], minlength=len(models))
    placed, hidden = np.full(MOST_OBJECTS, -1, np.int16), np.ones(MOST_OBJECTS, np.float32)
    placed[: len(models)], hidden[: len(models)] = drawn, 1 - visible / np.maximum(whole, 1)
    own = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.world_from_camera]
    return Images(
        rgb[None], np.round(np.minimum(depth, 60.0) * 1000).astype(np.uint16)[None], ids[None],
        np.array(own, np.float32)[None], placed[None], hidden[None],
        np.array([target], np.int16), np.array([heap.seed]),
    )  # fmt: skip


def _drawn(
    heap: Heap, objects: str, library: Library, config: ImageConfig, rng: np.random.Generator
) -> tuple[NDArray[np.intp], Floats, int]:
    """Return which of a library lie in an image (N,), their poses (N, 7), and the target's place.

    What takes another object's place is about as large and lies as low.
    """
    known = object_set(objects).models
    numbers = {model.name: index for index, model in enumerate(library.models[: library.known])}
    share = rng.choice([0.0, 0.5, 0.9]) if config.randomised else 0.0
    kept = np.arange(len(heap.objects))
    if config.randomised and rng.random() < 0.3 and len(kept) > 2:
        kept = rng.permutation(kept)[: rng.integers(2, len(kept))]
    chosen: list[int] = []
    poses = np.array(heap.poses[kept], np.float64)
    for pose, place in zip(poses, kept, strict=True):
        model = known[heap.objects[place]]
        index = numbers.get(model.name)
        if index is None or rng.random() < share:
            ratio = library.radii / model.radius
            fitting = np.setdiff1d(np.flatnonzero((ratio > 0.6) & (ratio < 1.5)), chosen)
            index = int(rng.choice(fitting)) if len(fitting) else len(numbers) - 1
            lowest = max(_lowest(model, pose), 0.0)
            pose[2] += lowest - _lowest(library.models[index], pose)
        chosen.append(index)
    target = np.flatnonzero(kept == heap.target)
    return np.array(chosen, np.intp), poses, int(target[0]) if len(target) else -1


def _lowest(model: ObjectModel, pose: Floats) -> float:
    """Return the height of an object's lowest point [m]."""
    down = Rotation.from_quat(pose[3:], scalar_first=True).as_matrix()[2]
    return float((model.vertices @ down).min() + pose[2])


def _camera(rng: np.random.Generator) -> Camera:
    """Return a view of the table: mostly from above, sometimes aslant."""
    tilt = np.deg2rad(rng.uniform(0, 10) if rng.random() < 0.85 else rng.uniform(10, 50))
    around, away = rng.uniform(0, 2 * np.pi), rng.uniform(0.85, 1.15)
    middle = np.append(rng.uniform(-0.03, 0.03, 2), 0.0)
    beside = np.array([np.cos(around), np.sin(around), 0.0])
    eye = middle + away * (np.sin(tilt) * beside + np.array([0.0, 0.0, np.cos(tilt)]))
    up = -beside if tilt > np.deg2rad(10) else np.array([rng.normal(0, 0.1), 1.0, 0.0])
    focal, centre = 368.0 * rng.uniform(0.95, 1.08), (FULL - 1) / 2
    return Camera(FULL, FULL, focal, focal, centre, centre, look_at(eye, middle, up))
