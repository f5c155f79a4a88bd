"""Scripted policies on privileged positions, which suggest actions while learning."""

from mechsearch.teachers.spiral import SpiralTeacher
from mechsearch.teachers.straight import StraightTeacher
from mechsearch.teachers.teacher import PushConfig, Teacher
from mechsearch.teachers.zigzag import ZigzagTeacher

TEACHERS = {"straight": StraightTeacher, "zigzag": ZigzagTeacher, "spiral": SpiralTeacher}


def make_teachers(direction: float | None = None) -> dict[str, Teacher]:
    """Return one teacher of each kind; `direction` [rad] fixes their first push."""
    return {name: kind(direction) for name, kind in TEACHERS.items()}


def make_teacher(name: str) -> Teacher:
    """TEMPORARY."""
    return TEACHERS[name]()


__all__ = ["TEACHERS", "PushConfig", "Teacher", "make_teachers"]
