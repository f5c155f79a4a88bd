"""Teachers by name: the paper's three, and users' own."""

from collections.abc import Callable
from functools import partial

from mechsearch.entry_point import is_entry_point, load_entry_point
from mechsearch.pushes import spiral, straight, zigzag
from mechsearch.teachers.teacher import PushTeacher, Teacher
from mechsearch.types import MechSearchError

TEACHERS: dict[str, Callable[[], Teacher]] = {
    "straight": partial(PushTeacher, straight),
    "zigzag": partial(PushTeacher, zigzag),
    "spiral": partial(PushTeacher, spiral),
}
"""What makes each teacher that has a name. Nothing is done for all of them: whoever means the
paper's three says so."""

PAPER_TEACHERS = ("straight", "zigzag", "spiral")
"""The teachers of the paper (section III-C)."""


def check_teacher(spec: str) -> None:
    """Check a teacher's name without making it.

    Raises:
        MechSearchError: If it is neither in `TEACHERS` nor has the form `package.module:factory`.
    """
    if spec not in TEACHERS and not is_entry_point(spec):
        raise MechSearchError(
            f"unknown teacher {spec!r}; choose among {', '.join(TEACHERS)}, or name a function or "
            "class that makes one as package.module:factory"
        )


def make_teacher(spec: str) -> Teacher:
    """Return the teacher that a text names.

    Args:
        spec: A name in `TEACHERS`, or `package.module:factory`, a function without arguments, or a
            class, that returns a `Teacher`.

    Raises:
        MechSearchError: If there is no such teacher, or it cannot be made.
    """
    check_teacher(spec)
    teacher = (TEACHERS.get(spec) or load_entry_point(spec, "teacher"))()
    if not isinstance(teacher, Teacher):
        needed = ("keys", "reset", "act", "state", "restore")
        missing = [name for name in needed if not hasattr(teacher, name)]
        raise MechSearchError(
            f"teacher {spec!r} gives a {type(teacher).__name__} without {', '.join(missing)}; "
            "a teacher has keys, reset(rng), act(obs), state() and restore(state)"
        )
    return teacher
