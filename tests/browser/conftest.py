"""A real browser without a screen: QtWebEngine, which is Chromium."""

import json
import os

import pytest

qt = pytest.importorskip("PySide6.QtWebEngineWidgets", reason="run by `make test-browser`")

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
os.environ.setdefault(
    "QTWEBENGINE_CHROMIUM_FLAGS",
    "--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader "
    "--ignore-gpu-blocklist",
)

import numpy as np  # noqa: E402
from PySide6.QtCore import (  # noqa: E402
    QEvent,
    QEventLoop,
    QPoint,
    QPointF,
    Qt,
    QTimer,
    QUrl,
)
from PySide6.QtGui import QImage, QMouseEvent  # noqa: E402
from PySide6.QtTest import QTest  # noqa: E402
from PySide6.QtWebEngineCore import (  # noqa: E402
    QWebEnginePage,
    QWebEngineProfile,
    QWebEngineUrlRequestInterceptor,
)
from PySide6.QtWidgets import QApplication  # noqa: E402

LIMIT = 60.0
"""Time after which nothing more is waited for [s]: without a graphics card it is slow."""


class Requests(QWebEngineUrlRequestInterceptor):
    """Notes whatever a page asks for."""

    def __init__(self):
        super().__init__()
        self.urls = []

    def interceptRequest(self, info):  # noqa: N802
        self.urls.append(info.requestUrl().toString())


class Page(QWebEnginePage):
    """Notes whatever the console says."""

    def javaScriptConsoleMessage(self, level, message, line, source):  # noqa: N802
        self.said.append(f"{message} (line {line})")


class Browser:
    """One window."""

    def __init__(self):
        self.requests, self.profile = Requests(), QWebEngineProfile()
        self.profile.setUrlRequestInterceptor(self.requests)
        self.view = qt.QWebEngineView()
        self.page = Page(self.profile, self.view)
        self.page.said = []
        self.view.setPage(self.page)
        self.view.resize(1200, 800)
        self.view.show()

    def wait(self, seconds):
        loop = QEventLoop()
        QTimer.singleShot(round(1000 * seconds), loop.quit)
        loop.exec()

    def open(self, url):
        self.page.load(QUrl(url))
        self.until("document.body?.dataset.ready === 'yes'")
        self.until("!(live && waiting) && !dirty")

    def run(self, code):
        """Return what an expression of JavaScript gives; Qt hands over texts alone."""
        loop, found = QEventLoop(), []
        text = f"JSON.stringify({code}) ?? 'null'"
        self.page.runJavaScript(text, 0, lambda value: (found.append(value), loop.quit()))
        QTimer.singleShot(round(1000 * LIMIT), loop.quit)
        loop.exec()
        return json.loads(found[0]) if found and found[0] else None

    def until(self, condition):
        for _ in range(round(20 * LIMIT)):
            if self.run(condition):
                return
            self.wait(0.05)
        raise AssertionError(f"never {condition}; the console said {self.page.said}")

    def text(self, name):
        return self.run(f"document.getElementById({name!r}).innerText")

    def place(self, selector):
        """Return the middle of an element in the window."""
        x, y = self.run(
            f"(() => {{ const e = document.querySelector({selector!r}); e.scrollIntoView(); "
            "const r = e.getBoundingClientRect(); "
            "return [r.x + r.width / 2, r.y + r.height / 2]; })()"
        )
        return round(x), round(y)

    def click(self, selector, x=0, y=0):
        """Click with the mouse on an element, or so far from its middle [px]."""
        middle = self.place(selector)
        spot = QPoint(middle[0] + x, middle[1] + y)
        buttons = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
        QTest.mouseClick(self.view.focusProxy(), *buttons, spot)
        self.wait(0.2)
        self.until("!(live && waiting) && !dirty && !(live && playing)")

    def drag(self, selector, x, y):
        """Drag from the middle of an element by so much [px]."""
        start, widget = QPoint(*self.place(selector)), self.view.focusProxy()
        buttons = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
        QTest.mousePress(widget, *buttons, start)
        for k in (1, 2, 3):
            _move(widget, start + QPoint(x * k // 3, y * k // 3))
            self.wait(0.1)
        QTest.mouseRelease(widget, *buttons, start + QPoint(x, y))
        self.until("!dirty")

    def pixels(self):
        """Return what is drawn of the heap (H, W, 3)."""
        self.wait(0.5)
        left, top, wide, high = self.run(
            "(() => { const r = canvas.getBoundingClientRect(); "
            "return [r.x, r.y, r.width, r.height]; })()"
        )
        image = self.view.grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
        rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), -1)
        whole = rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3)
        return whole[round(top) : round(top + high), round(left) : round(left + wide)].astype(int)


def _move(widget, spot):
    place, held = QPointF(spot), Qt.MouseButton.LeftButton
    event = QMouseEvent(
        QEvent.Type.MouseMove, place, widget.mapToGlobal(place), Qt.MouseButton.NoButton, held,
        Qt.KeyboardModifier.NoModifier,
    )  # fmt: skip
    QApplication.sendEvent(widget, event)


@pytest.fixture(scope="session")
def application():
    return QApplication.instance() or QApplication(["mechsearch"])


@pytest.fixture
def browser(application):
    made = Browser()
    yield made
    # Whatever a test was about: nobody outside was asked, and nothing went wrong.
    asked = {QUrl(url).host() for url in made.requests.urls if not url.startswith("data:")}
    assert asked <= {"", "127.0.0.1"}
    assert made.page.said == []
    made.view.close()
    made.page.deleteLater()
    made.wait(0.1)
