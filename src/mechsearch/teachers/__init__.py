"""Scripted policies on privileged positions, which suggest actions while learning."""

from mechsearch.teachers.registry import PAPER_TEACHERS, TEACHERS, check_teacher, make_teacher
from mechsearch.teachers.teacher import PushTeacher, Teacher
