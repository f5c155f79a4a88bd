import pytest

from benchmarks.results import Figure, merge, read, row_of, to_markdown, write_table


def row(name, value=2.0, **options):
    return row_of(Figure(name, value, "ms", **options), "a machine", "a command")


def test_a_ratio_says_how_many_times_better_ours_is():
    assert Figure("a", 2.0, "ms", "peer", 6.0).ratio == pytest.approx(3)
    assert Figure("a", 6.0, "frames/s", "peer", 2.0, "more").ratio == pytest.approx(3)
    assert Figure("a", 6.0, "MB").ratio is None


def test_a_measurement_replaces_its_own_names_and_keeps_the_others(tmp_path):
    path = tmp_path / "results.json"
    merge(path, [row("action-10"), row("action-5"), row("frames-64")], ("action", "frames"))
    merge(path, [row("action-5", 3.0)], ("action", "frames"))
    entries = read(path)
    assert [entry.name for entry in entries] == ["action-5", "action-10", "frames-64"]
    assert entries[0].value == 3.0


def test_a_note_goes_with_the_command_and_what_is_extrapolated_says_so():
    entry = row("heaps-4200", note="extrapolated from 84 heaps")
    assert entry.command == "a command (extrapolated from 84 heaps)"
    assert "2 ms, extrapolated" in to_markdown([entry])


def test_the_table_replaces_what_lies_between_its_marks_alone(tmp_path):
    page = tmp_path / "page.md"
    marks = "<!-- written by `make bench`: begin -->\nold\n<!-- written by `make bench`: end -->"
    page.write_text(f"before\n{marks}\nafter\n")
    write_table(page, [row("action-5")])
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "`action-5`" in text
    assert "old" not in text


def test_a_page_without_marks_is_refused(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("nothing\n")
    with pytest.raises(SystemExit, match="lacks the marks"):
        write_table(page, [row("action-5")])
