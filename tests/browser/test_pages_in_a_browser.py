"""What people see on the pages, and that a click does what it says."""

import threading

import numpy as np
import pytest

from mechsearch.evaluation.episodes import load_episodes
from mechsearch.evaluation.rollout import EvaluationPlan, evaluate_plan, weighed_again
from mechsearch.heaps.dataset import object_set
from mechsearch.pictures.film import FilmConfig, film_of
from mechsearch.pictures.live import LiveSession, server
from mechsearch.pictures.page import Shown, episode_page
from mechsearch.report.document import Document, PageBeside, Section, to_html


@pytest.fixture(scope="module")
def evaluation():
    pytest.importorskip("torch")
    return evaluate_plan(EvaluationPlan("uncover", limit=2))


@pytest.fixture(scope="module")
def page_of_episodes(evaluation):
    """A page of two episodes."""
    header, models = evaluation.header, object_set("household").models
    shown = {}
    for name, record in zip(("worst", "best"), evaluation.episodes, strict=True):
        film = film_of(header, record, models, FilmConfig(), True)
        shown[name] = Shown(film, f"{name} of two", weighed_again(header, record, models))
    return episode_page("Two <episodes>", shown)


@pytest.fixture
def page(browser, page_of_episodes, tmp_path):
    """That page in the browser."""
    (tmp_path / "a.html").write_text(page_of_episodes, encoding="utf-8")
    browser.open((tmp_path / "a.html").as_uri())
    return browser


def green(pixels):
    """Return how many pixels are as green as the target alone is."""
    red, green, blue = np.moveaxis(pixels, -1, 0)
    return int(((green > red + 50) & (green > blue + 30)).sum())


def test_heap_target_candidates_and_words_are_on_the_page(page, evaluation):
    record = evaluation.episodes[0]
    assert page.run("document.title") == "Two <episodes>"
    assert page.text("about") == "worst of two"
    assert page.text("words") == f"start: {record.occlusions[0]:.0%} hidden"
    target = record.objects[record.target].replace("_", " ")
    assert page.run("document.querySelector('#labels .target').textContent") == f"target: {target}"
    values = page.run(
        "[...document.querySelectorAll('#candidates b')].map(b => Number(b.textContent))"
    )
    assert len(values) == 12
    assert values == sorted(values, reverse=True)
    assert page.run("document.querySelector('#candidates .chosen').innerText").startswith(
        "push, chosen"
    )
    pixels = page.pixels()
    assert green(pixels) > 150
    # Lit: the table is bright, and there is shade on it.
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 2000


def test_the_play_bar_and_its_keys_move_through_the_episode(page, evaluation):
    record = evaluation.episodes[0]
    last = len(record.actions)
    before = page.pixels()
    page.click("#next")
    assert page.text("clock") == f"1 / {last}"
    assert page.text("words").startswith("1 action: ")
    page.click("#back")
    assert page.text("clock") == f"0 / {last}"
    page.click("#play")
    page.until("!playing")
    assert page.text("clock") == f"{last} / {last}"
    assert page.text("words").endswith(record.end)
    assert page.text("numbers").startswith(f"{record.occlusions[-1]:.0%} hidden, {last} actions")
    assert np.abs(page.pixels() - before).max(axis=2).mean() > 1
    page.run("document.activeElement.blur()")
    page.run("dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowLeft'}))")
    page.until("!dirty")
    assert page.text("clock") == f"{last - 1} / {last}"


def test_a_drag_turns_the_view_and_boxes_hide_what_they_name(page):
    turn = page.run("camera.turn")
    page.drag("#canvas", 120, 30)
    assert page.run("camera.turn") == pytest.approx(turn - 0.008 * 120, abs=0.05)
    page.click("[data-view=above]")
    with_lines = page.pixels()
    page.click("#showCandidates")
    page.click("#showPath")
    without = page.pixels()
    assert (np.abs(with_lines - without).max(axis=2) > 40).sum() > 300
    page.click("#showNames")
    assert page.run("document.querySelectorAll('#labels span').length") == page.run(
        "episode.objects.length"
    )


def test_another_episode_is_chosen(page, evaluation):
    page.run("($('episode').value = 1, $('episode').onchange())")
    page.until("!dirty")
    assert page.text("about") == "best of two"
    assert page.text("clock") == f"0 / {len(evaluation.episodes[1].actions)}"


def test_a_report_unfolds_its_episodes(browser, page_of_episodes, tmp_path):
    section = Section("Episodes", [PageBeside(page_of_episodes, "The worst & best", "episodes")])
    # Scripts of others do not run.
    text = to_html(Document("A report", "", [section]), "a")
    text = text.replace("</main>", "<script>document.title = 'other'</script></main>")
    (tmp_path / "a.html").write_text(text, encoding="utf-8")
    browser.page.load((tmp_path / "a.html").as_uri())
    browser.until("document.querySelector('summary') && document.readyState === 'complete'")
    inside = "document.querySelector('iframe').contentDocument?.body"
    # Whether a browser loads what is folded already is its own affair.
    shown = "document.querySelector('iframe').checkVisibility()"
    assert browser.run(shown) is False
    browser.run("document.querySelector('summary').click()")
    browser.until(f"{inside}?.dataset.ready === 'yes'")
    assert browser.run("document.title") == "A report"
    assert browser.run(f"{inside}.querySelectorAll('#candidates li').length") >= 12
    assert "execute inline script" in browser.page.said.pop()
    assert browser.run(shown) is True
    assert browser.run("document.querySelector('iframe').getBoundingClientRect().height") > 400


@pytest.fixture
def live(browser, tmp_path):
    """A live page in the browser."""
    session = LiveSession(EvaluationPlan("teacher-spiral", limit=3), tmp_path / "kept")
    with server(session, "127.0.0.1", 0) as listening:
        threading.Thread(target=listening.serve_forever, daemon=True).start()
        browser.open(f"http://127.0.0.1:{listening.server_port}/")
        yield browser
        browser.page.load("about:blank")
        listening.shutdown()


def test_a_live_page_shows_what_is_seen_and_acts_when_it_is_told_to(live):
    assert live.run("document.querySelectorAll('#seen img').length") == 2
    assert live.run("[...document.querySelectorAll('#seen img')].every(i => i.naturalWidth === 64)")
    assert "uncover" in live.run("[...$('policy').options].map(o => o.value)")
    live.click("#step")
    assert live.run("episode.tips.length") == 2
    live.click("#run")
    live.until("episode.tips.length > 4 && !waiting")
    live.click("#run")
    assert live.text("run") == "let it act"
    heap = live.run("$('heap').options[1].value")
    live.run(f"($('heap').value = {heap}, $('heap').onchange(), 0)")
    live.until("!waiting && episode.tips.length === 1")
    assert live.run("$('heap').value") == heap


def test_a_click_on_the_table_pushes_there_and_the_episode_is_kept(live, tmp_path):
    live.click("[data-view=above]")
    start = live.run("episode.tips[0]")
    live.click("[data-way='0,0,-1']")
    assert live.run("episode.tips.at(-1)")[2] == pytest.approx(start[2] - 0.05, abs=5e-3)
    live.run("($('height').value = 20, $('height').oninput())")
    live.click("#canvas", 180, -150)
    # Seen from 1.09 m above the table at 43 degrees: the place of a pixel on a plane 20 cm up.
    high = live.run("canvas.clientHeight")
    scale = 2 * (1.05 + 0.04 - 0.2) * np.tan(0.375) / high
    tip = live.run("episode.tips.at(-1)")
    assert tip == pytest.approx([180 * scale, 150 * scale, 0.2], abs=0.02)
    live.click("#save")
    assert "end it before it is saved" in live.text("said")
    live.click("#wait")
    live.click("#save")
    assert live.text("said").startswith("wrote ")
    (file,) = (tmp_path / "kept").iterdir()
    (record,) = load_episodes(file).episodes
    assert record.policy == "hand"
    assert record.ee_positions[-1] == pytest.approx(tip, abs=5e-3)


def test_a_server_that_is_gone_is_said_in_a_line(browser, tmp_path):
    session = LiveSession(EvaluationPlan("idle", limit=1), tmp_path)
    with server(session, "127.0.0.1", 0) as listening:
        threading.Thread(target=listening.serve_forever, daemon=True).start()
        browser.open(f"http://127.0.0.1:{listening.server_port}/")
        listening.shutdown()
    browser.run("$('step').click()")
    browser.until("!waiting")
    assert "is `mechsearch view` still running?" in browser.text("said")
    # The browser itself notes that nobody answered.
    browser.page.said.clear()
