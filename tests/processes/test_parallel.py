"""Maps over worker processes that die, hang and raise."""

import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

import mechsearch
from mechsearch.processes import map_in_order
from mechsearch.types import MechSearchError


@dataclass(frozen=True)
class Square:
    """Squares numbers; misbehaves on some of them, `times` times over all processes."""

    folder: Path
    die_on: int = -1
    hang_on: int = -1
    raise_on: int = -1
    times: int = 1

    def __call__(self, number: int) -> int:
        marks = list(self.folder.glob(f"{number}-*"))
        (self.folder / f"{number}-{time.monotonic_ns()}").touch()
        if len(marks) < self.times:
            if number == self.die_on:
                os.kill(os.getpid(), signal.SIGKILL)
            if number == self.hang_on:
                time.sleep(600)
            if number == self.raise_on:
                raise ValueError(f"{number} is unlucky")
        return number**2

    def tries(self, number):
        return len(list(self.folder.glob(f"{number}-*")))


SQUARES = [n**2 for n in range(12)]


def test_results_keep_the_order_of_the_inputs_and_no_process_stays(tmp_path):
    assert list(map_in_order(Square(tmp_path), range(12), 2)) == SQUARES
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("trouble", [{"die_on": 5}, {"hang_on": 0}, {"raise_on": 11}])
def test_trouble_costs_the_repetition_of_its_input_alone(tmp_path, trouble):
    square = Square(tmp_path, **trouble)
    assert list(map_in_order(square, range(12), 2, time_limit=3.0)) == SQUARES
    (troubled,) = trouble.values()
    assert [square.tries(n) for n in range(12)] == [1 + (n == troubled) for n in range(12)]


@pytest.mark.parametrize(
    ("trouble", "reason"),
    [
        ({"die_on": 5}, "worker died"),
        ({"hang_on": 5}, "worker hung"),
        ({"raise_on": 5}, "worker raised: ValueError: 5 is unlucky"),
    ],
)
def test_what_fails_twice_is_replaced_as_the_caller_chooses(tmp_path, trouble, reason):
    square = Square(tmp_path, **trouble, times=2)
    found = []

    def instead(item, failure):
        found.append((item, failure.reason))
        return -1

    results = list(map_in_order(square, range(8), 2, time_limit=3.0, instead=instead))
    assert results == [n**2 if n != 5 else -1 for n in range(8)]
    assert found == [(5, reason)]
    assert square.tries(5) == 2


def test_a_twice_killing_input_is_named_by_default(tmp_path):
    with pytest.raises(MechSearchError, match="worker died, 2 times, on 3;"):
        list(map_in_order(Square(tmp_path, die_on=3, times=9), range(8), 2))
    assert not multiprocessing.active_children()


def test_what_the_function_raised_is_raised_with_the_workers_traceback(tmp_path):
    with pytest.raises(ValueError, match="3 is unlucky") as caught:
        list(map_in_order(Square(tmp_path, raise_on=3, times=9), range(8), 2))
    assert "in __call__" in caught.value.__notes__[0]


def refuse(number):
    raise MechSearchError(f"{number} is bad input")


@pytest.mark.parametrize("workers", [1, 2])
def test_bad_input_is_neither_tried_again_nor_replaced(workers):
    with pytest.raises(MechSearchError, match="0 is bad input"):
        list(map_in_order(refuse, range(8), workers, instead=lambda *_: 0))


def refuse_slowly(number):
    time.sleep(0.5 if number == 2 else 0)
    if number >= 2:
        refuse(number)
    return number


@pytest.mark.parametrize("workers", [1, 2])
def test_errors_keep_the_order_of_the_inputs_too(workers):
    results = map_in_order(refuse_slowly, range(8), workers)
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(MechSearchError, match="2 is bad input"):
        next(results)


def setting(name):
    return os.environ.get(name)


def test_workers_have_the_environment_of_their_start(monkeypatch):
    assert list(map_in_order(setting, ["MECHSEARCH_SETTING"] * 2, 2)) == [None, None]
    monkeypatch.setenv("MECHSEARCH_SETTING", "later")
    assert list(map_in_order(setting, ["MECHSEARCH_SETTING"] * 2, 2)) == ["later"] * 2
    path = os.environ.get("PYTHONPATH")
    assert list(map_in_order(setting, ["PYTHONPATH"], 2)) == [path]


BESIDE = r"""
import mechsearch
from mechsearch.processes import map_in_order
def copy(number):
    return mechsearch.__file__
if __name__ == "__main__":
    print(*map_in_order(copy, range(2), 2), sep="\n")
"""


def test_a_script_beside_a_copy_of_the_package_has_that_in_its_workers_too(tmp_path):
    package, script = tmp_path / "mechsearch", tmp_path / "script.py"
    package.symlink_to(Path(mechsearch.__file__).parent)
    script.write_text(BESIDE)
    words = [sys.executable, script]
    found = subprocess.run(words, capture_output=True, text=True, check=True, cwd="/")
    assert found.stdout.split() == [str(package / "__init__.py")] * 2


def test_one_worker_is_this_process_and_raising_has_the_same_rules(tmp_path):
    square = Square(tmp_path, raise_on=2)
    assert list(map_in_order(square, range(4), 1)) == SQUARES[:4]
    assert square.tries(2) == 2
    twice = Square(tmp_path, raise_on=7, times=9)
    assert list(map_in_order(twice, [6, 7, 8], 1, instead=lambda *_: -1)) == [36, -1, 64]


@pytest.mark.parametrize("workers", [1, 2])
def test_endless_inputs_are_taken_only_a_few_ahead(tmp_path, workers):
    taken = []

    def numbers():
        for n in itertools.count():
            taken.append(n)
            yield n

    results = map_in_order(Square(tmp_path), numbers(), workers)
    assert list(itertools.islice(results, 12)) == SQUARES
    assert len(taken) <= 12 + 4 * workers
    results.close()
    assert not multiprocessing.active_children()


def die_at_once():
    os._exit(1)


class Unloadable:
    """Pickles, but cannot be loaded in a worker."""

    def __reduce__(self):
        return die_at_once, ()


def test_workers_that_do_not_start_are_an_error_and_not_an_endless_loop():
    with pytest.raises(MechSearchError, match="do not start"):
        list(map_in_order(Unloadable(), range(3), 2))


def answer_with_a_lambda(number):
    return lambda: number


def test_a_result_that_cannot_be_sent_is_an_error_with_a_reason(tmp_path):
    with pytest.raises(Exception, match="lambda"):
        list(map_in_order(answer_with_a_lambda, range(3), 2))
