"""The page of a run: everything is in it, and a browser shows it without errors."""

import base64
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import numpy as np
import pytest
from fake_log import fake_log

from lpvmpc.picture.page import page

ROWS = [("lateral error, RMSE", "1.00 mm", "21.70 mm"), ("duration", "20.00 s", "")]


def content(log, **changes):
    """What metrics.json would hold."""
    return {
        "scenario": "paper", "controller": "lpv-mpc", "stiffness": "network", "seed": 0,
        "completed": True, "reason": "", "estimator": "none", "model_sha256": "ab",
        "world": {"name": "rtk", "drawn": {"sensors": {"ax_bias_mps2": 0.0625}}},
        "versions": {"lpvmpc": "0"},
        "record": {"options": {"grip": 0.87, "ay_max": None}, "weights": {"q_ey": 540.0},
                   "commit": "c0ffee", "machine": "a machine", "warnings": ["The road is <short>."],
                   "estimator_unknowns": {}},
        **changes,
    }


def data_of(text):
    return json.loads(re.search(r'id="data">(.*?)</script>', text, re.S)[1])


def numbers(packed):
    return np.frombuffer(base64.b64decode(packed), "<f4")


def test_it_holds_the_runs_numbers_settings_world_and_origin():
    log = fake_log()
    text = page(log, content(log), ROWS)
    for part in ("lpv-mpc on paper", "21.70 mm", "grip", "0.87", "sensors.ax_bias_mps2", "0.0625",
                 "c0ffee", "540", "The road is &lt;short&gt;."):
        assert part in text, part
    assert "ay_max" not in text and not re.search(r"@[A-Z]+@", text)


def test_its_curves_are_those_of_the_log():
    log = fake_log()
    data = data_of(page(log, content(log), ROWS))
    lateral = data["plots"][0]
    assert lateral["unit"] == "mm" and len(lateral["curves"]) == 1
    np.testing.assert_allclose(numbers(lateral["curves"][0]["values"]), 1e3 * log.columns["ey_m"],
                               rtol=1e-6)  # single precision
    np.testing.assert_allclose(numbers(data["t"]), log.columns["t_s"], rtol=1e-6)
    titles = " ".join(plot["title"] for plot in data["plots"])
    for word in ("Lateral error", "Heading error", "Speed", "Steering", "Side wind", "step"):
        assert word in titles


def test_traffic_is_seen_from_above_and_its_gap_plotted():
    log = fake_log()
    assert data_of(page(log, content(log), ROWS))["users"] == []
    n = len(log.columns["t_s"])
    log.meta["traffic"] = [{"name": "van", "length_m": 5.0, "width_m": 2.0, "height_m": 2.0}] * 2
    for i in range(2):
        for name in ("x_m", "y_m", "psi_rad", "s_m", "gap_m"):
            log.columns[f"user{i}_{name}"] = np.linspace(3.0 + i, 1.0, n)
    data = data_of(page(log, content(log), ROWS))
    assert [user["length"] for user in data["users"]] == [5.0, 5.0]
    np.testing.assert_allclose(numbers(data["users"][1]["pose"][0]), np.linspace(4.0, 1.0, n),
                               rtol=1e-6)
    (gap,) = (plot for plot in data["plots"] if "road user" in plot["title"])
    np.testing.assert_allclose(numbers(gap["curves"][0]["values"]), np.linspace(3.0, 1.0, n),
                               rtol=1e-6)


def test_an_estimate_and_a_lost_run_are_shown_as_such():
    log = fake_log()
    log.columns["est_ey_m"] = log.columns["ey_m"] + 0.01
    log.columns["est_epsi_rad"] = log.columns["epsi_rad"]
    text = page(log, content(log, completed=False, reason="off the <path>"), ROWS)
    assert [c["name"] for c in data_of(text)["plots"][0]["curves"]] == ["true", "estimated"]
    assert "Not completed: off the &lt;path&gt;." in text


def test_a_long_run_is_thinned_and_says_so(monkeypatch):
    monkeypatch.setattr("lpvmpc.picture.page.MOST", 250)
    log = fake_log()  # 607 instants
    text = page(log, content(log), ROWS)
    assert len(numbers(data_of(text)["t"])) == 203 and "Every 3. instant" in text


def test_it_needs_nothing_from_elsewhere(tmp_path):
    log = fake_log()
    film = tmp_path / "film.mp4"
    film.write_bytes(b"film")
    text = page(log, content(log, controller="</script><b>:X"), ROWS, film)
    found = []

    class Reader(HTMLParser):
        def handle_starttag(self, tag, attributes):
            found.extend(v for k, v in attributes if k in ("src", "href"))

    Reader().feed(text)
    assert found == ["data:,"] and base64.b64encode(b"film").decode() in text
    assert not re.search(r"fetch\(|import\(|XMLHttpRequest|@import|url\(", text)
    assert text.count("</script>") == 3


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs chromium")
@pytest.mark.parametrize("width", [1280, 400])
def test_a_browser_shows_it_without_errors(tmp_path, width):
    """Every button is pressed and the instant moved; nothing is wider than the window."""
    log = fake_log()
    (tmp_path / "page.html").write_text(page(log, content(log), ROWS))
    (tmp_path / "check.html").write_text(
        f"<iframe id=f style='border:0;width:{width}px;height:900px' src=page.html></iframe>"
        "<pre id=o></pre><script>f.onload = async () => { const w = f.contentWindow,"
        " d = f.contentDocument, said = []; w.onerror = m => said.push('error ' + m);"
        " w.console.error = m => said.push('error ' + m); let n = 0;"
        " for (const id of ['in', 'in', 'out', 'all']) { d.getElementById(id).click(); n++; }"
        " d.querySelectorAll('.legend button').forEach(b => { b.click(); b.click(); n++; });"
        " const s = d.getElementById('slider'); s.value = 500;"
        " s.dispatchEvent(new w.Event('input'));"
        " w.show();"  # virtual time may end before the next picture is drawn
        " const clock = d.getElementById('clock').textContent;"
        " if (/NaN|undefined/.test(d.body.innerHTML.replace(/<script[^]*<\\/script>/g, '')))"
        " said.push('error: NaN'); if (d.documentElement.scrollWidth > f.clientWidth)"
        " said.push('error: too wide'); o.textContent = said.join('\\n') + 'seen ' + n + ' at ' +"
        " clock; };</script>")
    shown = subprocess.run(
        ["chromium", "--headless=new", "--no-sandbox", "--disable-gpu", "--dump-dom",
         "--allow-file-access-from-files", f"--user-data-dir={tmp_path / 'profile'}",
         "--virtual-time-budget=20000", f"file://{tmp_path / 'check.html'}"],
        capture_output=True, text=True, timeout=300, check=True).stdout
    said = shown.partition("<pre")[2].partition("</pre>")[0]
    half = log.columns["t_s"][-1] / 2
    assert "seen 20" in said and f"at {half:.2f} s" in said and "error" not in said


