"""Pushes that a camera can choose among: straight and spiral, seen from images alone."""

from mechsearch.pushes.follow import PushFollower
from mechsearch.pushes.push import KINDS, Push, draw_pushes
from mechsearch.pushes.sight import Sight, look
from mechsearch.pushes.view import NUMBERS, PATCH, PushViews, view_pushes

__all__ = [
    "KINDS",
    "NUMBERS",
    "PATCH",
    "Push",
    "PushFollower",
    "PushViews",
    "Sight",
    "draw_pushes",
    "look",
    "view_pushes",
]
