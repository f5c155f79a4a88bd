from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from mechsearch.heaps.dataset import embedded_heaps, evenly_spread


def test_half_of_ten_is_every_second() -> None:
    assert evenly_spread(10, 5) == [0, 2, 4, 6, 8]
    assert evenly_spread(3, 0) == []


@given(st.integers(1, 500), st.data())
def test_any_stretch_holds_its_share(count: int, data: st.DataObject) -> None:
    chosen = data.draw(st.integers(1, count))
    found = evenly_spread(count, chosen)
    first, last = sorted(data.draw(st.tuples(st.integers(0, count), st.integers(0, count))))
    assert len(found) == len(set(found)) == chosen
    inside = sum(first <= index < last for index in found)
    assert abs(inside - (last - first) * chosen / count) < 1 + 1e-9


def test_of_a_heap_set_all_object_counts_are_alike() -> None:
    heaps = embedded_heaps("single").held_out
    counts = Counter(heaps[i].count for i in evenly_spread(len(heaps), 6))
    assert set(counts.values()) == {2}
