"""At least 400 wrong inputs: each is one sentence and exit code 2, at once, without a traceback."""

import signal
from collections import Counter

import pytest

from lpvmpc.commands import COMMANDS, main
from lpvmpc.commands.reliability import options_of_all
from lpvmpc.kit import cli
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
    """An input that is not refused would drive on, or wait: it ends here, after 90 s of CPU."""

    def late(*_):
        raise TimeoutError("not refused")

    def begin():
        signal.setitimer(signal.ITIMER_PROF, 90.0)
        signal.alarm(1800)  # a machine may be slow, a read of a pipe waits for ever

    before = {number: signal.signal(number, late) for number in (signal.SIGALRM, signal.SIGPROF)}
    yield begin
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    signal.alarm(0)
    for number, handler in before.items():
        signal.signal(number, handler)


def test_the_list_is_long_and_has_every_command():
    counts = Counter(wrong.words[0] for wrong in LIST)
    assert len({wrong.words for wrong in LIST}) >= 400
    assert all(counts[name] > 5 for name in COMMANDS if name != "reliability"), counts


@pytest.mark.parametrize("first", FIRST)
def test_every_wrong_input_is_refused_in_one_sentence(folder, deadline, first):
    answers = []
    for wrong in LIST:
        if wrong.words[0] == first:
            deadline()
            answers.append(inputs.ask(wrong, main))
    faults = {a.wrong.words: (a.fault, a.sentence[-300:]) for a in answers if a.fault}
    assert faults == {}


def test_what_is_accepted_or_raises_would_be_found(folder, monkeypatch):
    assert inputs.ask(Wrong(words=("track", "--help")), main).fault == "exit code 0"
    monkeypatch.setitem(inputs.READERS, "tires", lambda file: 1 / 0)
    assert inputs.ask(Wrong(words=("read tires", "x")), main).fault == "a traceback"


def test_ctrl_c_among_the_wrong_inputs_is_no_answer_of_theirs():
    with pytest.raises(KeyboardInterrupt):
        inputs.ask(inputs.Wrong(words=("track", "--seed", "x")), lambda _: cli.INTERRUPTED)
