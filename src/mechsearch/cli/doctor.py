"""`mechsearch doctor`: what works on this machine, what is missing, and how to get it.

A broken installation is what it is for, so that it imports each part only when it asks about it.
"""

import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.metadata import version
from typing import Self

import numpy as np
import tyro

import mechsearch
from mechsearch.files import cache_folder, check_place
from mechsearch.types import EXTRAS, MechSearchError, check_extra

_NEEDED_BY = {
    "learn": "`mechsearch train`, `grasp`, or a policy that was trained",
    "report": "`mechsearch report`",
    "meshes": "an object made from a mesh file, such as those of YCB,",
    "ray": "work on many machines",
    "bullet": "`mechsearch evaluate --engine bullet`",
    "video": "an MP4 film (a GIF does not)",
    "export": "`mechsearch export policy`",
    "dds": "a robot over ROS 2's messages",
    "calibration": "`mechsearch robot calibrate`",
    "robot": "an exported policy, or a recorded bag,",
    "arms": "an episode on a robot arm",
}
_ACTIONS = 10


@dataclass(frozen=True)
class Doctor:
    """Say what works on this machine, what is missing, and how to get it.

    Exits with 0 if all works that needs no optional part, else with 1.

    Attributes:
        objects: Object set to look for too: "ycb", or a folder of meshes.
    """

    objects: str = ""

    @classmethod
    def parse(cls, program: str, words: Sequence[str]) -> Self:
        """Return the options that words on the command line give."""
        return tyro.cli(cls, prog=program, args=list(words))

    def check_places(self) -> None:
        """Allow everything: nothing is written."""

    def interrupted(self, words: Sequence[str]) -> str:
        """Return what an interruption leaves."""
        del words
        return "nothing was changed"

    def run(self) -> None:
        """Ask about each part, and print a line of it."""
        base: dict[str, Callable[[], str]] = {
            "Python": lambda: (
                f"{platform.python_version()}, {platform.system()} {platform.machine()}"
            ),
            "cores": lambda: str(import_module("mechsearch.processes").PROCESSORS),
            "MuJoCo": _engine,
            "embree": _ray,
            "cache": _cache,
            "heap": _heap,
        }
        broken = [name for name, ask in base.items() if not _told(name, ask)]
        for extra, (name, module) in EXTRAS.items():
            try:
                check_extra(_NEEDED_BY[extra], extra)
            except MechSearchError as error:
                _say("missing", name, error)
            else:
                _told(name, partial(_version, module))
        if self.objects:
            _told("objects", lambda: _objects(self.objects))
        if broken:
            raise SystemExit(1)


def _told(name: str, ask: Callable[[], str]) -> bool:
    """Tell what was found, or what went wrong; return whether it works."""
    try:
        _say("works", name, ask())
    except Exception as error:  # noqa: BLE001  What goes wrong is what to tell, whatever it is.
        kind = "" if isinstance(error, MechSearchError) else f"{type(error).__name__}: "
        _say("broken", name, f"{kind}{error}")
        return False
    return True


def _say(state: str, name: str, text: object) -> None:
    print(f"{state:8}{name:13}{' '.join(str(text).split())}", flush=True)


def _engine() -> str:
    found, wanted = import_module("mujoco").__version__, version("mujoco-core")
    if found != wanted:
        raise MechSearchError(
            f"`import mujoco` gives {found} where mujoco-core {wanted} was installed: the package "
            "mujoco lies in the same folder; `pip uninstall mujoco`, then `pip install "
            f"--force-reinstall --no-deps mujoco-core=={wanted}`"
        )
    return str(found)


def _ray() -> str:
    """Cast a ray from 2 m above the middle of a triangle."""
    scene = import_module("embreex.rtcore_scene").EmbreeScene()
    corners = np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], np.float32)
    mesh = import_module("embreex.mesh_construction").TriangleMesh(scene, corners)
    start, down = np.array([[0, 0, 2]], np.float32), np.array([[0, 0, -1]], np.float32)
    distance = scene.run(start, down, query="DISTANCE").item()
    del mesh
    if distance != 2:
        raise MechSearchError(f"a ray met a triangle after {distance:g} m; expected 2")
    return version("embreex")


def _cache() -> str:
    folder = cache_folder()
    try:
        check_place(folder / "new")
    except MechSearchError as error:
        raise MechSearchError(f"{error}; MECHSEARCH_CACHE names another folder") from None
    return f"{folder} may be written to"


def _heap() -> str:
    """Act in an embedded heap, and draw it."""
    env = mechsearch.make_env(render_mode="rgb_array")
    env.reset(seed=0)
    env.action_space.seed(0)
    began = time.perf_counter()
    for _ in range(_ACTIONS):
        env.step(env.action_space.sample())
    action = (time.perf_counter() - began) / _ACTIONS
    picture = env.render()
    if picture is None or picture.min() == picture.max():
        raise MechSearchError("the picture of a heap shows nothing")
    return (
        f"{len(env.heap.objects)} objects; an action with images takes {1000 * action:.1f} ms, "
        f"the picture has {picture.shape[1]} x {picture.shape[0]} px"
    )


def _version(name: str) -> str:
    """Return a module's version; FFmpeg is a program, whose own is asked."""
    module = import_module(name)
    ask = getattr(module, "get_ffmpeg_version", None)
    return str(ask() if ask else getattr(module, "__version__", None) or version(name))


def _objects(spec: str) -> str:
    catalog = import_module("mechsearch.objects.catalog")
    folder = catalog.ycb_folder() if spec == "ycb" else spec
    return f"{len(catalog.find_meshes(folder))} meshes in {folder}"
