"""Mutants: reward, occlusion and the learner's targets with one thing changed. A test must notice.

Each runs its tests in a forked process, which is handed the changed source instead of the file's.
Those that no test can tell from the original stand in `equivalent_mutants.json`, with the reason.
"""

import ast
import copy
import importlib.abc
import importlib.util
import json
import os
import resource
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
EQUIVALENT = Path(__file__).with_name("equivalent_mutants.json")
TIME_LIMIT = 120
"""Processor time after which a mutant that never ends counts as noticed [s]."""


@dataclass(frozen=True)
class Subject:
    """What is mutated, and which tests must notice.

    Attributes:
        module: Its name.
        functions: Of it or of its classes; empty takes all.
        tests: Test files and test names, as pytest takes them.
    """

    module: str
    functions: tuple[str, ...]
    tests: tuple[str, ...]

    @property
    def path(self) -> Path:
        """The module's file."""
        return ROOT / "src" / Path(*self.module.split(".")).with_suffix(".py")


SUBJECTS = (
    Subject("mechsearch.env.reward", (), ("tests/env/test_reward.py",)),
    Subject(
        "mechsearch.render.visibility",
        ("occlusion", "_dense"),
        ("tests/render/test_visibility.py",),
    ),
    Subject(
        "mechsearch.render.visibility",
        ("place", "_turn", "overlaps", "rays", "blocks", "_directions", "depths", "_moved_into"),
        ("tests/render/test_visibility.py", "tests/render/test_renderer.py"),
    ),
    Subject(
        "mechsearch.actor_critic.learner",
        ("alpha_divergence", "bellman_target", "_tensors"),
        (
            "tests/actor_critic/test_targets.py",
            "tests/actor_critic/test_ddpg.py::test_batches_are_mirrored_only_where_that_is_wanted",
        ),
    ),
    Subject(
        "mechsearch.actor_critic.learner",
        ("straying", "update_target"),
        (
            "tests/actor_critic/test_ddpg.py::test_straying_is_one_less_the_mean_cosine_to_what_teachers_did",
            "tests/actor_critic/test_ddpg.py::test_targets_move_by_the_share_tau",
            "tests/actor_critic/test_ddpg.py::"
            "test_the_actor_that_is_evaluated_begins_as_the_mean_of_all_actors",
        ),
    ),
    Subject(
        "mechsearch.actor_critic.replay",
        ("__len__", "add", "end", "_judge", "_write", "sample"),
        ("tests/actor_critic/test_replay.py", "tests/actor_critic/test_targets.py"),
    ),
)


@dataclass(frozen=True)
class Mutant:
    """One changed source.

    Attributes:
        subject: Whose.
        name: Module, function, and the statement before and after; lines may move.
        source: The module's, changed.
    """

    subject: Subject
    name: str
    source: str


def mutate() -> dict[str, Any]:
    """Run every mutant's tests.

    Raises:
        SystemExit: If a mutant lives that is not known to be equivalent, or a known one is gone.
    """
    known: dict[str, str] = json.loads(EQUIVALENT.read_text())
    began = _processor_time()
    _warm_up()
    for subject in SUBJECTS:
        if _noticed(Mutant(subject, "", subject.path.read_text())):
            raise SystemExit(f"{subject.module}: its tests fail without any mutation")
    everyone = [mutant for subject in SUBJECTS for mutant in mutants(subject)]
    alive: list[str] = []
    for number, mutant in enumerate(everyone):
        if not _noticed(mutant):
            alive.append(mutant.name)
            print(f"alive: {mutant.name}", flush=True)
        if number % 50 == 49:
            print(f"{number + 1} of {len(everyone)} mutants, {len(alive)} alive", flush=True)
    surprising = [name for name in alive if name not in known]
    gone = [name for name in known if name not in alive]
    if surprising or gone:
        lines = [f"no test notices: {name}" for name in surprising]
        lines += [f"listed as equivalent, but not alive: {name}" for name in gone]
        raise SystemExit("\n".join(lines))
    return {
        "mutants": len(everyone),
        "noticed": len(everyone) - len(alive),
        "equivalent": len(alive),
        "core_minutes": (_processor_time() - began) / 60,
    }


def mutants(subject: Subject) -> Iterator[Mutant]:
    """Yield a module with each single change, in the order of its text."""
    tree = ast.parse(subject.path.read_text())
    seen: dict[str, int] = {}
    for function, statement in _statements(tree, subject.functions):
        before = _text(statement)
        for change in _changes(statement):
            undo = change()
            name = f"{subject.module} {function}: {before}  ->  {_text(statement)}"
            source = ast.unparse(tree)
            undo()
            seen[name] = seen.get(name, 0) + 1
            number = "" if seen[name] == 1 else f"  ({seen[name]})"
            yield Mutant(subject, name + number, source)


Undo = Callable[[], None]
Change = Callable[[], Undo]

_OPERATORS: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Mult,),
    ast.Pow: (ast.Mult,),
    ast.MatMult: (),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
}
_OPPOSITES = {"min": "max", "any": "all", "minimum": "maximum", "floor": "ceil", "zeros": "ones"}
_OPPOSITES |= {new: old for old, new in _OPPOSITES.items()}


def _statements(tree: ast.Module, functions: Sequence[str]) -> Iterator[tuple[str, ast.stmt]]:
    """Yield the simple statements and the heads of compound ones, by function."""
    # What a nested function holds belongs to the outer one too, but is changed once.
    met: set[ast.stmt] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and (not functions or node.name in functions):
            for inner in ast.walk(node):
                if isinstance(inner, ast.stmt) and not _is_silent(inner) and inner not in met:
                    met.add(inner)
                    yield node.name, inner
        elif isinstance(node, ast.ClassDef) and not functions:
            yield from ((node.name, field) for field in node.body if _is_field(field))


def _is_silent(node: ast.stmt) -> bool:
    """Whether a statement is a message, a docstring or a definition."""
    docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return docstring or isinstance(node, ast.Raise | ast.FunctionDef | ast.Pass)


def _is_field(node: ast.stmt) -> bool:
    return isinstance(node, ast.AnnAssign) and node.value is not None


def _text(statement: ast.stmt) -> str:
    """Return a statement's own text, without what is nested in it."""
    bare = copy.copy(statement)
    for name in ("body", "orelse"):
        if hasattr(bare, name):
            setattr(bare, name, [ast.Pass()] if name == "body" else [])
    return " ".join(ast.unparse(bare).removesuffix("pass").split())


def _expressions(statement: ast.stmt) -> Iterator[ast.AST]:
    """Yield the nodes of a statement that belong to no nested statement or annotation."""
    waiting: list[ast.AST] = [statement]
    while waiting:
        node = waiting.pop(0)
        yield node
        for name, value in ast.iter_fields(node):
            children = value if isinstance(value, list) else [value]
            waiting += [
                child
                for child in children
                if isinstance(child, ast.AST)
                and not isinstance(child, ast.stmt)
                and name not in ("annotation", "op", "ops")
            ]


def _changes(statement: ast.stmt) -> Iterator[Change]:
    """Yield what can be changed in one statement."""
    for node in _expressions(statement):
        match node:
            case ast.BinOp(op=op) | ast.BoolOp(op=op) | ast.AugAssign(op=op):
                yield from (_set(node, "op", kind()) for kind in _OPERATORS[type(op)])
            case ast.Compare(ops=[op]):
                yield from (_set(node, "ops", [kind()]) for kind in _OPERATORS[type(op)])
            case ast.UnaryOp(op=ast.USub() | ast.Invert(), operand=operand):
                yield _become(node, operand)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                yield _become(node, ast.Call(ast.Name("bool"), [operand], []))
            case ast.Constant(value=bool() as value):
                yield _set(node, "value", not value)
            case ast.Constant(value=int() | float() as value):
                yield _set(node, "value", value + 1)
            case ast.IfExp(body=body, orelse=orelse):
                yield _become(node, body)
                yield _become(node, orelse)
            case ast.If(test=ast.Call() | ast.Name() | ast.Attribute() as test):
                yield _set(node, "test", ast.UnaryOp(ast.Not(), test))
            case ast.Attribute(attr=name) if name in _OPPOSITES:
                yield _set(node, "attr", _OPPOSITES[name])
            case ast.Name(id=name) if name in _OPPOSITES:
                yield _set(node, "id", _OPPOSITES[name])
            case ast.Return(value=ast.AST()):
                yield _set(node, "value", ast.Constant(None))
            case ast.Continue():
                yield _become(node, ast.Pass())
            case ast.Expr() | ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
                yield _become(node, ast.Pass())


def _set(node: ast.AST, field: str, value: Any) -> Change:
    def change() -> Undo:
        old = getattr(node, field)
        setattr(node, field, value)
        ast.fix_missing_locations(node)
        return lambda: setattr(node, field, old)

    return change


def _become(node: ast.AST, other: ast.AST) -> Change:
    """Put another node in the place of one, by turning it into that other's likeness."""

    def change() -> Undo:
        kind, content = node.__class__, dict(vars(node))
        node.__class__ = other.__class__
        vars(node).update(vars(other))
        ast.fix_missing_locations(node)

        def undo() -> None:
            node.__class__ = kind
            vars(node).clear()
            vars(node).update(content)

        return undo

    return change


class _Changed(SourceFileLoader):
    """Loads a module from its file's place but with another text."""

    def __init__(self, mutant: Mutant) -> None:
        super().__init__(mutant.subject.module, str(mutant.subject.path))
        self._text = mutant.source

    def get_code(self, fullname: str) -> CodeType:
        """Return the changed code."""
        code: CodeType = compile(self._text, self.path, "exec")
        return code


class _Finder(importlib.abc.MetaPathFinder):
    """Finds the mutant's module before all others."""

    def __init__(self, mutant: Mutant) -> None:
        self._mutant = mutant

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> ModuleSpec | None:
        """Return the changed module's place."""
        if fullname != self._mutant.subject.module:
            return None
        loader = _Changed(self._mutant)
        return importlib.util.spec_from_file_location(fullname, loader.path, loader=loader)


def _warm_up() -> None:
    """Import what all tests need, once."""
    for name in ("torch", "pytest", "trimesh", "embreex", "mujoco", "scipy.spatial", "gymnasium"):
        importlib.import_module(name)
    hypothesis = importlib.import_module("hypothesis")
    sys.modules["torch"].set_num_threads(1)
    # The same examples each time, and no search for the smallest that fails.
    hypothesis.settings.register_profile(
        "mutants", database=None, derandomize=True, deadline=None,
        phases=[hypothesis.Phase.explicit, hypothesis.Phase.generate],
    )  # fmt: skip


def _noticed(mutant: Mutant) -> bool:
    """Return whether a mutant's tests fail, in a process of their own."""
    child = os.fork()
    if not child:
        os._exit(_tests(mutant))
    _, status = os.waitpid(child, 0)
    return status != 0


def _processor_time() -> float:
    """Return what the processes of all mutants have taken so far [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _tests(mutant: Mutant) -> int:
    """Run a mutant's tests, silently; return 0 if they all pass."""
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    os.chdir(ROOT)
    resource.setrlimit(resource.RLIMIT_CPU, (TIME_LIMIT, TIME_LIMIT))
    for name in [name for name in sys.modules if name.split(".")[0] == "mechsearch"]:
        del sys.modules[name]
    sys.meta_path.insert(0, _Finder(mutant))
    options = ("-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-W", "ignore")
    profile = "--hypothesis-profile=mutants"
    return int(sys.modules["pytest"].main([*options, profile, *mutant.subject.tests]))
