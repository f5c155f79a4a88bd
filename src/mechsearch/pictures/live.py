"""A live page: somebody watches a policy on a heap, takes over, and keeps the episode.

The page is that of recorded episodes (`pictures.page`); what is pressed on it comes here as one
line of JSON, and what came of it goes back as the page reads it.
"""

import base64
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from PIL import Image

from mechsearch.evaluation.episodes import Evaluation, save_episodes
from mechsearch.evaluation.rollout import (
    RETRIEVAL,
    SHIPPED_POLICIES,
    EvaluationPlan,
    RetrieveEnv,
    RunningEpisode,
    begin,
    goal_of,
    opened,
    planned_header,
    policy_named,
    select,
)
from mechsearch.pictures.film import FilmConfig, Hands, film_of, first_moment, pushed
from mechsearch.pictures.page import Shown, moments_told, packed, scene, viewer_page
from mechsearch.pictures.replay import LiftFrame, carried_out
from mechsearch.types import (
    ACTION_LENGTH,
    ACTOR_KEYS,
    DECISION_SIZE,
    Array,
    MechSearchError,
    Weighed,
)

BY_HAND = "hand"
"""Who acted in an episode in which a person took over."""

OTHERS = ("teacher-spiral", "teacher-zigzag", "teacher-straight", "look-ahead", "random", "idle")
"""Policies to choose among, beside those that are shipped."""

_NEAR, _STUCK = 0.01, 0.003
"""Distance at which a click counts as reached [m], and way of an action that gets nowhere [m]."""

_TALL = 0.12
"""Height above the table from which all is white in an image of depth [m]."""

_TARGET = 1
"""Segment of the target."""

_MOST_ACTIONS, _LONGEST_REQUEST = 16, 10_000
"""Actions that follow a click at most, and bytes of a request."""


_NOTHING = Weighed((), (), np.empty(0), 0, "")
"""What whoever pushes by hand has weighed, as far as a page can tell."""


class LiveSession:
    """One heap, one policy, and whatever is asked for, one thing at a time."""

    def __init__(self, plan: EvaluationPlan, folder: Path) -> None:
        """Open the first heap.

        Args:
            plan: The policy to begin with, and the heaps to choose among.
            folder: Where episodes are kept.

        Raises:
            MechSearchError: If the plan cannot be carried out.
        """
        self._given, self._folder, self._lock = plan, folder, Lock()
        self._commands: dict[str, Callable[[Mapping[str, Any]], dict[str, Any]]] = {
            "open": self._open, "step": self._step, "push": self._push, "go": self._go,
            "wait": self._wait, "save": self._save,
        }  # fmt: skip
        names = dict.fromkeys((str(plan.policy), *SHIPPED_POLICIES, *RETRIEVAL, *OTHERS))
        self._policies = [[name, name] for name in names]
        self._begin(str(plan.policy), None)

    def answer(self, request: bytes) -> str:
        """Return what came of a request, packed for the page: `error` says what was wrong with it.

        Args:
            request: A JSON object: `do`, and what that needs.
        """
        with self._lock:
            try:
                told = self._carry_out(request)
            except MechSearchError as error:
                told = {"error": " ".join(str(error).split())}
            return packed(told)

    def _carry_out(self, request: bytes) -> dict[str, Any]:
        try:
            asked = dict(json.loads(request))
        except (ValueError, TypeError):
            raise MechSearchError("a request that is no JSON object") from None
        command = self._commands.get(str(asked.get("do")))
        if command is None:
            raise MechSearchError(
                f"unknown request {asked.get('do')!r}; choose one of {', '.join(self._commands)}"
            )
        return command(asked)

    def _begin(self, policy: str, heap: int | None) -> None:
        """Put a heap on the table, in front of a policy."""
        plan = replace(self._given, policy=policy, name="")
        if goal_of(policy_named(policy)) == "uncover":
            plan = replace(plan, grippers=())
        who, env, indices = opened(plan, ACTOR_KEYS)
        index = indices[0] if heap is None else heap
        if index not in indices:
            raise MechSearchError(f"heap {index} is none of these; choose one of {indices[:5]} ...")
        episode = RunningEpisode(env, index, plan.title)
        begin(who, env, plan.seed, plan.title)
        self._plan, self._who, self._env, self._episode = plan, who, env, episode
        self._index, self._indices, self._by_hand = index, indices, False
        self._header, record = planned_header(plan), episode.record
        self._weighed: list[Any] = []
        retrieves = isinstance(env, RetrieveEnv)
        self._hands = Hands(self._header) if retrieves else None
        self._moments = [first_moment(record)] if retrieves else [*pushed(record)]

    def _open(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """Begin anew, on another heap or with another policy if it is said which."""
        heap = str(asked.get("heap", self._index))
        if not heap.isdecimal():
            raise MechSearchError(f"heap is {heap!r}; expected the number of a heap")
        self._begin(str(asked.get("policy", self._plan.policy)), int(heap))
        heaps = self._env.heaps
        named = [
            [i, f"{i}: {heaps[i].objects[heaps[i].target].replace('_', ' ')} of "
             f"{len(heaps[i].objects)}, {heaps[i].occlusion:.0%} hidden"]
            for i in self._indices
        ]  # fmt: skip
        state = self._state() | {"heaps": named, "policies": self._policies}
        shown = {"now": Shown(self._film(), f"{self._plan.title} on heap {self._env.heap.seed}")}
        return scene(shown) | {"state": state}

    def _step(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """Let the policy act once."""
        first = len(self._moments)
        action = self._who.act(select(self._episode.obs, self._who.keys))
        self._act(action, getattr(self._who, "weighed", None))
        return self._more(first)

    def _push(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """Push once by hand: `way` (3,) is a displacement in [-1, 1]."""
        first = len(self._moments)
        self._act_by_hand(_three(asked, "way"))
        return self._more(first)

    def _go(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """Push by hand towards a point `to` (3,) [m], until it is reached or nothing moves."""
        first, point = len(self._moments), self._env.config.workspace.clip(_three(asked, "to"))
        for _ in range(_MOST_ACTIONS):
            before = self._env.state.ee_position
            way = point - before
            if self._episode.end or np.linalg.norm(way) < _NEAR:
                break
            self._act_by_hand(way / max(float(np.linalg.norm(way)), ACTION_LENGTH))
            if np.linalg.norm(self._env.state.ee_position - before) < _STUCK:
                break
        return self._more(first)

    def _wait(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """Stay in place until the episode is over."""
        first = len(self._moments)
        while not self._episode.end:
            self._act_by_hand(np.zeros(3))
        return self._more(first)

    def _save(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """Keep the episode, which must be over: then it can be scored and played again."""
        record = self._episode.record
        if not record.end:
            raise MechSearchError(
                f"the episode goes on after {len(record.actions)} actions; end it before it is "
                "saved: let the policy act, or wait to the end"
            )
        header = self._header | {"heaps": 1, "quarantined": []}
        if self._by_hand:
            record = replace(record, policy=BY_HAND)
            header |= {"name": BY_HAND, "policy": BY_HAND, "keys": [], "trained": False}
            header |= {"training_seed": None, "training_actions": 0}
            header.pop("actor", None)
        name = f"{record.policy}-{record.heap_seed}"
        path, number = self._folder / f"{name}.npz", 1
        while path.exists():
            number += 1
            path = self._folder / f"{name}-{number}.npz"
        save_episodes(path, Evaluation(header, (record,)))
        return {"state": self._state(), "said": f"wrote {path}"}

    def _act_by_hand(self, way: Array) -> None:
        """Push by a displacement (3,) in [-1, 1]."""
        self._by_hand = True
        if self._hands is None:
            self._act(way.astype(np.float32), _NOTHING)
            return
        decision = np.zeros(DECISION_SIZE)
        decision[2:5] = way
        self._act(decision, _NOTHING)

    def _act(self, action: Array, weighed: Any) -> None:
        """Carry out an action, before which so much was weighed."""
        film: list[LiftFrame] = []
        if isinstance(self._env, RetrieveEnv):
            self._env.film = film
        self._episode.step(action)
        record = self._episode.record
        self._weighed.append(weighed)
        if self._hands is None:
            self._moments.append([*pushed(record)][-1])
        else:
            step = len(record.actions) - 1
            self._moments += carried_out(record, step, film, self._hands)

    def _film(self) -> Any:
        record, models = self._episode.record, self._env.objects.models
        return film_of(self._header, record, models, FilmConfig(), True, lambda *_: self._moments)

    def _more(self, first: int) -> dict[str, Any]:
        """Return the moments from one on, and how things stand."""
        if first == len(self._moments):
            return {"state": self._state()}
        return {"more": moments_told(self._film(), first, self._weighed), "state": self._state()}

    def _state(self) -> dict[str, Any]:
        """Return what the page shows beside the heap."""
        obs, policy = self._episode.obs, str(self._plan.policy)
        depth, target = obs["depth"][0], (obs["position_image"] != 0).any(axis=0)
        if "segments" in obs:
            depth, target = obs["grasp_depth"], obs["segments"] == _TARGET
        images = {"what it sees: depth": None, "the target in it": target}
        return {
            "over": bool(self._episode.end), "heap": self._index, "policy": policy,
            "seen": [[name, _source(_depth_image(depth, mask))] for name, mask in images.items()],
        }  # fmt: skip


def _three(asked: Mapping[str, Any], name: str) -> Array:
    """Return three finite numbers of a request."""
    try:
        numbers = np.array(asked.get(name), np.float64)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise MechSearchError(f"{name} is {asked.get(name)!r}; expected three numbers")
    return numbers


def _depth_image(depth: Array, mask: Array | None) -> Array:
    """Return depth (H, W) as an image (H, W, 3): high is light, holes black, a mask green."""
    seen = depth[depth > 0]
    far = seen.max() if len(seen) else 1.0
    grey = np.where(depth > 0, 45 + 190 * (far - depth) / _TALL, 0)
    image = np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    if mask is not None:
        image[mask] = image[mask] // 2 + np.array([20, 110, 35], np.uint8)
    return image


def _source(image: Array) -> str:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "PNG")
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def server(session: LiveSession, host: str, port: int) -> ThreadingHTTPServer:
    """Return a server of a session's page, which runs by `serve_forever`.

    Args:
        session: What is shown.
        host: Name or address at which it listens.
        port: Number; 0 takes a free one.

    Raises:
        MechSearchError: If nobody can listen there.
    """

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path != "/":
                self.send_error(HTTPStatus.NOT_FOUND)
                return
            self._send("text/html", viewer_page("mechsearch view", "null"))

        def do_POST(self) -> None:
            # Pages of others cannot send this type without being asked, and are not answered.
            kind, size = self.headers.get("Content-Type"), self.headers.get("Content-Length", "")
            known = self.path == "/do" and kind == "application/json" and size.isdecimal()
            if not known or int(size) > _LONGEST_REQUEST:
                self.send_error(HTTPStatus.BAD_REQUEST)
                return
            self._send("application/json", session.answer(self.rfile.read(int(size))))

        def log_message(self, *words: Any) -> None:
            """Say nothing of each request."""

        def _send(self, kind: str, text: str) -> None:
            content = text.encode()
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", f"{kind}; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(content)

    try:
        return ThreadingHTTPServer((host, port), Handler)
    except (OSError, OverflowError) as error:
        raise MechSearchError(
            f"nobody can listen at {host}, port {port} ({error}); choose another --port, 0 takes a "
            "free one, or --host"
        ) from None
