"""At least 400 wrong inputs: each is one sentence and exit code 2, at once, without a traceback."""

import signal
from collections import Counter

import pytest

from lpvmpc.commands import COMMANDS, main
from lpvmpc.commands.reliability import options_of_all
from lpvmpc.reliability import inputs
from lpvmpc.reliability.inputs import Wrong, wrong_inputs

LIST = wrong_inputs(options_of_all())
FIRST = sorted({wrong.words[0] for wrong in LIST})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    with inputs.set_up(tmp_path_factory.mktemp("wrong")):
        yield


@pytest.fixture
def deadline():
    """An input that is not refused would drive on: it ends here."""

    def late(*_):
        raise TimeoutError("not refused")

    before = signal.signal(signal.SIGALRM, late)
    yield signal.alarm
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def test_the_list_is_long_and_has_every_command():
    counts = Counter(wrong.words[0] for wrong in LIST)
    assert len({wrong.words for wrong in LIST}) >= 400
    assert all(counts[name] > 10 for name in COMMANDS if name != "reliability"), counts


@pytest.mark.parametrize("first", FIRST)
def test_every_wrong_input_is_refused_in_one_sentence(folder, deadline, first):
    answers = []
    for wrong in LIST:
        if wrong.words[0] == first:
            deadline(60)
            answers.append(inputs.ask(wrong, main))
    faults = {a.wrong.words: (a.fault, a.sentence[-300:]) for a in answers if a.fault}
    assert faults == {}


def test_what_is_accepted_or_raises_would_be_found(folder, monkeypatch):
    assert inputs.ask(Wrong(words=("track", "--help")), main).fault == "exit code 0"
    monkeypatch.setitem(inputs.READERS, "tires", lambda file: 1 / 0)
    assert inputs.ask(Wrong(words=("read tires", "x")), main).fault == "a traceback"
