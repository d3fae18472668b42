"""The video in a real browser: it loads, seeks, and shows different pictures at two times."""

import http.server
import json
import os
import re
import shutil
import subprocess
import threading

import pytest
from fake_log import fake_log

from lpvmpc.errors import RenderError
from lpvmpc.picture.video import render

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = ("--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --mute-audio "
         "--disable-background-networking --disable-component-update --disable-sync "
         "--autoplay-policy=no-user-gesture-required").split()

PAGE = """<!doctype html><title>video</title>
<video id="v" src="run.mp4" muted preload="auto"></video>
<script>
const v = document.getElementById("v");
const tell = (what) => fetch("/result", {method: "POST", body: JSON.stringify(what)});
const wait = (name) => new Promise((done, fail) => {
  v.addEventListener(name, done, {once: true});
  v.addEventListener("error", () => fail(v.error ? v.error.message : "error"), {once: true});
});
async function pixels(time) {
  const there = wait("seeked");
  v.currentTime = time;
  await there;
  const c = document.createElement("canvas");
  c.width = v.videoWidth; c.height = v.videoHeight;
  const pen = c.getContext("2d");
  pen.drawImage(v, 0, 0);
  return pen.getImageData(0, 0, c.width, c.height).data;
}
async function main() {
  if (v.readyState < 2) await wait("loadeddata");
  const a = await pixels(0.2), b = await pixels(1.5), again = await pixels(0.2);
  let moved = 0, back = 0, bright = 0;
  for (let i = 0; i < a.length; i += 4) {
    moved += Math.abs(a[i] - b[i]); back += Math.abs(a[i] - again[i]); bright += a[i];
  }
  const n = a.length / 4;
  v.currentTime = 0;
  const played = wait("timeupdate");
  await v.play();
  await new Promise((done) => setTimeout(done, 500));
  await tell({width: v.videoWidth, height: v.videoHeight, duration: v.duration, moved: moved / n,
              back: back / n, bright: bright / n, played: v.currentTime});
}
main().catch((e) => tell({error: String(e)}));
</script>"""


class Server(http.server.BaseHTTPRequestHandler):
    """Serves the page and the video with byte ranges, and takes the result."""

    def do_GET(self):
        if self.path == "/":
            self.answer(200, "text/html", PAGE.encode())
        elif self.path == "/run.mp4":
            data = self.server.video
            asked = re.match(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
            if not asked:
                self.answer(200, "video/mp4", data)
                return
            first = int(asked[1])
            last = min(int(asked[2]) if asked[2] else len(data) - 1, len(data) - 1)
            self.answer(206, "video/mp4", data[first : last + 1],
                        {"Content-Range": f"bytes {first}-{last}/{len(data)}"})
        else:
            self.answer(404, "text/plain", b"")

    def do_POST(self):
        self.server.result = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.answer(200, "text/plain", b"")
        self.server.done.set()

    def answer(self, status, kind, body, headers=None):
        self.send_response(status)
        for name, value in {"Content-Type": kind, "Content-Length": str(len(body)),
                            "Accept-Ranges": "bytes", **(headers or {})}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *args):
        pass


def watch(video, profile):
    """What Chromium sees of a video file."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Server)
    server.video, server.result, server.done = video.read_bytes(), None, threading.Event()
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    browser = subprocess.Popen(
        [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", f"http://127.0.0.1:{server.server_port}/"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        assert server.done.wait(90), "Chromium told nothing within 90 s"
    finally:
        browser.terminate()
        browser.wait(20)
        server.shutdown()
        thread.join()
        server.server_close()
    return server.result


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_chromium_plays_the_video_and_seeks_in_it(tmp_path):
    given = os.environ.get("LPVMPC_VIDEO")  # a file to check instead, such as a whole run's
    video = tmp_path / "run.mp4"
    if given:
        shutil.copy(given, video)
    else:
        try:
            render.render_video(fake_log(2.0), video, width=640, height=360)
        except RenderError as error:
            pytest.skip(str(error))
    seen = watch(video, tmp_path / "profile")
    assert "error" not in seen, seen
    if not given:
        assert (seen["width"], seen["height"]) == (640, 360)
        assert seen["duration"] == pytest.approx(2.0, abs=0.05)  # one frame more or less
    assert seen["bright"] > 30.0  # gray levels: a picture, not black
    assert seen["moved"] > 3.0  # gray levels: another place on the road
    assert seen["back"] < 0.5  # seeking back shows the same picture
    assert seen["played"] > 0.1  # s after half a second of playing
