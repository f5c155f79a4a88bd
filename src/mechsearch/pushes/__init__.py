"""Pushes: their shapes, the route that carries one out, and how one looks to a camera."""

from mechsearch.pushes.push import KINDS, Push, Shape, draw_pushes, spiral, straight, zigzag
from mechsearch.pushes.route import PlannedPush, Route, RouteConfig
from mechsearch.pushes.sight import Sight, look
from mechsearch.pushes.view import (
    MIRRORED_NUMBERS,
    NUMBERS,
    PATCH,
    STRAIGHT_NUMBER,
    PushViews,
    view_pushes,
)
