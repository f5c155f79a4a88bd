"""Claims about pulling YCB objects, against a server on this machine that misbehaves."""

import gzip
import hashlib
import io
import json
import tarfile
import threading
from collections import Counter
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from mechsearch.objects.ycb.download import pull_ycb
from mechsearch.objects.ycb.transfer import Patience
from mechsearch.types import MechSearchError

IMPATIENT = Patience(tries=3, wait=0.0, timeout=5.0)
NAME = "999_test_can"


def archive(name=NAME, members=None):
    """A .tgz of about 100 kB that compression cannot shrink."""
    noise = np.random.default_rng(0).bytes(100_000)
    members = members or {
        f"{name}/google_16k/textured.obj": noise,
        f"{name}/google_16k/texture_map.png": b"picture",
    }
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w:gz") as tar:
        for path, content in members.items():
            if isinstance(content, tarfile.TarInfo):
                tar.addfile(content)
                continue
            info = tarfile.TarInfo(path)
            info.size = len(content)
            tar.addfile(info, io.BytesIO(content))
    return stream.getvalue()


class Site:
    """What the server serves, and how it misbehaves.

    `cuts` are numbers of bytes after which one answer each stops; `flips` is how many answers
    have a wrong byte.
    """

    def __init__(self):
        self.files = {}
        self.cuts = []
        self.flips = 0
        self.ranges = True
        self.etags = True
        self.short_length = None
        self.status = {}
        self.asked = []
        self.sent = Counter()

    def publish(self, *names, **archives):
        listed = [*names, *archives]
        self.files["/objects.json"] = json.dumps({"objects": listed}).encode()
        for name in names:
            self.files[f"/google/{name}_google_16k.tgz"] = archive(name)

    def answer(self, handler):
        path = handler.path
        self.asked.append((path, handler.headers.get("Range")))
        if self.status.get(path):
            handler.send_error(self.status[path].pop(0))
            return
        if path not in self.files:
            handler.send_error(404)
            return
        body = self.files[path]
        etag = f'"{hashlib.md5(body).hexdigest()}"'
        if self.flips and path.endswith("tgz"):
            self.flips -= 1
            body = body[:500] + bytes([body[500] ^ 1]) + body[501:]
        if self.short_length:
            body = body[: self.short_length]
        asked = handler.headers.get("Range")
        start = 0
        if asked and self.ranges and handler.headers.get("If-Range") == etag:
            start = int(asked.removeprefix("bytes=").removesuffix("-"))
            handler.send_response(206)
            handler.send_header("Content-Range", f"bytes {start}-{len(body) - 1}/{len(body)}")
        else:
            handler.send_response(200)
        if self.etags:
            handler.send_header("ETag", etag)
        handler.send_header("Content-Length", str(len(body) - start))
        handler.end_headers()
        stop = len(body)
        if self.cuts and path.endswith("tgz"):
            stop = min(stop, start + self.cuts.pop(0))
        handler.wfile.write(body[start:stop])
        self.sent[path] += stop - start


@pytest.fixture
def site():
    served = Site()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            served.answer(self)

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    served.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield served
    server.shutdown()
    thread.join()
    server.server_close()


def pull(site, folder, **options):
    return pull_ycb(folder, site.url, patience=IMPATIENT, **options)


def scan(folder, name=NAME):
    return folder / name / "google_16k" / "textured.obj"


def leftovers(folder):
    return [path.name for path in (folder / ".partial").iterdir()]


def test_all_listed_objects_are_pulled_whole(site, tmp_path):
    site.publish("001_a", "002_b")
    assert pull(site, tmp_path).fetched == ("001_a", "002_b")
    assert len(scan(tmp_path, "002_b").read_bytes()) == 100_000
    assert leftovers(tmp_path) == []


def test_objects_that_are_whole_are_not_fetched_again(site, tmp_path):
    site.publish("001_a", "002_b")
    pull(site, tmp_path, names=["001_a"])
    site.asked.clear()
    done = pull(site, tmp_path)
    assert (done.fetched, done.present) == (("002_b",), ("001_a",))
    assert not any("001_a" in path for path, _ in site.asked)


def test_a_cut_transfer_goes_on_where_it_stopped(site, tmp_path):
    site.publish(NAME)
    site.cuts = [30_000, 40_000]
    assert pull(site, tmp_path).fetched == (NAME,)
    path = f"/google/{NAME}_google_16k.tgz"
    asked = [bytes_asked for at, bytes_asked in site.asked if at == path]
    assert asked == [None, "bytes=30000-", "bytes=70000-"]
    assert site.sent[path] == len(site.files[path])


def test_a_second_pull_goes_on_after_the_first_gave_up(site, tmp_path):
    site.publish(NAME)
    site.cuts = [60_000, 0, 0, 0]
    with pytest.raises(MechSearchError, match="60000 of"):
        pull(site, tmp_path)
    assert not (tmp_path / NAME).exists()
    site.asked.clear()
    pull(site, tmp_path)
    assert site.asked[-1][1] == "bytes=60000-"
    assert scan(tmp_path).exists()


def test_a_server_without_ranges_is_asked_for_the_whole_file_again(site, tmp_path):
    site.publish(NAME)
    site.cuts, site.ranges = [30_000], False
    pull(site, tmp_path)
    assert len(scan(tmp_path).read_bytes()) == 100_000


def test_without_an_etag_nothing_is_resumed(site, tmp_path):
    site.publish(NAME)
    site.cuts, site.etags = [30_000], False
    pull(site, tmp_path)
    assert all(asked is None for _, asked in site.asked)
    assert len(scan(tmp_path).read_bytes()) == 100_000


def test_a_file_that_changed_between_two_pulls_is_fetched_from_the_start(site, tmp_path):
    site.publish(NAME)
    site.cuts = [60_000, 0, 0, 0]
    with pytest.raises(MechSearchError):
        pull(site, tmp_path)
    newer = {f"{NAME}/google_16k/textured.obj": np.random.default_rng(1).bytes(90_000)}
    site.files[f"/google/{NAME}_google_16k.tgz"] = archive(members=newer)
    pull(site, tmp_path)
    assert scan(tmp_path).read_bytes() == newer[f"{NAME}/google_16k/textured.obj"]


def test_bytes_that_differ_from_the_checksum_are_fetched_again(site, tmp_path):
    site.publish(NAME)
    site.flips = 2
    pull(site, tmp_path)
    assert scan(tmp_path).read_bytes() == np.random.default_rng(0).bytes(100_000)


def test_damage_without_a_checksum_is_found_by_the_archive_and_fetched_again(site, tmp_path):
    site.publish(NAME)
    site.flips, site.etags = 2, False
    pull(site, tmp_path)
    assert scan(tmp_path).read_bytes() == np.random.default_rng(0).bytes(100_000)


@pytest.mark.parametrize("etags", [True, False])
def test_lasting_damage_is_named_and_leaves_nothing_behind(site, tmp_path, etags):
    site.publish(NAME)
    site.flips, site.etags = 99, etags
    with pytest.raises(MechSearchError, match=r"999_test_can.*by hand"):
        pull(site, tmp_path)
    assert not (tmp_path / NAME).exists()
    assert leftovers(tmp_path) == []


def test_an_archive_that_the_site_itself_has_cut_is_refused(site, tmp_path):
    site.publish(NAME)
    path = f"/google/{NAME}_google_16k.tgz"
    site.files[path] = site.files[path][:50_000]
    with pytest.raises(MechSearchError, match="damaged"):
        pull(site, tmp_path)
    assert not (tmp_path / NAME).exists()


def test_a_wrong_crc_at_the_end_of_the_archive_is_found(site, tmp_path):
    site.publish(NAME)
    path = f"/google/{NAME}_google_16k.tgz"
    body = site.files[path]
    assert gzip.decompress(body)
    site.files[path] = body[:-8] + bytes([body[-8] ^ 1]) + body[-7:]
    with pytest.raises(MechSearchError, match="CRC"):
        pull(site, tmp_path)
    assert not (tmp_path / NAME).exists()


def link(path, target, kind):
    info = tarfile.TarInfo(path)
    info.type, info.linkname = kind, target
    return info


EVIL = f"{NAME}/google_16k/evil"


@pytest.mark.parametrize(
    "members",
    [
        {f"{NAME}/google_16k/../../../escaped": b"x"},
        {"/tmp/mechsearch-escaped": b"x"},
        {EVIL: link(EVIL, "/etc", tarfile.SYMTYPE)},
        {EVIL: link(EVIL, "../../x", tarfile.LNKTYPE)},
        {EVIL: link(EVIL, "", tarfile.FIFOTYPE)},
    ],
)
def test_archives_that_reach_out_of_their_folder_are_refused(site, tmp_path, members):
    good = {f"{NAME}/google_16k/textured.obj": b"v 0 0 0"}
    site.publish(NAME)
    site.files[f"/google/{NAME}_google_16k.tgz"] = archive(members={**good, **members})
    folder = tmp_path / "inner"
    with pytest.raises(MechSearchError, match=r"leaves it|no plain file"):
        pull(site, folder)
    assert not (folder / NAME).exists()
    assert [path.name for path in tmp_path.iterdir()] == ["inner"]


def test_an_archive_without_the_scan_is_refused(site, tmp_path):
    site.publish(NAME)
    site.files[f"/google/{NAME}_google_16k.tgz"] = archive(members={"other/readme": b"x"})
    with pytest.raises(MechSearchError, match=r"no 999_test_can/google_16k/textured\.obj"):
        pull(site, tmp_path)


@pytest.mark.parametrize("status", [403, 404])
def test_objects_without_a_scan_are_listed_and_the_rest_pulled(site, tmp_path, status):
    site.publish("001_a", "002_b")
    site.status["/google/001_a_google_16k.tgz"] = [status]
    done = pull(site, tmp_path)
    assert (done.fetched, done.without_scan) == (("002_b",), ("001_a",))


def test_a_server_that_is_busy_is_asked_again(site, tmp_path):
    site.publish(NAME)
    site.status[f"/google/{NAME}_google_16k.tgz"] = [503, 429]
    assert pull(site, tmp_path).fetched == (NAME,)


def test_a_lasting_server_error_is_named_with_the_number_of_tries(site, tmp_path):
    site.publish(NAME)
    site.status[f"/google/{NAME}_google_16k.tgz"] = [500] * 9
    with pytest.raises(MechSearchError, match=r"HTTP 500 .*3 tries"):
        pull(site, tmp_path)


def test_without_a_network_the_message_says_what_to_do_by_hand(tmp_path):
    with pytest.raises(MechSearchError) as raised:
        pull_ycb(tmp_path, "http://127.0.0.1:9", patience=IMPATIENT)
    for part in ("127.0.0.1:9/objects.json", "by hand", "google_16k.tgz", str(tmp_path)):
        assert part in str(raised.value)


def test_a_name_that_is_not_on_the_site_is_refused_with_the_choices(site, tmp_path):
    site.publish("001_a", "002_b")
    with pytest.raises(MechSearchError, match=r"'mug'.*choose from 001_a, 002_b"):
        pull(site, tmp_path, names=["mug"])


def test_unsafe_names_in_the_list_are_left_out(site, tmp_path):
    site.publish("001_a")
    site.files["/objects.json"] = json.dumps({"objects": ["../../evil", "001_a"]}).encode()
    assert pull(site, tmp_path).fetched == ("001_a",)


def test_a_list_that_is_not_json_is_named(site, tmp_path):
    site.files["/objects.json"] = b"<html>"
    with pytest.raises(MechSearchError, match=r"list of YCB objects at .*objects\.json"):
        pull(site, tmp_path)


def test_a_site_that_is_no_web_address_is_refused(tmp_path):
    with pytest.raises(MechSearchError, match="expected https"):
        pull_ycb(tmp_path, "file:///etc")


def test_an_incomplete_scan_in_the_way_is_named_and_kept(site, tmp_path):
    site.publish(NAME)
    own = tmp_path / NAME / "google_16k" / "mine.txt"
    own.parent.mkdir(parents=True)
    own.write_text("mine")
    with pytest.raises(MechSearchError, match="remove it"):
        pull(site, tmp_path)
    assert own.read_text() == "mine"


def test_a_destination_that_is_a_file_is_named(site, tmp_path):
    site.publish(NAME)
    (tmp_path / "ycb").write_text("")
    with pytest.raises(MechSearchError, match="cannot write to"):
        pull(site, tmp_path / "ycb")
