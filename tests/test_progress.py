import io
import sys

from lpvmpc.kit.progress import Bar


class Terminal(io.StringIO):
    def isatty(self):
        return True


def terminal(monkeypatch):
    """A terminal in place of stderr, which pytest sets anew before each test's call."""
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    return stream


def test_a_bar_shows_title_count_and_unit_on_a_terminal(monkeypatch):
    stream = terminal(monkeypatch)
    with Bar("collecting", 8, counted=True, unit="samples") as bar:
        bar.at(2)
        bar.bar.refresh()
        assert "collecting" in stream.getvalue() and "2/8" in stream.getvalue()
        assert "samples/s" in stream.getvalue()


def test_what_begins_next_takes_the_place_of_what_was_shown(monkeypatch):
    terminal(monkeypatch)
    with Bar(counted=True) as bar:
        bar.begin("gusts", 3)
        bar.begin("figures", 5)
        bar.at(4, "figure 4")
        (task,) = bar.bar.tasks
        assert (task.description, task.completed, task.total) == ("figure 4", 4, 5)


def test_a_bar_that_is_no_terminal_s_says_nothing(capsys):
    with Bar("training", 3) as bar:
        bar.at(1)
        bar.begin("more", 2)
    assert capsys.readouterr() == ("", "")
