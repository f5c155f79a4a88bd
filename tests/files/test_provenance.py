import numpy as np

from mechsearch.files import crossed, fingerprint, mixed
from mechsearch.files.provenance import PACKAGES


def test_a_fingerprint_names_what_computes() -> None:
    found = fingerprint(threads=2)
    assert set(PACKAGES) < set(found)
    assert found["numpy"] == np.__version__
    assert found["threads"] == "2"
    assert all(isinstance(value, str) and value for value in found.values())


def test_the_same_machine_crosses_nothing() -> None:
    assert crossed(fingerprint(), fingerprint()) == []


def test_every_difference_is_told_in_words() -> None:
    before = {"torch": "2.3.1", "threads": "1", "gone": "x"}
    now = {"torch": "2.4.0", "threads": "1", "new": "y"}
    assert crossed(before, now) == [
        "torch 2.4.0 instead of 2.3.1",
        "gone not recorded instead of x",
        "new y instead of not recorded",
    ]


def test_results_that_were_computed_alike_need_no_word() -> None:
    assert mixed({}) == []
    assert mixed({"a": fingerprint(), "b": fingerprint()}) == []


def test_results_of_another_machine_are_named_together() -> None:
    here, there = {"torch": "2.3.1", "processor": "x86_64"}, {"torch": "2.3.1", "processor": "arm"}
    (sentence,) = mixed({"spiral": here, "method": there, "idle": here, "plus": there})
    assert sentence.startswith("method, plus came about with processor arm instead of x86_64")
